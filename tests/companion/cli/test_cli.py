"""The command line: help that helps, exit codes that mean something, errors that name file and key."""

import argparse
import json
import os
import socket
import subprocess

import pytest

from companion.__main__ import parser
from companion.boat.load_run import EXAMPLES
from companion.cli.simulator.world_options import add_world_arguments, world_arguments
from companion.python_child import aritra, python
from tests.companion.command_line import exit_code
from tests.support.drive_fixture import setup

SOON = 60.0


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ([], ["demo", "run", "sim", "replay", "log"]),
        (["demo"], ["--out", "--config", "--seed", "--mismatch", "--boats", "--shore", "--stagger", "Exit code"]),
        (["run"], ["--config", "--mission", "--mavlink", "--uwb", "--log", "--start", "--end-after", "Exit code"]),
        (["sim"], ["--udp-to", "--tcp", "--uwb", "--truth", "--seed", "--dropout", "--boats"]),
        (["replay"], ["LOG", "Exit code"]),
        (["identify"], ["LOG", "--vessel", "--out", "--held-out", "--block", "--no-taylor", "--peer", "Exit code"]),
        (["log"], ["info", "plot", "recover"]),
        (["log", "info"], ["--json", "LOG"]),
        (["log", "plot"], ["--truth", "--out", "-o"]),
        (["log", "recover"], ["--out", "-o"]),
    ],
    ids=" ".join,
)
def test_every_command_helps(command, words, capsys):
    assert exit_code(*command, "--help") == 0
    told = capsys.readouterr().out
    told = " ".join(told.split())
    assert all(word in told for word in words), told


@pytest.mark.parametrize(
    ("modules", "slow"),
    [
        ("companion.__main__", "casadi numpy scipy"),
        (
            "companion.cli.diagnose, sim.fitting.diagnose.report.record, companion.logs.readers.read_run",
            "filterpy matplotlib pymavlink",
        ),
    ],
    ids=("any", "diagnose"),
)
def test_a_command_brings_no_slow_library_that_it_does_not_need(modules, slow):
    told = f"import sys, {modules}; print(*sorted(set('{slow}'.split()) & set(sys.modules)))"
    assert subprocess.check_output(python("-c", told), text=True, timeout=120).split() == []


def test_a_reader_that_has_read_enough_is_no_traceback():
    """As in `aritra completion bash | head -1`."""
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run(aritra("completion", "bash"), stdout=write, stderr=subprocess.PIPE, timeout=SOON, check=False)
    os.close(write)
    assert (done.returncode, done.stderr) == (141, b"")


def test_the_version_is_told(capsys):
    assert exit_code("--version") == 0
    assert capsys.readouterr().out.startswith("aritra ")


@pytest.mark.parametrize(
    "argv",
    [[], ["swim"], ["run", "--speed", "3"], ["replay"], ["sim", "--seed", "one"], ["run", "--end-after", "soon"]],
)
def test_what_is_not_a_command_line_is_refused_with_usage(argv, capsys):
    assert exit_code(*argv) == 2
    assert "usage: aritra" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["run", "sim", "demo"])
def test_a_missing_run_file_is_named(command, tmp_path, capsys):
    assert exit_code(command, "--config", str(tmp_path / "none.toml")) == 2
    told = capsys.readouterr().err
    assert told.startswith(f"aritra {command}: --config: {tmp_path / 'none.toml'}: No such file or directory\n")


@pytest.mark.parametrize("command", ["run", "sim", "demo"])
def test_an_unknown_key_is_named(command, tmp_path, capsys):
    text = (EXAMPLES / "aritra.toml").read_text().replace("tag =", "tagg =")
    (tmp_path / "my.toml").write_text(text)
    assert exit_code(command, "--config", str(tmp_path / "my.toml")) == 2
    assert f"{tmp_path / 'my.toml'}: uwb.tagg: unknown key" in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--mavlink", "--uwb"])
@pytest.mark.parametrize("url", ["carrier-pigeon:roof", "udpin:127.0.0.1:port", "serial:", "tcp:host"])
def test_a_bad_url_is_named(option, url, tmp_path, capsys):
    assert exit_code("run", option, url, "--log", str(tmp_path / "run.mcap")) == 2
    told = capsys.readouterr().err
    assert f"{option}: port {url!r}: " in told
    assert not (tmp_path / "run.mcap").exists()


def test_a_bad_url_in_the_run_file_is_named_by_its_key(tmp_path, capsys):
    for name in ("boats", "sites", "missions"):
        (tmp_path / name).symlink_to(EXAMPLES / name)
    text = (EXAMPLES / "aritra.toml").read_text().replace('url = "udpin', 'url = "udpinn')
    (tmp_path / "my.toml").write_text(text)
    assert exit_code("run", "--config", str(tmp_path / "my.toml"), "--log", str(tmp_path / "run.mcap")) == 2
    assert f"{tmp_path / 'my.toml'}: mavlink.url: port 'udpinn:" in capsys.readouterr().err


