"""`aritra commission`: what it refuses, in a sentence, before anything moves; and one flight on real wires."""

import re
import shutil
import signal
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import psutil
import pytest

from companion.boat.load_run import EXAMPLES, load_setup
from companion.boat.recorder import Recorder
from companion.cli.commission import COMMISSIONED, fly_on, write
from companion.cli.interrupts import ended_as_by_ctrl_c
from companion.cli.options.setup import setup_instead
from companion.core.configuration.tables import ConfigError
from companion.core.excitation.file import Excitation, Pulses, excitation_toml
from companion.core.messages import Alert, ExcitationStatus, Message, ModeStatus
from companion.logs.log_file import LogFile
from companion.python_child import python
from sim.commission import boats
from sim.commission.boats import RealBoat
from sim.commission.journal import LOG
from tests.companion.command_line import exit_code
from tests.support.boat_processes import boat_processes
from tests.support.drive_fixture import mission_text

BOATS = EXAMPLES / "boats"


def refused(capsys, *words: object) -> str:
    assert exit_code("commission", *map(str, words)) == 2
    return capsys.readouterr().err


def test_a_boat_with_servos_is_refused(tmp_path, capsys):
    told = refused(capsys, "--vessel", BOATS / "rudder.toml", "--out", tmp_path / "c")
    assert "rudder.toml" in told and "commissioning" in told and not (tmp_path / "c").exists()


def test_a_simulated_boat_with_other_thrusters_is_refused(tmp_path, capsys):
    told = refused(capsys, "--simulate", BOATS / "blueboat.toml", "--out", tmp_path / "c")
    assert "--simulate" in told and "as many thrusters" in told


def with_fence(folder, side_m: float) -> Path:
    """The demo's site with a square fence from 0 to `side_m`."""
    corners = f"[[0.0, 0.0], [{side_m}, 0.0], [{side_m}, {side_m}], [0.0, {side_m}]]"
    text = re.sub(r"fence = .*", f"fence = {corners}", (EXAMPLES / "sites" / "basin.toml").read_text())
    (path := folder / f"square-{side_m:g}.toml").write_text(text)
    return path


@pytest.mark.parametrize("words", [(), ("--simulate", BOATS / "aritra.toml")], ids=["boat", "simulated"])
def test_a_mission_that_does_not_fit_the_site_of_the_command_line_is_refused_at_once(words, tmp_path, capsys):
    told = refused(capsys, "--site", with_fence(tmp_path, 12.0), "--out", tmp_path / "c", *words)
    assert re.search(r"square\.toml: waypoint \d at .* beyond the fence", told) and not (tmp_path / "c").exists()


def test_a_site_of_the_command_line_with_room_for_the_mission_is_taken(tmp_path):
    far = tmp_path / "far.toml"
    far.write_text(mission_text(((10.0, 10.0), (60.0, 60.0))))
    with pytest.raises(ConfigError, match=r"far\.toml: waypoint 2 .* beyond the fence"):
        setup_instead(EXAMPLES / "aritra.toml", {}, "flights", mission=far)
    site = with_fence(tmp_path, 80.0)
    setup = setup_instead(EXAMPLES / "aritra.toml", {"site.toml": site}, "flights", mission=far)
    assert setup.pilot.site.fence[2] == (80.0, 80.0) and setup.pilot.mission.path.waypoints[1].north_m == 60.0


def test_manoeuvres_without_room_among_the_missions_fences_are_refused_at_once(tmp_path, capsys):
    zone = "[[fences]]\ninclusion = false\npolygon = [[5, 5], [25, 5], [25, 25], [5, 25]]\n"
    (tmp_path / "round.toml").write_text(mission_text(((3.0, 3.0), (3.0, 27.0))) + zone)
    told = refused(capsys, "--mission", tmp_path / "round.toml", "--out", tmp_path / "c")
    assert "library.toml: margin_m + return_m" in told and not (tmp_path / "c").exists()


def test_a_folder_with_other_things_is_refused_and_left_alone(tmp_path, capsys):
    (tmp_path / "notes.txt").write_text("mine")
    told = refused(capsys, "--simulate", BOATS / "aritra.toml", "--out", tmp_path)
    assert "another --out" in told and [p.name for p in tmp_path.iterdir()] == ["notes.txt"]


def test_too_few_minutes_for_proof_and_missions_are_refused(tmp_path, capsys):
    assert "--minutes: '3': expected minutes, 9 to 240" in refused(capsys, "--minutes", 3, "--out", tmp_path / "c")


