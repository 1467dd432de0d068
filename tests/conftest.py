"""Fixtures that every test may use; tests in real time have another try where the machine stood still.

Every test finds the same surroundings (`support/surroundings.py`), whatever terminal, language or home the person has.
"""

import os
import tempfile
import time
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import pytest
from hypothesis import settings

from tests.support.stalls import watched
from tests.support.surroundings import settle

ROOT = Path(__file__).resolve().parents[1]
TRIES_MORE = 2
UNTIL_S = float(os.environ.get("ARITRA_TEST_UNTIL", "inf"))
"""Since the epoch: no test begins later. For machines whose time is limited (`.ci/run`)."""
settings.register_profile("shared machine", deadline=None)
settings.load_profile("shared machine")


class OnlyAStall:
    """May a failed test in real time have another try? Only if the machine stood still meanwhile."""

    def __init__(self, stalls):
        self._stalls = stalls
        self._begun_s = {}
        self._told = []

    def again(self, name):
        return self._stalls.longest_s(self._begun_s[name]) > 0.0

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_setup(self, item):
        self._begun_s[item.nodeid] = time.monotonic()

    def pytest_runtest_logreport(self, report):
        if report.outcome in ("failed", "rerun") and "alone" in report.keywords:
            stall_s = self._stalls.longest_s(self._begun_s[report.nodeid])
            self._told.append(f"{report.nodeid} failed; meanwhile the machine stood still for {stall_s:.2f} s")

    def pytest_terminal_summary(self, terminalreporter):
        for line in self._told:
            terminalreporter.write_line(line)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item):
    if time.time() > UNTIL_S:
        pytest.skip("no time left on this machine, whose runs are limited (ARITRA_TEST_UNTIL)")


def pytest_configure(config):
    stack = ExitStack()
    config.add_cleanup(stack.close)
    settle(stack)


@pytest.hookimpl(trylast=True)
def pytest_collection_finish(session):
    alone = [item for item in session.items if item.get_closest_marker("alone")]
    if not alone or session.config.option.collectonly or session.config.option.usepdb:
        return
    stack = ExitStack()
    session.config.add_cleanup(stack.close)
    folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="stalls")))
    judge = OnlyAStall(stack.enter_context(watched(folder / "stalls.txt")))
    session.config.pluginmanager.register(judge)
    for item in alone:
        item.add_marker(pytest.mark.flaky(reruns=TRIES_MORE, condition=partial(judge.again, item.nodeid)))


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of measured data beside the checkout; the test is skipped where it is absent."""
    folder = ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("measured data (../shared/data beside the checkout) is not here")
    return folder
