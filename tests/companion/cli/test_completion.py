"""Completion, asked of real shells: bash what COMPREPLY holds after a TAB, fish what it offers; TABs on terminals."""

import os
import select
import shutil
import subprocess
from pathlib import Path

import pytest

from companion.__main__ import COMMANDS
from tests.companion.command_line import exit_code

SOON = 60.0
ASK = """
source "$1"
IFS=' ' read -ra COMP_WORDS <<< "$2"
[[ $2 == *' ' ]] && COMP_WORDS+=("")
COMP_CWORD=$((${#COMP_WORDS[@]} - 1))
_aritra
printf '%s\\n' "${COMPREPLY[@]}"
"""


@pytest.fixture
def script(tmp_path, capsys):
    """The script for a shell, in a file that this shell can parse; skips where it is not installed."""

    def made(shell: str) -> Path:
        if shutil.which(shell) is None:
            pytest.skip(f"there is no {shell} on this machine")
        assert exit_code("completion", shell) == 0
        file = tmp_path / f"completion.{shell}"
        file.write_text(capsys.readouterr().out)
        assert subprocess.run([shell, "-n", file], check=False).returncode == 0
        return file

    return made


@pytest.fixture
def completed(script):
    file = script("bash")

    def ask(line: str) -> list[str]:
        made = subprocess.run(["bash", "-c", ASK, "bash", file, line], capture_output=True, text=True, check=True)
        assert made.stderr == ""
        return made.stdout.split()

    return ask


CASES = (
    ("aritra lo", ["log"]),
    ("aritra log pl", ["plot"]),
    ("aritra log plot --tr", ["--truth"]),
    ("aritra log plot run.mcap --o", ["--out"]),
    ("aritra run --mi", ["--mission"]),
    ("aritra provision --wiring ", ["gate", "scaled", "omni"]),
    ("aritra provision --wiring s", ["scaled"]),
    ("aritra excite fly --nl", ["--nlos"]),
    ("aritra completion ", ["bash", "zsh", "fish"]),
    ("aritra sim --config ", []),
    ("aritra log info ", []),
    ("aritra sim --seed --w", []),
    ("aritra sim --seed 1 --wi", ["--wind", "--wiring"]),
    ("aritra --v", ["--version"]),
    ("aritra nonsense --x", []),
)


@pytest.mark.parametrize(("line", "words"), CASES)
def test_a_tab_completes(completed, line, words):
    assert completed(line) == words


@pytest.mark.parametrize(("line", "words"), [case for case in CASES if case[1]])
def test_fish_offers_the_same_with_a_word_on_each(script, line, words):
    file = script("fish")
    ask = ["fish", "--no-config", "-c", f"source {file}; complete -C {line!r}"]
    made = subprocess.run(ask, capture_output=True, text=True, check=True, cwd=file.parent)
    offered = [row.split("\t") for row in made.stdout.splitlines() if not row.startswith(("completion.fish", "./"))]
    assert made.stderr == "" and {name for name, *_ in offered} == set(words)
    assert all(len(row) == 2 for row in offered if row[0].startswith("-"))


def test_every_command_is_offered(completed):
    assert completed("aritra ") == [*COMMANDS]


@pytest.mark.parametrize(
    ("typed", "got"), [("aritra lo\tinfo\r", "log info"), ("aritra completion z\t\r", "completion zsh")]
)
@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_a_real_tab_in_a_real_shell(script, tmp_path, shell, typed, got):
    """The line editor itself, on a terminal: `aritra lo<TAB>` becomes `aritra log `."""
    rc = script(shell).read_text() + "aritra() { echo GOT \"$@\"; }\nPS1='ready> '\n"
    (tmp_path / ".zshrc").write_text(rc)
    command = {"bash": ["bash", "--noprofile", "--rcfile", tmp_path / ".zshrc", "-i"], "zsh": ["zsh", "-d", "-i"]}[
        shell
    ]
    env = {**os.environ, "TERM": "dumb", "ZDOTDIR": str(tmp_path), "HOME": str(tmp_path)}
    terminal, its = os.openpty()
    with subprocess.Popen(command, stdin=its, stdout=its, stderr=its, env=env) as shell_process:
        os.close(its)
        said, sent = b"", False
        while f"GOT {got}".encode() not in said and select.select([terminal], [], [], SOON)[0]:
            said += os.read(terminal, 4096)
            if b"ready> " in said and not sent:
                sent = os.write(terminal, typed.encode()) > 0
        shell_process.kill()
    os.close(terminal)
    assert f"GOT {got}".encode() in said