def test_a_bad_mission_is_named_with_its_items(tmp_path, capsys):
    plan = json.loads((EXAMPLES / "missions" / "square.plan").read_text())
    plan["mission"]["items"][2]["command"] = 22
    (tmp_path / "bad.plan").write_text(json.dumps(plan))
    assert exit_code("run", "--mission", str(tmp_path / "bad.plan"), "--log", str(tmp_path / "run.mcap")) == 2
    told = capsys.readouterr().err
    assert str(tmp_path / "bad.plan") in told and "items[2]" in told and "22" in told
    assert not (tmp_path / "run.mcap").exists()


@pytest.mark.parametrize("address", ["localhost", "127.0.0.1:", "127.0.0.1:70000", "127.0.0.1:udp"])
def test_a_bad_address_is_named(address, capsys):
    assert exit_code("sim", "--udp-to", address) == 2
    assert "expected HOST:PORT" in capsys.readouterr().err


@pytest.mark.parametrize("command", [["run", "--log"], ["sim", "--truth"]], ids=["run", "sim"])
def test_a_log_is_never_overwritten(command, tmp_path, capsys):
    (tmp_path / "old.mcap").write_bytes(b"precious")
    assert exit_code(*command, str(tmp_path / "old.mcap")) == 2
    assert f"{tmp_path / 'old.mcap'}: exists already" in capsys.readouterr().err
    assert (tmp_path / "old.mcap").read_bytes() == b"precious"


@pytest.mark.parametrize("command", [["run", "--log"], ["sim", "--truth"]], ids=["run", "sim"])
def test_a_log_that_cannot_be_written_is_named(command, tmp_path, capsys):
    assert exit_code(*command, str(tmp_path / "no" / "run.mcap")) == 2
    assert "No such file or directory" in capsys.readouterr().err


def test_a_folder_for_the_demo_that_is_a_file_is_named(tmp_path, capsys):
    (tmp_path / "out").write_text("")
    assert exit_code("demo", "--out", str(tmp_path / "out")) == 2
    assert str(tmp_path / "out") in capsys.readouterr().err


def test_log_info_tells_what_is_in_a_log(drive_log, capsys):
    path = drive_log(5.0)
    assert exit_code("log", "info", str(path)) == 0
    told = capsys.readouterr().out
    assert "/override_lease" in told and "synthetic" in told
    assert exit_code("log", "info", str(path.with_name("none.mcap"))) == 2


def test_the_demo_hands_the_world_on_to_its_simulator():
    given = ["--seed", "4", "--start", "1", "2", "3", "--current", "0.1", "45", "--wind", "3", "200", "--gusts", "0.3",
             "--waves", "0.1", "--mismatch", "0.1", "--nlos", "0.05", "--dropout", "0.2"]  # fmt: skip
    world = argparse.ArgumentParser()
    add_world_arguments(world)
    args = world.parse_args(given)
    assert world.parse_args(world_arguments(args)) == args != world.parse_args([])
    assert parser().parse_args(["demo", *given]).wind == parser().parse_args(["sim", *given]).wind
    for given in ([], ["--current", "0", "0"], ["--waves", "0"]):  # what is not stated is not 0
        args = world.parse_args(given)
        assert world.parse_args(world_arguments(args)) == args


BROKEN = """
import sys
from companion.core.pilot.pilot import Pilot
from companion.core.messages import Tick
step = Pilot.step
def broken(self, state, inputs, t_ns):
    if any(isinstance(i, Tick) and i.index >= 3 for i in inputs):
        raise ArithmeticError("a bug in the core")
    return step(self, state, inputs, t_ns)
Pilot.step = broken
from companion.__main__ import main
sys.exit(main(sys.argv[1:]))
"""


def free_udp_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.mark.long
def test_a_run_whose_core_raises_ends_with_exit_code_1(tmp_path):
    wires = ["--mavlink", f"udpin:127.0.0.1:{free_udp_port()}", "--uwb", f"serial:{tmp_path / 'tag'}:115200"]
    ended = subprocess.run(
        python("-c", BROKEN, "run", *wires, "--log", str(tmp_path / "run.mcap")),
        capture_output=True, text=True, timeout=SOON, check=False, env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )  # fmt: skip
    assert ended.returncode == 1
    assert "ArithmeticError: a bug in the core" in ended.stderr
    assert f"configuration {setup(None).digest}: vessel aritra" in ended.stdout
    assert exit_code("log", "info", str(tmp_path / "run.mcap")) == 0, "the log was closed"
