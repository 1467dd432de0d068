"""Several boats on one machine: names, run files, keys, and the simulator's wires."""

import os
import re
import signal
import stat
import subprocess

import pytest

from companion.__main__ import main
from companion.boat.load_run import EXAMPLES, load_setup
from companion.boat.signing_key import load_secret
from companion.cli.options.run_file_text import absolute, toml_of
from companion.cli.simulator.fleet import MOST, SHORE, FleetWires, default_name, fleet, names_of
from companion.core.configuration.run_file import load_run
from companion.core.configuration.tables import ConfigError
from companion.core.telemetry.order_gate import seal
from companion.python_child import aritra
from tests.support.zenoh_fixture import wait_for

DVL = '\n[sensors.dvl]\nrate_Hz = 5.0\nvelocity_sigma_m_s = 0.02\nsource = "assumed"\n'
TELEMETRY = '\n[telemetry]\nconnect = ["tls/shore:7447"]\nconfig = "zenoh.json5"\nhistory_s = 30.5\n'


def config_with(folder, more=""):
    """The example's run file in a folder of its own, with `more` at its end."""
    text = (EXAMPLES / "aritra.toml").read_text()
    for name in ("boats", "sites", "missions"):
        text = text.replace(f'"{name}/', f'"{os.path.relpath(EXAMPLES, folder)}/{name}/')
    (folder / "my.toml").write_text(text + more)
    return folder / "my.toml"


def made(tmp_path, names, *, more="", shore=None, wires=None):
    config = config_with(tmp_path, more)
    return fleet({n: tmp_path / "out" / n for n in names}, load_setup(config), config, shore, wires or {})


def test_a_number_of_boats_is_called_after_the_one():
    assert names_of("3", "aritra") == ("aritra-1", "aritra-2", "aritra-3")
    assert names_of("anna, bob.2", "aritra") == ("anna", "bob.2")
    assert default_name(load_setup(EXAMPLES / "aritra.toml")) == "aritra"


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("anna,bob,anna", "--boats: 'anna' is there twice: on shore the two would be one"),
        ("0", "--boats: 0: expected 1 to 100"),
        (str(MOST + 1), "expected 1 to 100"),
        ("²", "--boats: '²': expected 1 to 40 letters"),
        ("9" * 5000, "expected 1 to 100"),
        ("-3", None),
        ("anna,", "--boats: '': expected 1 to 40 letters"),
        ("anna/../bob", "expected 1 to 40 letters"),
        ("..", "'..': expected 1 to 40 letters"),
        ("", "expected 1 to 40 letters"),
    ],
)
def test_names_that_do_not_work_are_refused_in_words(text, told):
    if told is None:
        assert names_of(text, "a") == (text,), "a name, if an odd one"
    else:
        with pytest.raises(ConfigError, match=re.escape(told)):
            names_of(text, "a")


@pytest.mark.parametrize("command", ["demo", "sim"])
def test_a_name_twice_is_refused_before_anything_starts(command, tmp_path, capsys):
    assert main([command, "--boats", "anna,anna", "--out", str(tmp_path / "out")]) == 2
    told = capsys.readouterr()
    assert told.err.startswith(f"aritra {command}: --boats: 'anna' is there twice") and not told.out
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("command", ["demo", "sim"])
@pytest.mark.parametrize("endpoint", ["192.168.1.20:7447", "tcp/192.168.1.20"])
def test_a_shore_that_is_no_endpoint_is_refused_before_anything_starts(command, endpoint, tmp_path, capsys):
    assert main([command, "--shore", endpoint, "--out", str(tmp_path / "out")]) == 2
    told = capsys.readouterr()
    assert told.err.startswith(f"aritra {command}: --shore: ") and endpoint in told.err and not told.out
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("option", ["--udp-to", "--tcp"])
def test_ports_beyond_the_last_one_are_refused_before_anything_starts(option, tmp_path, capsys):
    words = ["sim", "--boats", "2", option, "127.0.0.1:65530", "--out", str(tmp_path / "out")]
    assert main(words) == 2
    told = capsys.readouterr().err
    assert told.startswith(f"aritra sim: {option}: 127.0.0.1:65530: boat 2 would need port 65540")
    assert not (tmp_path / "out").exists()


def test_each_boat_has_a_run_file_with_its_name_wires_and_key(tmp_path):
    wires = {"bob": FleetWires("udpin:127.0.0.1:14561", "/tmp/bobs-tag")}
    boats = made(tmp_path, ["anna", "bob"], shore=SHORE, wires=wires)
    setups = [load_setup(boat.config) for boat in boats]
    links = [s.run.telemetry for s in setups]
    assert [x.boat for x in links] == ["anna", "bob"] and all(x.connect == (SHORE,) and x.commands for x in links)
    assert [s.run.uwb.url for s in setups] == ["serial:/tmp/aritra-uwb:115200", "serial:/tmp/bobs-tag:115200"]
    assert setups[0].pilot.vessel == load_setup(EXAMPLES / "aritra.toml").pilot.vessel
    assert setups[0].run.log.folder == str(boats[0].folder.resolve())
    keys = [load_secret(boat.folder / "command.key", where="test") for boat in boats]
    assert keys[0] != keys[1] and seal(keys[0], "anna", b"stop") != seal(keys[1], "anna", b"stop")
    assert stat.S_IMODE((boats[0].folder / "command.key").stat().st_mode) == 0o600
    made(tmp_path, ["anna", "bob"], shore=SHORE)
    assert load_secret(boats[0].folder / "command.key", where="test") == keys[0], "shore may have it already"


