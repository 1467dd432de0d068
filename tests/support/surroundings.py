"""One and the same surroundings for every test, whoever runs them and wherever.

Terminal, language, time zone, home, rights of new files: what a person has set there would change what programs print
and read. Children inherit it. Machine code that is kept between starts goes to one folder for the whole session, so
that it is compiled once. What a child imports is this checkout, as it is for the tests.
"""

import os
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

FIXED = {
    "COLUMNS": "80",
    "LINES": "24",
    "TERM": "xterm",
    "LANG": "C.UTF-8",
    "LC_ALL": "C.UTF-8",
    "PYTHONPATH": str(Path(__file__).resolve().parents[2]),
    "PYTHONUTF8": "1",
    "TZ": "UTC",
}
WITHOUT = (
    "ARITRA_CACHE", "CACHE_DIRECTORY", "CLICOLOR", "CLICOLOR_FORCE", "FORCE_COLOR", "GIT_DIR", "GIT_INDEX_FILE",
    "GIT_WORK_TREE", "LANGUAGE", "MPLBACKEND", "MPLCONFIGDIR", "NO_COLOR", "NOTIFY_SOCKET", "PYTHONIOENCODING",
    "PYTHONOPTIMIZE", "PYTHONSAFEPATH", "PYTHONWARNINGS", "PYTEST_ADDOPTS", "TTY_COMPATIBLE", "TTY_INTERACTIVE",
    "WATCHDOG_PID", "WATCHDOG_USEC", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "XDG_DATA_HOME", "XDG_STATE_HOME",
)  # fmt: skip


def settle(stack: ExitStack) -> None:
    """Make them so, with a home of the session's own that goes as `stack` closes; workers take their parent's."""
    for name in WITHOUT:
        os.environ.pop(name, None)
    os.environ.update(FIXED)
    time.tzset()
    os.umask(0o022)
    if "PYTEST_XDIST_WORKER" not in os.environ:
        home = stack.enter_context(tempfile.TemporaryDirectory(prefix="home", ignore_cleanup_errors=True))
        os.environ["HOME"] = str(Path(home).resolve())
