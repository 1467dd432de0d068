"""The command line of the console: bad input, ports, keys, names."""

import asyncio
import io
import socket
import sys
import threading
import webbrowser
from types import SimpleNamespace

import psutil
import pytest

from companion.__main__ import main
from companion.cli.shore import console
from companion.cli.shore.key_files import KeyFiles
from companion.cli.shore.network_options import default_name
from companion.core.configuration.tables import ConfigError
from companion.core.telemetry.order_gate import seal
from companion.core.telemetry.order_sender import NOWHERE, Sender
from companion.shore.console import keys
from tests.companion.command_line import exit_code


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--token", "short"], "--token: expected 8 to 100"),
        (["--name", "a\nb"], "--name"),
        (["--connect", "nonsense"], "--connect"),
        (["--config", "/nowhere.json5"], "--config: /nowhere.json5"),
        (["--command-key", "/nowhere.key"], "--command-key: /nowhere.key"),
    ],
)
def test_bad_input_is_named(arguments, says, capsys):
    assert exit_code("shore", "--port", "0", *arguments) == 2
    assert says in capsys.readouterr().err


@pytest.mark.parametrize(("host", "address"), [("0.0.0.0", "192.0.2.7"), ("::", "[2001:db8::7]")])
def test_from_the_network_every_address_of_this_machine_is_printed(host, address, monkeypatch):
    """Debian and Ubuntu name themselves 127.0.1.1 in /etc/hosts: a phone needs the address of the network's card."""
    found = ((socket.AF_INET, "192.0.2.7"), (socket.AF_INET6, "2001:db8::7"), (socket.AF_INET6, "fe80::7%wlan0"))
    cards = [SimpleNamespace(family=family, address=one) for family, one in found]
    monkeypatch.setattr(psutil, "net_if_addrs", lambda: {"wlan0": cards})
    monkeypatch.setattr(socket, "gethostname", lambda: "no-such-name.invalid")
    told = [line for line in console.addresses(host, 8470, "sesame-123") if "from the network" in line]
    assert told == [f"  from the network: http://{address}:8470/?token=sesame-123"]


@pytest.mark.parametrize(("host", "opened"), [("127.0.0.2", "127.0.0.2"), ("0.0.0.0", "127.0.0.1")])
def test_the_browser_is_sent_where_the_console_serves(host, opened, monkeypatch):
    pages = []
    monkeypatch.setattr(webbrowser, "open", pages.append)
    monkeypatch.setattr(console, "call_when_asked_to_end", lambda loop, end: loop.call_soon(end))
    assert main(["shore", "--host", host, "--port", "0", "--listen", "tcp/127.0.0.1:0", "--open"]) == 0
    assert [page.rsplit(":", 1)[0] for page in pages] == [f"http://{opened}"]


def test_a_taken_port_is_an_error_that_says_so(capsys):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        assert main(["shore", "--port", str(taken.getsockname()[1]), "--listen", "tcp/127.0.0.1:0"]) == 2
    assert "another --port?" in capsys.readouterr().err


def test_a_terminal_that_goes_ends_neither_the_console_nor_stop(monkeypatch):
    """As `aritra shore | tee log` without tee, a full disk, a lost terminal."""
    said, ended = threading.Event(), []

    class Gone(io.StringIO):
        def write(self, text):
            if text.startswith("zenoh: ready"):
                said.set()
                raise BrokenPipeError
            return super().write(text)

    def end_later(loop, end):
        async def wait():
            await asyncio.to_thread(said.wait, 20.0)
            await asyncio.sleep(0.05)
            ended.append(end())

        loop.waiting = asyncio.ensure_future(wait())

    monkeypatch.setattr(console, "call_when_asked_to_end", end_later)
    monkeypatch.setattr(sys, "stdout", Gone())
    assert main(["shore", "--port", "0", "--listen", "tcp/127.0.0.1:0"]) == 0
    assert said.is_set() and ended == [True], "it ended because it was asked to"