def test_a_boat_with_a_velocity_log_has_both_wires_in_its_run_file(tmp_path):
    """It was refused: `dvl: unknown key`."""
    config = config_with(tmp_path, '\n[devices.dvl]\nurl = "serial:/dev/dvl:115200"\n')
    (tmp_path / "boat.toml").write_text((EXAMPLES / "boats/aritra.toml").read_text() + DVL)
    config.write_text(re.sub(r'vessel = ".*"', 'vessel = "boat.toml"', config.read_text()))
    folders = {name: tmp_path / "out" / name for name in ("anna", "bob")}
    wires = {"bob": FleetWires("udpin:127.0.0.1:14561", "/tmp/uwb-bob")}
    boats = fleet(folders, load_setup(config), config, SHORE, wires)
    urls = [load_setup(boat.config).run.devices["dvl"].url for boat in boats]
    assert urls == ["serial:/dev/dvl:115200", "serial:/tmp/dvl-bob:115200"]


def test_the_run_files_own_telemetry_is_kept_but_for_name_and_shore(tmp_path):
    (alone,) = made(tmp_path, ["anna"], more=TELEMETRY)
    link = load_setup(alone.config).run.telemetry
    assert (link.boat, link.connect, link.history_s, link.commands) == ("anna", ("tls/shore:7447",), 30.5, False)
    assert link.config == str(tmp_path / "zenoh.json5") and not (alone.folder / "command.key").exists()
    (other,) = made(tmp_path, ["bob"], more=TELEMETRY, shore="tcp/x:1")
    assert load_setup(other.config).run.telemetry.connect == ("tcp/x:1",)
    (silent,) = made(tmp_path, ["carl"])
    assert load_setup(silent.config).run.telemetry is None


@pytest.mark.parametrize(
    ("more", "told"),
    [
        ('[forward]\nurl = "udpout:127.0.0.1:14550"\n', "my.toml: forward: several boats"),
        ('[telemetry]\nlisten = ["tcp/0.0.0.0:7447"]\n', "my.toml: telemetry.listen: boats of a fleet connect"),
    ],
)
def test_what_several_boats_cannot_share_is_refused(tmp_path, more, told):
    with pytest.raises(ConfigError, match=re.escape(told)):
        made(tmp_path, ["anna", "bob"], more=more)


def test_a_run_file_survives_being_written(tmp_path):
    more = (
        TELEMETRY + 'commands = true\ncommand_key = "a \\"b\\" \\\\ \u00e9.key"\n[vision]\nrate_Hz = 5.0\n'
        '[forward]\nurl = "udpout:127.0.0.1:14550"\n'
    )
    run = absolute(load_setup(config_with(tmp_path, more)).run, tmp_path)
    assert load_run(toml_of(run), name="written") == run
    assert run.vessel == str((EXAMPLES / "boats/aritra.toml").resolve())


@pytest.mark.long
def test_the_simulator_starts_several_boats_on_wires_of_their_own(tmp_path):
    """Real processes: each says where it is and how to run its companion, whose run file names the same places."""
    sim = ["sim", "--boats", "anna,bob", "--out", str(tmp_path / "out"), "--shore", "--udp-to", "127.0.0.1:24551",
           "--uwb", str(tmp_path / "tag"), "--truth", str(tmp_path / "truth.mcap")]  # fmt: skip
    out = tmp_path / "out.txt"
    with out.open("w") as file:
        child = subprocess.Popen(aritra(*sim), stdout=file, stderr=subprocess.STDOUT)
    try:
        wait_for(lambda: out.read_text().count("simulator: ") == 2 or child.poll() is not None, what=out.read_text)
        assert child.poll() is None, out.read_text()
        for name, port in (("anna", 24551), ("bob", 24561)):
            config = tmp_path / "out" / name / "aritra.toml"
            assert re.search(rf"simulator: {name}: .* to 127.0.0.1:{port}.*aritra run --start --config {config}\n",
                             out.read_text())  # fmt: skip
            run = load_setup(config).run
            assert (
                run.mavlink.url == f"udpin:127.0.0.1:{port}" and run.uwb.url == f"serial:{tmp_path}/tag-{name}:115200"
            )
            assert (tmp_path / f"tag-{name}").exists() and (tmp_path / f"truth-{name}.mcap").exists()
    finally:
        child.send_signal(signal.SIGINT)
        assert child.wait(10) == 0
    assert not (tmp_path / "tag-anna").exists()


def test_several_boats_and_a_real_autopilot_do_not_go_together(capsys):
    assert main(["sim", "--boats", "2", "--ardupilot-json"]) == 2
    assert "--boats: is for the simulated autopilot" in capsys.readouterr().err
