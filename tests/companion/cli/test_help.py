"""Every help ends with an example, and every example is a command line that the parser takes."""

import shlex
import shutil

import pytest

from companion.__main__ import parser
from companion.boat.load_run import EXAMPLES
from tests.support.fuzzing.command_lines import commands

EVERY = list(commands(parser()))
GROUPS = [(), ("log",), ("excite",)]


@pytest.fixture
def demo_done(tmp_path, monkeypatch, drive_log):
    """A folder as after `aritra demo` in the source tree."""
    shutil.copytree(EXAMPLES, tmp_path / "deploy", ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "out" / "demo").mkdir(parents=True)
    log = drive_log(1.0)
    for name in ("run.mcap", "truth.mcap"):
        shutil.copy(log, tmp_path / "out" / "demo" / name)
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize(
    "names", [*(names for names, _ in EVERY), *GROUPS], ids=lambda names: " ".join(names) or "aritra"
)
def test_the_help_ends_with_an_example_that_works(names, demo_done, capsys):
    with pytest.raises(SystemExit) as ended:
        parser().parse_args([*names, "--help"])
    assert ended.value.code == 0
    heading, example = capsys.readouterr().out.splitlines()[-2:]
    assert heading == "example:"
    program, *words = shlex.split(example.partition(" > ")[0])
    assert program == "aritra" and tuple(words[: len(names)]) == names
    parser().parse_args(words)


@pytest.mark.parametrize("names", [names for names, _ in EVERY], ids=" ".join)
def test_the_help_tells_the_exit_codes(names, capsys):
    with pytest.raises(SystemExit):
        parser().parse_args([*names, "--help"])
    assert "Exit code" in " ".join(capsys.readouterr().out.split())
