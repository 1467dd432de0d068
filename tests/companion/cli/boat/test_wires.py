"""The wires of a run on the command line stand in for the run file's, also where they are wrong."""

import pytest

from tests.companion.command_line import exit_code

GATE = ["provision", "--wiring", "gate"]


@pytest.mark.parametrize(
    ("command", "option"),
    [(["check"], "--mavlink"), (["check"], "--uwb"), (["run"], "--mavlink"), (["run"], "--uwb"), (GATE, "--mavlink")],
)
def test_a_wire_without_a_name_is_not_the_run_file_s(command, option, capsys, tmp_path, monkeypatch):
    """As of a shell variable that is not set: it drove what the run file names."""
    monkeypatch.chdir(tmp_path)
    assert exit_code(*command, option, "") == 2
    assert f"{option}: port '': expected one of udpin:HOST:PORT" in capsys.readouterr().err
