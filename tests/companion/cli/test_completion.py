"""Completion, asked of a real bash: what COMPREPLY holds after a TAB."""

import os
import select
import shutil
import subprocess

import pytest

from companion.__main__ import COMMANDS
from tests.companion.command_line import exit_code

pytestmark = pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash")
SOON = 20.0
ASK = """
source "$1"
IFS=' ' read -ra COMP_WORDS <<< "$2"
[[ $2 == *' ' ]] && COMP_WORDS+=("")
COMP_CWORD=$((${#COMP_WORDS[@]} - 1))
_aritra
printf '%s\\n' "${COMPREPLY[@]}"
"""


@pytest.fixture
def completed(tmp_path, capsys):
    assert exit_code("completion", "bash") == 0
    script = tmp_path / "completion.bash"
    script.write_text(capsys.readouterr().out)
    assert subprocess.run(["bash", "-n", script], check=False).returncode == 0

    def ask(line: str) -> list[str]:
        made = subprocess.run(["bash", "-c", ASK, "bash", script, line], capture_output=True, text=True, check=True)
        assert made.stderr == ""
        return made.stdout.split()

    return ask


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("aritra lo", ["log"]),
        ("aritra log pl", ["plot"]),
        ("aritra log plot --tr", ["--truth"]),
        ("aritra log plot run.mcap --o", ["--out"]),
        ("aritra run --mi", ["--mission"]),
        ("aritra provision --wiring ", ["gate", "scaled", "omni"]),
        ("aritra provision --wiring s", ["scaled"]),
        ("aritra excite fly --nl", ["--nlos"]),
        ("aritra completion ", ["bash"]),
        ("aritra sim --config ", []),
        ("aritra log info ", []),
        ("aritra sim --seed --w", []),
        ("aritra sim --seed 1 --wi", ["--wind", "--wiring"]),
        ("aritra --v", ["--version"]),
        ("aritra nonsense --x", []),
    ],
)
def test_a_tab_completes(completed, line, words):
    assert completed(line) == words


def test_every_command_is_offered(completed):
    assert completed("aritra ") == [*COMMANDS]


def test_a_real_tab_in_a_real_shell(tmp_path, capsys):
    """Readline itself, on a terminal: `aritra lo<TAB>` becomes `aritra log `."""
    assert exit_code("completion", "bash") == 0
    (tmp_path / "rc").write_text(capsys.readouterr().out + "aritra() { echo GOT \"$@\"; }\nPS1='ready> '\n")
    terminal, its = os.openpty()
    command = ["bash", "--noprofile", "--rcfile", tmp_path / "rc", "-i"]
    with subprocess.Popen(command, stdin=its, stdout=its, stderr=its, env={**os.environ, "TERM": "dumb"}) as shell:
        os.close(its)
        said, typed = b"", False
        while b"GOT log" not in said and select.select([terminal], [], [], SOON)[0]:
            said += os.read(terminal, 4096)
            if b"ready> " in said and not typed:
                typed = os.write(terminal, b"aritra lo\tinfo\r") > 0
        shell.kill()
    os.close(terminal)
    assert b"GOT log info" in said
