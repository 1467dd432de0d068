"""`aritra provision` against an autopilot that is made by hand: what is never written, and never overwritten."""

import argparse
import contextlib
import shutil

import pytest
from rich.console import Console

from companion.cli.boat import provisioning
from companion.core.configuration.tables import ConfigError
from companion.core.model.load_vessel import load_vessel
from drivers.mavlink.provision.provisioner import StoredLog


class Autopilot:
    """`armed_from`: the question since which it says that it is armed. `logs`: (log, bytes)."""

    def __init__(self, armed_from=99, logs=()):
        self.asked, self.armed_from, self.stored, self.written = 0, armed_from, dict(logs), []

    async def armed(self):
        self.asked += 1
        return self.asked >= self.armed_from

    async def parameters(self):
        wanted = provisioning.parse_parameters((provisioning.FOLDER / "scaled.param").read_text(), name="scaled.param")
        return {name: value + 1 for name, value in wanted.items()}

    async def write(self, name, value):
        self.written.append(name)
        return value

    async def logs(self):
        return list(self.stored)

    async def download(self, log, path, progress):
        path.write_bytes(self.stored[log])


def provision(monkeypatch, autopilot, capsys, **more):
    """The command's exit code, and what it printed."""
    connect = contextlib.asynccontextmanager(lambda port, signing: _yields(autopilot))
    monkeypatch.setattr(provisioning.Provisioner, "connect", connect)
    options = {"config": provisioning.EXAMPLES / "aritra.toml", "mavlink": None, "unsigned": True, "logs": None}
    options |= {"wiring": "scaled", "dry_run": False, "yes": False, "reboot": False, "key": None} | more
    console = Console(width=200, force_terminal=False)
    monkeypatch.setattr(console, "input", lambda question: "y")
    code = provisioning.provision(argparse.Namespace(**options), console)
    return code, "".join(capsys.readouterr())


async def _yields(autopilot):
    yield autopilot


def test_an_autopilot_that_was_armed_while_the_table_was_read_is_left_alone(monkeypatch, capsys):
    sound, armed = Autopilot(), Autopilot(armed_from=2)
    assert provision(monkeypatch, sound, capsys)[0] == 0 and sound.written
    code, said = provision(monkeypatch, armed, capsys)
    assert code == 1 and "is armed: nothing was changed" in said and not armed.written


@pytest.mark.parametrize("date", ["1970-01-01T00:00:00Z", "2026-11-28T10:00:00Z"])
def test_logs_of_a_card_that_was_emptied_overwrite_none_and_none_is_there_twice(monkeypatch, capsys, tmp_path, date):
    days = [b"monday's only log", b"tuesday, another", b"monday's only log"]
    for content in days:
        log = StoredLog(number=1, date=date, size_bytes=len(content))
        code, _ = provision(monkeypatch, Autopilot(logs=[(log, content)]), capsys, logs=tmp_path)
        assert code == 0
    name = date.replace(":", "")
    found = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert found == {f"log-0001-{name}.bin": days[0], f"log-0001-{name}-2.bin": days[1]}


def test_without_a_clock_logs_of_one_length_are_told_apart_by_their_bytes(monkeypatch, capsys, tmp_path):
    for content in (b"monday", b"friday"):
        log = StoredLog(number=1, date="1970-01-01T00:00:00Z", size_bytes=6)
        provision(monkeypatch, Autopilot(logs=[(log, content)]), capsys, logs=tmp_path)
    assert sorted(path.read_bytes() for path in tmp_path.iterdir()) == [b"friday", b"monday"]


def test_the_gate_is_not_put_on_a_boat_whose_channels_it_does_not_pass(monkeypatch, capsys, tmp_path):
    """Its script would give thruster 1 the pulses of thruster 2, and read back the same."""
    shutil.copytree(provisioning.EXAMPLES, tmp_path / "deploy")
    vessel, config = tmp_path / "deploy/boats/aritra.toml", tmp_path / "deploy/aritra.toml"
    text = vessel.read_text(encoding="utf-8")
    swapped = text.replace("channel = 9\n", "channel = 0\n").replace("channel = 10", "channel = 9")
    vessel.write_text(swapped.replace("channel = 0\n", "channel = 10\n"), encoding="utf-8")
    with pytest.raises(
        ConfigError, match=r"passes channels 9 10 11 12 to .* of aritra are on 10 9 11 12, in this order"
    ):
        provision(monkeypatch, Autopilot(), capsys, wiring="gate", config=config)
    assert provision(monkeypatch, Autopilot(), capsys, wiring="scaled", config=config)[0] == 0, "its order is no matter"
    boats = [vessel.parent / f"{name}.toml" for name in ("aritra", "twin", "azimuth", "rudder", "lake", "blueboat")]
    for boat in boats[1:]:
        controls = load_vessel(boat.read_text(encoding="utf-8"), name=boat.name).controls
        assert [one.channel for one in controls] == [9, 10, 11, 12][: len(controls)], "the example boats take it"
