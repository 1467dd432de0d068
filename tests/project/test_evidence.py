"""`scripts/evidence` fails where nothing was shown: an unknown part, a part without lines, a line that falls short."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.evidence import runner
from tests.evidence.line import at_most, information

ROOT = Path(__file__).resolve().parents[2]


def good(full):
    """Good"""
    yield at_most("a figure", 1.0, 2.0)
    yield information("another", 7.0 if full else 5.0)


def bad(full):
    """Bad"""
    yield at_most("a figure", 3.0, 2.0)


def empty(full):
    """Empty"""
    yield from ()


@pytest.fixture
def evidence(monkeypatch, capsys):
    """Run `scripts/evidence speed WORDS` with three small parts; (exit code, what was printed, and the errors)."""
    monkeypatch.setattr(runner, "parts_of", lambda name: (good, bad, empty))

    def run(*words):
        try:
            code = runner.main(["speed", *words])
        except SystemExit as end:
            code = end.code
        return code, *capsys.readouterr()

    return run


def test_lines_that_hold(evidence):
    code, out, _ = evidence("--only", "good")
    assert code == 0
    assert out.startswith("\nGood\n  a figure ") and " 5 " in out and out.endswith("\nall lines hold\n")
    assert " 7 " in evidence("--only", "good", "--full")[1]


def test_a_line_that_falls_short(evidence):
    code, out, _ = evidence("--only", "bad")
    assert code == 1
    assert "FALLS SHORT" in out and out.endswith("\n1 lines fall short\n")


def test_a_part_without_any_line_is_an_error(evidence):
    code, out, _ = evidence("--only", "empty")
    assert code == 1
    assert "ERROR: part empty yields no line" in out and "all lines hold" not in out


def test_one_bad_part_among_good_ones(evidence):
    code, out, _ = evidence()
    assert code == 1 and out.endswith("\n2 lines fall short\n")


def test_an_unknown_part_names_those_there_are(evidence):
    code, out, err = evidence("--only", "nonsense")
    assert code == 2 and out == ""
    assert "no part of speed has 'nonsense' in its name; there are: good, bad, empty" in err


def test_a_list_without_parts_is_an_error(evidence, monkeypatch):
    monkeypatch.setattr(runner, "parts_of", lambda name: ())
    code, out, err = evidence()
    assert code == 2 and out == "" and "there are: none" in err


@pytest.mark.parametrize("name", sorted(runner.NAMES))
def test_every_list_has_parts_with_a_title(name):
    parts = runner.parts_of(name)
    assert parts and all(part.__doc__ for part in parts)
    assert len({part.__name__ for part in parts}) == len(parts)


def test_the_folders_are_the_names():
    assert {"main-job", "identify", "diagnose", "safe", "shore", "speed"} <= set(runner.NAMES)


@pytest.mark.parametrize(
    "python", [sys.executable, Path(sys.base_prefix) / "bin/python3"], ids=["active", "not active"]
)
def test_from_the_command_line_with_the_environment_active_or_not(python):
    if not Path(python).exists() or not (ROOT / ".venv").exists():
        pytest.skip("the environment of this checkout is elsewhere, or was not made from another Python")
    command = [python, ROOT / "scripts/evidence", "safe", "--only", "nonsense"]
    done = subprocess.run(command, cwd="/", capture_output=True, text=True, check=False)
    assert done.returncode == 2 and done.stdout == ""
    assert "there are: kill, boot, faults, fuzz, soak" in done.stderr


@pytest.mark.parametrize("bare", [False, True], ids=["no environment", "one without the extras"])
def test_without_what_it_needs_it_says_what_to_install(tmp_path, bare):
    script, base = tmp_path / "scripts/evidence", Path(sys.base_prefix) / "bin/python3"
    script.parent.mkdir()
    shutil.copy(ROOT / "scripts/evidence", script)
    if subprocess.run([base, "-c", "import polars"], capture_output=True, check=False).returncode == 0:
        pytest.skip(f"{base} has the extras itself")
    if bare:
        subprocess.run([base, "-m", "venv", "--without-pip", tmp_path / ".venv"], check=True)
    done = subprocess.run([base, script, "safe"], capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 1 and "scripts/install dev" in done.stderr
