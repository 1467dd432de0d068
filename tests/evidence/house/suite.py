"""The whole test suite in a fresh clone, as it is and with things in its way."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from tests.evidence.house.trees import ROOT, git
from tests.evidence.line import Line, exactly, information
from tests.evidence.pytest_counts import counts

NOBODY = 65534
BUSY = 4
SHARED = ROOT.parent / "shared"
AS_NOBODY = ("setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups")


@dataclass(frozen=True)
class SuiteRun:
    """One run of the suite."""

    exit_code: int
    minutes: float
    passed: int
    skipped: int
    last_lines: str

    def lines(self, name: str) -> Iterator[Line]:
        note = f"{self.passed} passed, {self.skipped} skipped, {self.minutes:.1f} min"
        if self.exit_code:
            note += f"; {self.last_lines}"
        yield exactly(f"{name}: exit code", self.exit_code, 0, "", note)


def suite(full: bool) -> Iterator[Line]:
    """Suite: `make test` in a fresh clone, then with things in its way; --full only (hours)"""
    if not full:
        yield information("runs of the suite (only with --full)", 0)
        return
    with tempfile.TemporaryDirectory(prefix="aritra-suite-") as folder:
        Path(folder).chmod(0o755)
        clone = Path(folder) / "aritra"
        git("clone", "--quiet", str(ROOT), str(clone))
        alone = run_suite(clone, "make", "test")
        yield from alone.lines("fresh clone, make test, without ../shared")
        yield information("  minutes, installation included", alone.minutes, "min")
        yield information("  tests passed", alone.passed)
        yield information("  tests skipped", alone.skipped)
        if SHARED.is_dir():
            (clone.parent / "shared").symlink_to(SHARED)
            yield from run_suite(clone).lines("with ../shared")
        yield from run_suite(clone, COLUMNS="200").lines("COLUMNS=200")
        yield from run_suite(clone, LANG="C", LC_ALL="C").lines("LANG=C")
        yield from _with_sim_py(clone).lines("a sim.py in the way")
        yield from _with_busy_processes(clone).lines(f"{BUSY} busy processes beside it")
        yield from _as_nobody(clone)


def run_suite(clone: Path, *command: str, before: tuple[str, ...] = (), **env: str) -> SuiteRun:
    """The suite in a clone; the environment's own variables of Python and of pytest do not reach it."""
    kept: Mapping[str, str] = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "PYTEST", "VIRTUAL"))}
    begun = time.monotonic()
    words = [*before, *(command or ("scripts/test",))]
    done = subprocess.run(words, cwd=clone, env={**kept, **env}, capture_output=True, text=True, check=False)
    found = counts(done.stdout)
    last = " / ".join((done.stdout + done.stderr).strip().splitlines()[-3:])
    minutes = (time.monotonic() - begun) / 60
    return SuiteRun(done.returncode, minutes, found["passed"], found["skipped"], last)


def _with_sim_py(clone: Path) -> SuiteRun:
    """A module called as a package of ours, in the project's folder and in the folder of temporary files."""
    other = clone.parent / "other"
    other.mkdir()
    files = [clone / "sim.py", other / "sim.py"]
    for file in files:
        file.write_text('raise ImportError("the wrong sim")\n')
    try:
        return run_suite(clone, TMPDIR=str(other))
    finally:
        for file in files:
            file.unlink()


def _with_busy_processes(clone: Path) -> SuiteRun:
    with ExitStack() as stack:
        for _ in range(BUSY):
            child = subprocess.Popen([sys.executable, "-c", "while True: pass"])
            stack.callback(child.wait)
            stack.callback(child.kill)
        return run_suite(clone)


def _as_nobody(clone: Path) -> Iterator[Line]:
    """Another user's run; falls short where this user may not start one, or the other may not run the interpreter."""
    name = "as another user"
    if os.geteuid() != 0 or not shutil.which("setpriv"):
        yield exactly(f"{name}: exit code", float("nan"), 0, "", "needs root and setpriv")
        return
    subprocess.run(["chown", "-R", f"{NOBODY}:{NOBODY}", str(clone.parent)], check=True)
    home = clone.parent / "home"
    home.mkdir()
    os.chown(home, NOBODY, NOBODY)
    tried = subprocess.run([*AS_NOBODY, str(clone / ".venv/bin/python"), "-c", ""], check=False, capture_output=True)
    if tried.returncode:
        note = f"user {NOBODY} may not run {Path(sys.executable).resolve()}: make PYTHON=/usr/bin/python3 in the clone"
        yield exactly(f"{name}: exit code", float("nan"), 0, "", note)
        return
    more = {"HOME": str(home), "TMPDIR": str(home), "USER": "nobody", "LOGNAME": "nobody"}
    yield from run_suite(clone, before=AS_NOBODY, **more).lines(name)