def test_flights_find_the_keys_that_the_run_file_names(tmp_path, monkeypatch):
    class BegunError(Exception):
        pass

    def begun(_self):
        raise BegunError

    monkeypatch.setattr("sim.commission.job.Commissioning.run", begun)
    mine, out = tmp_path / "my", tmp_path / "out"
    shutil.copytree(EXAMPLES, mine)
    run = mine / "aritra.toml"
    keys = '[telemetry]\nconnect = ["tcp/127.0.0.1:7447"]\ncommands = true\ncommand_key = "command.key"\n'
    run.write_text(run.read_text().replace("[mavlink]", '[mavlink]\nsigning_key = "keys/boat.key"') + keys)
    with pytest.raises(BegunError):
        exit_code("commission", "--config", str(run), "--out", str(out))
    flown = load_setup(out / "run.toml").run
    assert flown.mavlink.signing_key == str(mine / "keys/boat.key")
    assert flown.telemetry and flown.telemetry.command_key == str(mine / "command.key")


def test_a_library_without_a_manoeuvre_that_proves_a_file_is_refused_before_anything_is_flown(tmp_path, capsys):
    pulses = EXAMPLES / "excitations" / "pulses.toml"
    told = refused(capsys, "--library", pulses, "--simulate", BOATS / "aritra.toml", "--out", tmp_path / "c")
    assert 'pulses.toml: segments: none has the name "zig-zag" or "multisine"' in told
    assert not (tmp_path / "c").exists()


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("--current", "0.2", "30"), "--current: only with --simulate"),
        (("--seed", "3"), "--seed: only with --simulate"),
        (("--mavlink", "/dev/ttyACM0"), "--mavlink: port '/dev/ttyACM0': expected one of"),
        (("--simulate", BOATS / "aritra.toml", "--uwb", "serial:/dev/ttyUSB0"), "not with --simulate"),
    ],
)
def test_words_that_would_be_without_effect_are_refused(words, why, tmp_path, capsys):
    assert why in refused(capsys, *words, "--out", tmp_path / "c") and not (tmp_path / "c").exists()


def outcome(reached: bool, signs_known: bool = True) -> SimpleNamespace:
    vessel = load_setup(EXAMPLES / "aritra.toml").pilot.vessel
    return SimpleNamespace(belief=SimpleNamespace(fit="a fit", signs_known=signs_known), reached=reached, vessel=vessel)


def test_a_vessel_file_is_not_written_over_what_a_person_changed_nor_over_a_proven_one(tmp_path, monkeypatch):
    monkeypatch.setattr("sim.commission.report.report", lambda *_all: "page")
    path = tmp_path / COMMISSIONED
    assert COMMISSIONED not in write(outcome(False, signs_known=False), tmp_path, None, None) and not path.exists()
    assert write(outcome(False), tmp_path, None, None)[COMMISSIONED].endswith("drive with, NOT PROVEN")
    assert write(outcome(True), tmp_path, None, None)[COMMISSIONED].endswith("drive with, proven")
    proven = path.read_text()
    assert "left as it is" in write(outcome(False), tmp_path, None, None)[COMMISSIONED] and path.read_text() == proven
    path.write_text(proven + "# mass weighed by me\n")
    assert "changed by hand" in write(outcome(True), tmp_path, None, None)[COMMISSIONED]
    assert path.read_text().endswith("# mass weighed by me\n")


def test_time_to_let_go_of_the_boat_comes_before_its_thrusters_may_turn(tmp_path, monkeypatch):
    order = list[str]()
    monkeypatch.setattr(boats, "dependent_aritra", lambda *_words: order.append("run") or python("-c", ""))
    RealBoat(warn=lambda: order.append("warned")).fly({}, tmp_path, lambda _text: None)
    assert order[-1] == "warned" or order == ["run", "warned"]


@pytest.mark.parametrize(("terminal", "answer", "goes_on"), [(False, "y", False), (True, "y", True), (True, "", False)])
def test_only_a_person_at_the_terminal_lets_it_fly_on(terminal, answer, goes_on, monkeypatch):
    asked = list[str]()
    monkeypatch.setattr("sys.stdin.isatty", lambda: terminal, raising=False)
    monkeypatch.setattr("builtins.input", lambda text: asked.append(text) or answer)
    assert RealBoat(ask=fly_on).goes_on("safe: hand at the transmitter") is goes_on
    assert all("safe: hand at the transmitter" in text for text in asked) and bool(asked) is terminal


