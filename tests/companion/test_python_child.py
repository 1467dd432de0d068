"""A child that must not outlive its parent, whatever becomes of that."""

import signal
import subprocess

import psutil
import pytest

from companion.python_child import dependent_aritra, python

PARENT = """
import subprocess, sys, time
from companion.python_child import dependent_aritra
child = subprocess.Popen(dependent_aritra("sim", "--udp-to", "127.0.0.1:19999"), stdout=subprocess.PIPE)
child.stdout.readline()  # it runs
print(child.pid, flush=True)
time.sleep(60)
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, pytest.param(signal.SIGTERM, marks=pytest.mark.long)])
def test_it_ends_with_its_parent(number, tmp_path):
    with subprocess.Popen(python("-c", PARENT), stdout=subprocess.PIPE, text=True, cwd=tmp_path) as parent:
        child = psutil.Process(int(parent.stdout.readline()))
        parent.send_signal(number)
    assert not psutil.wait_procs([child], timeout=20)[1]


def test_one_that_comes_too_late_ends_at_once():
    words = dependent_aritra("sim")
    words[-2] = "1"  # not the process that starts it
    assert subprocess.run(words, check=False, timeout=60).returncode == -signal.SIGTERM


def test_its_words_are_those_of_aritra():
    done = subprocess.run(dependent_aritra("--version"), capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.startswith("aritra ")