def test_keys_for_all_for_one_and_from_a_fleets_folder(tmp_path):
    def key(path, byte):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(bytes([byte]) * 32)
        path.chmod(0o600)
        return path

    one, other = key(tmp_path / "one", 1), key(tmp_path / "other", 2)
    found = KeyFiles([str(one), f"b={other}"])
    assert found.find("a") == b"\1" * 32 and found.find("b") == b"\2" * 32
    with pytest.raises(ConfigError, match="given twice for b"):
        KeyFiles([f"b={one}", f"b={other}"])
    with pytest.raises(ConfigError, match='No such file or directory; a folder that will be made later ends in "/"'):
        KeyFiles([str(tmp_path / "fleet")])
    fleet = KeyFiles([f"{tmp_path}/fleet/"])
    assert fleet.find("a") is None, "the boats may come later"
    key(tmp_path / "fleet/a/command.key", 3)
    key(tmp_path / "fleet/command.key", 4)
    assert fleet.find("a") == b"\3" * 32 and fleet.find("c") == b"\4" * 32
    one.chmod(0o644)
    with pytest.raises(ConfigError, match="chmod 600"):
        KeyFiles([str(one)])


@pytest.mark.parametrize("spoil", [lambda f: f.chmod(0o644), lambda f: f.write_bytes(b"\0"), lambda f: f.unlink()])
@pytest.mark.parametrize("fleet", [False, True])
def test_a_key_that_cannot_be_used_costs_its_boat_only_and_is_told(spoil, fleet, tmp_path, monkeypatch):
    """It ended the console for all boats."""
    monkeypatch.setattr(keys, "LOOK_S", 0.0)
    files = {}
    for boat in ("good", "bad"):
        files[boat] = tmp_path / boat / "command.key"
        files[boat].parent.mkdir()
        files[boat].write_bytes(bytes(range(32)))
        files[boat].chmod(0o600)
    spoil(files["bad"])
    options = [f"{tmp_path}/"] if fleet else [f"{boat}={file}" for boat, file in files.items()]
    held = keys.Keys(KeyFiles(options).find, "anna")
    assert isinstance(held.of("good"), Sender) and held.problem("good") == ""
    missing = fleet and not files["bad"].exists()
    assert missing or (f"{files['bad']}" in held.problem("bad") and "bad can be given no orders" in held.of("bad"))
    assert "no command key" in held.of("stranger") and held.problem("stranger") == ""
    files["bad"].write_bytes(bytes(range(32)))
    files["bad"].chmod(0o600)
    assert isinstance(held.of("bad"), Sender) and held.problem("bad") == "", "put right while it runs"


@pytest.mark.parametrize("option", ["{}", "boat={}", "{}/"])
def test_a_key_that_is_replaced_counts_and_one_that_is_away_for_a_moment_goes_on(option, tmp_path, monkeypatch):
    """A boat that was provisioned anew, or a demo in a new folder, refused STOP until the console was started anew."""
    monkeypatch.setattr(keys, "LOOK_S", 0.0)
    file = tmp_path / "command.key"

    def write(key):
        file.write_bytes(key)
        file.chmod(0o600)

    write(b"\1" * 32)
    held = keys.Keys(KeyFiles([option.format(tmp_path if option.endswith("/") else file)]).find, "anna")
    first = held.of("boat")
    assert isinstance(first, Sender) and held.of("boat") is first, "its orders are counted"
    file.unlink()
    assert held.of("boat") is first and held.problem("boat") == ""
    write(b"short")
    file.chmod(0o644)
    assert held.of("boat") is first and held.problem("boat") == ""
    write(b"\2" * 32)
    second = held.of("boat")
    assert isinstance(second, Sender)
    order = second.order("stop", at=NOWHERE)
    assert order.attachment == seal(b"\2" * 32, "boat", order.payload)


def test_no_name_of_a_boat_leads_out_of_the_folder(tmp_path):
    for folder in (tmp_path, tmp_path / "fleet"):
        folder.mkdir(exist_ok=True)
    (tmp_path / "command.key").write_bytes(bytes(range(32)))
    (tmp_path / "command.key").chmod(0o600)
    assert KeyFiles([f"{tmp_path}/fleet/"]).find("..") is None


def test_the_default_name_is_one_that_boats_believe():
    import msgspec

    from companion.core.telemetry.order_gate import Name

    assert msgspec.convert(default_name(), Name)
