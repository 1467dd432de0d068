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
STOOD_STILL_S = "machine stood still [s]"
UNTIL_S = float(os.environ.get("ARITRA_TEST_UNTIL", "inf"))
"""Since the epoch: no test begins later. For machines whose time is limited (`.ci/run`)."""
settings.register_profile("shared machine", deadline=None)
settings.load_profile("shared machine")


class OnlyAStall:
    """May a failed test in real time have another try? Only if the machine stood still meanwhile."""

    def __init__(self, stalls):
        self._stalls = stalls
        self._begun_s = {}

    def again(self, name):
        return self._stalls.longest_s(self._begun_s[name]) > 0.0

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_setup(self, item):
        self._begun_s[item.nodeid] = time.monotonic()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item):
        report = yield
        if report.failed and item.get_closest_marker("real_time"):
            report.user_properties.append((STOOD_STILL_S, self._stalls.longest_s(self._begun_s[item.nodeid])))
        return report


class StallLines:
    """At the end: how long the machine stood still during each test in real time that failed."""

    def __init__(self):
        self._told = []

    def pytest_runtest_logreport(self, report):
        for name, value in report.user_properties:
            if name == STOOD_STILL_S:
                self._told.append(f"{report.nodeid} failed; meanwhile the machine stood still for {value:.2f} s")

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
    config.pluginmanager.register(StallLines())


@pytest.hookimpl(trylast=True)
def pytest_collection_finish(session):
    timed = [item for item in session.items if item.get_closest_marker("real_time")]
    if not timed or session.config.option.collectonly or session.config.option.usepdb:
        return
    stack = ExitStack()
    session.config.add_cleanup(stack.close)
    folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="stalls")))
    judge = OnlyAStall(stack.enter_context(watched(folder / "stalls.txt")))
    session.config.pluginmanager.register(judge)
    for item in timed:
        item.add_marker(pytest.mark.flaky(reruns=TRIES_MORE, condition=partial(judge.again, item.nodeid)))


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of measured data beside the checkout; the test is skipped where it is absent."""
    folder = ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("measured data (../shared/data beside the checkout) is not here")
    return folder
