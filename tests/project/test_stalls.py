"""A test in real time that fails has another try where the machine stood still, and nowhere else; limited time."""

import itertools
import shutil
import subprocess
from pathlib import Path

import pytest

from companion.python_child import python
from tests.support.stalls import NAP_S, Stalls, overslept

TESTS = Path(__file__).resolve().parents[1]
STORY = """
import os, signal, time
from pathlib import Path
import pytest

runs = []

def stand_still():
    (watcher,) = map(int, Path(f"/proc/self/task/{os.getpid()}/children").read_text().split())
    os.kill(watcher, signal.SIGSTOP)
    time.sleep(0.7)
    os.kill(watcher, signal.SIGCONT)
    time.sleep(0.2)

@pytest.mark.real_time
def test_once():
    runs.append(1)
    STALL
    assert len(runs) > FAILURES
"""


@pytest.mark.parametrize(
    ("stall", "failures", "told"),
    [
        ("stand_still()", 1, "1 passed, 1 rerun"),
        pytest.param("stand_still()", 9, "1 failed, 2 rerun", marks=pytest.mark.long),
        ("pass", 1, "1 failed in"),
        ("pass", 0, "1 passed in"),
    ],
)
def test_another_try(tmp_path, stall, failures, told):
    said = played(tmp_path, stall, failures)
    assert told in said, said
    assert ("stood still for 0.00 s" in said) == (stall == "pass" and failures > 0)
    assert said.count("stood still") == min(failures, 3 if stall != "pass" else 1)


def test_after_the_hour_no_test_begins(tmp_path, monkeypatch):
    monkeypatch.setenv("ARITRA_TEST_UNTIL", "1e9")
    assert "1 skipped" in (said := played(tmp_path, "pass", 9)) and "no time left" in said


def played(tmp_path, stall, failures):
    """What pytest says of the story, under our conftest."""
    support = tmp_path / "tests" / "support"
    support.mkdir(parents=True)
    (tmp_path / "tests" / "__init__.py").touch()
    shutil.copy(TESTS / "conftest.py", tmp_path / "tests")
    shutil.copy(TESTS / "support" / "surroundings.py", support)
    source = (TESTS / "support" / "stalls.py").read_text()
    assert "STALL_S = 0.05" in source
    rarely = source.replace("STALL_S = 0.05", "STALL_S = 0.4")  # what no machine does by chance
    (support / "stalls.py").write_text(rarely)
    (tmp_path / "pytest.ini").write_text(
        "[pytest]\nmarkers = real_time\npythonpath = .\naddopts = --import-mode=importlib\n"
    )
    (tmp_path / "tests" / "test_it.py").write_text(STORY.replace("STALL", stall).replace("FAILURES", str(failures)))
    done = subprocess.run(
        python("-m", "pytest", "-q", "-rs", "-p", "no:cacheprovider", "-n", "1", "tests/test_it.py"),
        cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    return done.stdout + done.stderr


def test_naps_that_take_longer():
    now = itertools.chain([0.0, NAP_S, 1.0, 1.0 + NAP_S + 0.2])
    naps = overslept(lambda: next(now), lambda _: None)
    assert next(naps) == (NAP_S, 0.0)
    assert next(naps) == pytest.approx((1.2 + NAP_S, 0.2))


def test_the_longest_since(tmp_path):
    (tmp_path / "stalls.txt").write_text("1.000 0.900\n2.000 0.100\n3.000 0.300\n4.000 0.")
    stalls = Stalls(tmp_path / "stalls.txt")
    assert (stalls.longest_s(1.5), stalls.longest_s(0.0), stalls.longest_s(3.0)) == (0.3, 0.9, 0.0)
