"""What is wrong with a command line, in one sentence, and what was meant."""

import shlex

import pytest

from companion.cli.options.parser import Parser
from tests.companion.command_line import exit_code


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("lgo", "aritra: 'lgo': unknown command; did you mean log?"),
        ("log inof x", "aritra log: 'inof': unknown command; did you mean info?"),
        ("xyzzy", "aritra: 'xyzzy': unknown command; choose from demo, check"),
        ("run --misson x", "aritra run: --misson: unknown option; did you mean --mission?"),
        ("run --zzz", "aritra run: --zzz: unknown option\n"),
        ("run --unch", "aritra run: --unch: unknown option; did you mean --unchecked?"),
        ("identify --vesel=x", "aritra identify: --vesel: unknown option; did you mean --vessel?"),
        ("--verson", "aritra: --verson: unknown option; did you mean --version?"),
        ("run fast", "aritra run: fast: not expected here"),
        ("run ''", "aritra run: '': not expected here"),
        ("provision --wiring gat", "'gat': unknown value; choose from gate, scaled, omni"),
        ("completion '\x1b[31-'", r"aritra completion: shell: '\x1b[31-': unknown value; choose from bash"),
        ("log plot", "aritra log plot: the following arguments are required: LOG"),
    ],
)
def test_what_is_wrong_is_one_sentence(words, told, capsys):
    assert exit_code(*shlex.split(words)) == 2
    out = capsys.readouterr()
    assert out.err.startswith(told) or told in out.err
    assert len(out.err.splitlines()) == 2 and "--help" in out.err.splitlines()[1]
    assert out.out == ""


def test_the_example_ends_the_help_in_a_line_of_its_own(monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")
    long = "x " + "--much " * 20
    assert Parser(prog="x", epilog="Last words.", example=long).format_help().endswith(f"\nexample:\n  {long}\n")
    assert "example" not in Parser(prog="x").format_help()
