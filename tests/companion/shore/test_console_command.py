"""The command line of the console: bad input, ports, keys, names."""

import pytest

from companion.__main__ import main
from companion.cli.shore import KeyFiles, default_name
from companion.core.configuration.tables import ConfigError


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
    assert main(["shore", "--port", "0", *arguments]) == 2
    assert says in capsys.readouterr().err


def test_a_taken_port_is_an_error_that_says_so(capsys):
    import socket

    with socket.create_server(("127.0.0.1", 0)) as taken:
        assert main(["shore", "--port", str(taken.getsockname()[1]), "--listen", "tcp/127.0.0.1:0"]) == 2
    assert "another --port?" in capsys.readouterr().err


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
    fleet = KeyFiles([f"{tmp_path}/fleet/"])
    assert fleet.find("a") is None, "the boats may come later"
    key(tmp_path / "fleet/a/command.key", 3)
    key(tmp_path / "fleet/command.key", 4)
    assert fleet.find("a") == b"\3" * 32 and fleet.find("c") == b"\4" * 32
    one.chmod(0o644)
    with pytest.raises(ConfigError, match="chmod 600"):
        KeyFiles([str(one)])


def test_the_default_name_is_one_that_boats_believe():
    import msgspec

    from companion.core.telemetry.order_gate import Name

    assert msgspec.convert(default_name(), Name)
