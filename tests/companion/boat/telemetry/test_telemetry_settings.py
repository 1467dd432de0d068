"""The telemetry table of the run file and zenoh's own configuration: safe defaults, errors that name file and key."""

import re

import pytest

from companion.boat.load_run import EXAMPLES
from companion.boat.uplink.telemetry import boat_name, config_of
from companion.core.configuration.run_file import TelemetryLink, load_run
from companion.core.configuration.tables import ConfigError
from tests.companion.boat.telemetry.telemetry_fixture import link_to


def test_the_boat_listens_nowhere_and_scouts_nothing_unless_told(tmp_path):
    (tmp_path / "zenoh.json5").write_text(
        '{listen: {endpoints: ["tcp/[::]:7447"]}, scouting: {multicast: {enabled: true}}}'
    )
    for file in (None, "zenoh.json5"):
        made = config_of(link_to(7447, config=file), tmp_path, where="run.toml")
        assert made.get_json("listen/endpoints") == "[]" and made.get_json("mode") == '"peer"'
        assert made.get_json("scouting/multicast/enabled") == "false" == made.get_json("scouting/gossip/enabled")
        assert made.get_json("connect/endpoints") == '["tcp/127.0.0.1:7447"]'
        assert made.get_json("transport/link/rx/max_message_size") == "1000000"
        assert made.get_json("transport/shared_memory/enabled") == "false"


def test_bad_configuration_names_file_and_key(tmp_path):
    with pytest.raises(ConfigError, match=r"run.toml: telemetry.config: .*missing.json5"):
        config_of(link_to(1, config="missing.json5"), tmp_path, where="run.toml")
    with pytest.raises(ConfigError, match=r"run.toml: telemetry.connect: .*somewhere"):
        config_of(TelemetryLink(connect=("somewhere",)), tmp_path, where="run.toml")


@pytest.mark.parametrize("endpoint", ["tcp/192.168.1.20", "udp/h:", "tls/[::1]", "quic/h:65536", "tcp/h#iface=a:7447"])
def test_an_endpoint_without_a_port_is_refused(endpoint, tmp_path):
    """Zenoh takes it, and tries in vain for ever."""
    with pytest.raises(ConfigError, match=re.escape(f"run.toml: telemetry.connect: {endpoint}: expected HOST:PORT")):
        config_of(TelemetryLink(connect=("tcp/h:1", endpoint)), tmp_path, where="run.toml")
    for good in ("tcp/[fe80::1%eth0]:7447", "tls/h:7447?rel=1", "udp/h:0#iface=eth0", "unixsock-stream/tmp/x"):
        config_of(TelemetryLink(connect=(good,)), tmp_path, where="run.toml")


@pytest.mark.parametrize(
    ("table", "key"),
    [
        ("", "telemetry: connect: expected a zenoh endpoint"),
        ('connect = ["tcp/h:1"]\ncommand_key = "k"', "command_key: without commands"),
        ('listen = ["tcp/h:1"]\nmode = "client"', "connect: a client needs a router"),
        ('connect = ["tcp/h:1"]\nboat = "a/b"', "telemetry.boat"),
        ('connect = ["tcp/h:1"]\nrate_Hz = 0', "telemetry.rate_Hz"),
        ('connect = ["tcp/h:1"]\nhistory_s = 1e9', "telemetry.history_s"),
        ('connects = ["tcp/h:1"]', "telemetry.connects: unknown key"),
    ],
)
def test_a_bad_table_in_the_run_file_names_its_key(table, key):
    text = (EXAMPLES / "aritra.toml").read_text() + f"\n[telemetry]\n{table}\n"
    with pytest.raises(ConfigError, match=re.escape(key)) as told:
        load_run(text, name="run.toml")
    assert str(told.value).startswith("run.toml: ")


def test_the_boats_name_in_keys():
    assert boat_name(link_to(1), "My boat / 2") == "My-boat-2"
    assert boat_name(link_to(1, boat="hull-7"), "x") == "hull-7" and boat_name(link_to(1), "***") == "boat"
