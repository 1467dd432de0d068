"""Children find this program and not what lies in the current folder under the same names."""

import re
import signal
import subprocess
import time
from pathlib import Path

import pytest

from companion.boat.load_run import EXAMPLES
from companion.jit import machine
from companion.jit.worker import compiled_in_child
from companion.python_child import aritra, python
from sim.bench.controller.starting import starts

ROOT = Path(__file__).resolve().parents[2]
SOON_S = 60.0


@pytest.fixture(autouse=True)
def in_the_way(tmp_path, monkeypatch):
    """The current folder, with files in it that have our packages' names."""
    for name in ("companion", "drivers", "sim", "deploy"):
        (tmp_path / f"{name}.py").write_text("raise ImportError('this is the current folder')\n")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_they_are_in_the_way_of_a_python_that_looks_there():
    words = python("-c", "import sim")
    assert subprocess.run(words, check=False).returncode == 0
    words.remove("-P")
    looks = subprocess.run(words, capture_output=True, text=True, check=False)
    assert "this is the current folder" in looks.stderr


@pytest.mark.skipif(not machine.may_run_what_was_written(), reason="the system forbids machine code")
def test_the_child_that_makes_machine_code():
    pytest.importorskip("llvmlite", reason="llvmlite is not installed")
    text = "define void @nothing(ptr %memory) {\n  ret void\n}\n"
    assert compiled_in_child(text) == machine.object_code(text)


def test_the_child_whose_start_is_measured():
    assert next(starts(EXAMPLES / "boats" / "aritra.toml")).status == "ok"


@pytest.mark.long
def test_the_demo_starts_boat_and_companion(in_the_way):
    with (in_the_way / "said.txt").open("w") as file:
        demo = subprocess.Popen(aritra("demo", "--out", "demo"), stdout=file, stderr=subprocess.STDOUT)
    try:
        end = time.monotonic() + SOON_S
        while not all(word in (told := Path(file.name).read_text()) for word in ("simulator: ", "configuration ")):
            assert demo.poll() is None and time.monotonic() < end, told
            time.sleep(0.05)
    finally:
        demo.send_signal(signal.SIGINT)
        demo.wait(SOON_S)


def test_all_children_are_started_so():
    tops = ("companion", "drivers", "sim", "deploy", "scripts", "tests")
    files = [file for top in tops for file in ROOT.glob(f"{top}/**/*") if file.suffix in ("", ".py") and file.is_file()]
    looks = re.compile(r"""sys\.executable\W{1,4}-(?!P)""")
    assert [str(file) for file in files if looks.search(file.read_text())] == []