def test_a_boat_does_not_drive_on_where_its_commissioning_is_asked_to_end(tmp_path, monkeypatch):
    there = tmp_path / "pid"
    program = f"import os, pathlib, time; pathlib.Path('{there}').write_text(str(os.getpid())); time.sleep(60)"
    monkeypatch.setattr(boats, "dependent_aritra", lambda *_words: python("-c", program))

    def ask_to_end():
        while not (there.exists() and there.read_text()):
            time.sleep(0.01)
        signal.raise_signal(signal.SIGTERM)

    asking = threading.Thread(target=ask_to_end)
    with pytest.raises(KeyboardInterrupt), ended_as_by_ctrl_c():
        asking.start()
        RealBoat().fly({}, tmp_path, lambda _text: None)
    asking.join()
    assert not psutil.pid_exists(int(there.read_text()))


def flight(folder: Path) -> dict[str, str]:
    """Files of a flight of pulses, in `folder`, which is made."""
    one = Pulses(name="each thruster", levels=(0.3,), on_s=0.2, off_s=0.3)
    plan = Excitation(format=1, name="signs", homing=False, segments=(one,))
    setup = load_setup(EXAMPLES / "aritra.toml")
    files = {**setup.files, "excitation.toml": excitation_toml(plan)}
    for old, new in (("boats/aritra", "vessel"), ("sites/basin", "site"), ("missions/square", "mission")):
        files["run.toml"] = files["run.toml"].replace(f'"{old}.toml"', f'"{new}.toml"')
    folder.mkdir()
    for name, text in files.items():
        (folder / name).write_text(text)
    return files


IMPATIENT = """
import sys
from companion.__main__ import main
from companion.cli.boat import run
run.SWITCH_ON_S = 1.0
sys.exit(main(sys.argv[1:]))
"""
"""`aritra` whose run waits a second for the autopilot, not a minute."""


@pytest.mark.long
def test_a_flight_without_an_autopilot_ends_and_says_so(tmp_path, monkeypatch):
    """Its run waited for an operator, for a quarter of an hour."""
    monkeypatch.setattr(boats, "LIMIT_S", 120.0)
    monkeypatch.setattr(boats, "dependent_aritra", lambda *words: python("-c", IMPATIENT, *words))
    files = flight(folder := tmp_path / "01-signs")
    wires = ("--mavlink", f"pty:{tmp_path / 'nobody'}", "--uwb", f"pty:{tmp_path / 'no tag'}")
    flown = RealBoat(wires).fly(files, folder, lambda _text: None)
    assert flown == boats.Flown(False, "excite expired: it waited for an autopilot; give it again")


def log_of(path: Path, *messages: Message) -> Path:
    """A log of these messages."""
    with Recorder(path, {}, lambda: 0, wall_offset_ns=0, background=False) as recorder:
        for message in messages:
            recorder.record(message)
    return path


def test_why_a_flight_ended_is_the_last_that_its_log_says(tmp_path):
    text = "excite expired: it waited for an autopilot; give it again"
    gone, idle = Alert(t_ns=1, level="warning", text=text), ModeStatus(t_ns=2, mode="idle", why="waits", driving=False)
    safe = ModeStatus(t_ns=3, mode="safe", why="no heartbeat", driving=False)
    assert boats.last_reason(log_of(tmp_path / "1.mcap", idle, gone, idle)) == text
    assert boats.last_reason(log_of(tmp_path / "2.mcap", gone, idle, safe)) == "safe: no heartbeat"
    assert boats.last_reason(log_of(tmp_path / "3.mcap", idle)) == "idle: waits"


@pytest.mark.real_time
@pytest.mark.long
def test_a_flight_on_real_wires_leaves_its_log_in_its_folder(tmp_path):
    files = flight(folder := tmp_path / "01-signs")
    with boat_processes(tmp_path, None, Path("scaled.param")) as boat:
        wires = ("--mavlink", boat.url, "--uwb", f"serial:{boat.tag}:115200", "--unchecked")
        flown = RealBoat(wires).fly(files, folder, lambda _text: None)
    assert flown.done and flown.ending == "done"
    phases = [m.phase for m in LogFile(folder / LOG).messages(ExcitationStatus) if isinstance(m, ExcitationStatus)]
    assert "fly" in phases and phases[-1] == "done"
