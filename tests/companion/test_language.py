"""In a language without our letters files are read as they are, and what cannot be shown is no error."""

import os
import shutil
import subprocess
import time

import pytest

from companion.boat.load_run import EXAMPLES
from companion.boat.recorder import Recorder
from companion.logs.metadata import log_metadata
from companion.python_child import aritra, python

ENGLISH_ONLY = {"LC_ALL": "C", "LANG": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
NAME = "Żółw"


def told(command):
    env = {**os.environ, **ENGLISH_ONLY}
    done = subprocess.run(command, capture_output=True, env=env, check=False)
    assert done.returncode == 0, done.stderr.decode("ascii")
    return done.stdout.decode("ascii")


@pytest.fixture
def run_file(tmp_path):
    shutil.copytree(EXAMPLES, tmp_path / "deploy")
    boat = tmp_path / "deploy" / "boats" / "aritra.toml"
    text = boat.read_text(encoding="utf-8")
    assert 'name = "aritra"' in text
    boat.write_text(text.replace('name = "aritra"', f'name = "{NAME}"'), encoding="utf-8")
    return tmp_path / "deploy" / "aritra.toml"


def test_a_boat_with_such_a_name_is_read(run_file):
    code = "import sys; from pathlib import Path; from companion.boat.load_run import load_setup; "
    code += "print(ascii(load_setup(Path(sys.argv[1])).pilot.vessel.name))"
    assert ascii(NAME) in told(python("-c", code, run_file))


def test_a_log_of_it_is_told(tmp_path):
    path = tmp_path / "run.mcap"
    with Recorder(path, log_metadata(NAME, {}), time.monotonic_ns, wall_offset_ns=0):
        pass
    assert "??w" in told(aritra("log", "info", path))
