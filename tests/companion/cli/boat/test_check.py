"""`aritra check` and `aritra provision` from the command line, beside the simulated autopilot on a TCP port."""

import asyncio
import contextlib
import json
import math
import re
import shutil
import threading

import pytest

from companion.__main__ import main
from companion.boat.load_run import EXAMPLES
from companion.boat.preflight import RUN_PREARM_CHECKS
from companion.cli.boat.provisioning import SCRIPT, SCRIPTS, file_name
from drivers.mavlink.encode import MavlinkEncoder
from drivers.mavlink.provision.provisioner import StoredLog
from drivers.ports.pseudo_terminal import PtyPort
from drivers.uwb.dwm1001 import AnchorReport, TagFix, encode_lec
from sim.world.autopilot.mavlink.files import FtpFiles
from sim.world.autopilot.mavlink.logs import Logs
from sim.world.autopilot.parameter_table import BOARD_PARAMETERS
from tests.companion.command_line import exit_code
from tests.sim.world.autopilot.autopilot_process import booted_rover, served
from tests.sim.world.wirings.wiring_fixture import load

TAG_HZ = 4.0


@contextlib.contextmanager
def sailing(rover, tag=None):
    """The rover on a TCP port, in a thread of its own; `tag`: path of a UWB tag that tells ranges and position."""
    ready, ended, found = threading.Event(), threading.Event(), {}

    async def play():
        async with served(rover) as (_, tcp):
            found["url"] = f"tcp:127.0.0.1:{tcp[1]}"
            ranging = asyncio.create_task(ranges(tag)) if tag else None
            ready.set()
            while not ended.is_set():
                await asyncio.sleep(0.02)
            if ranging:
                ranging.cancel()
                await asyncio.gather(ranging, return_exceptions=True)

    thread = threading.Thread(target=lambda: asyncio.run(play()))
    thread.start()
    try:
        assert ready.wait(10)
        yield found["url"]
    finally:
        ended.set()
        thread.join(10)


async def ranges(path):
    """A DWM1001 in the middle of the basin, with `TAG_HZ`."""
    port = PtyPort(str(path))
    corners = {"1151": (0.0, 0.0, 2.5), "0CA8": (0.0, 30.0, 2.5), "111C": (30.0, 30.0, 2.5)}
    anchors = [AnchorReport(name, xyz, math.dist(xyz, (15.0, 15.0, 0.4)), 90) for name, xyz in corners.items()]
    await port.open()
    try:
        while True:
            port.send(encode_lec(anchors, TagFix((15.0, 15.0, 0.4), 90)))
            await asyncio.sleep(1.0 / TAG_HZ)
    finally:
        await port.close()


def boat(wiring, **rover):
    return booted_rover(parameters={**BOARD_PARAMETERS, **load(wiring)}, **rover)


def check(url, capsys, tmp_path, *options):
    """Exit code, and the rows by name."""
    words = ["--mavlink", url, "--uwb", f"serial:{tmp_path / 'no-tag'}:115200", "--listen-s", "1.5", "--json"]
    code = main(["check", *words, *options])
    told = json.loads(capsys.readouterr().out)
    return code, {row["name"]: row for row in told["rows"]}


@pytest.mark.parametrize("firmware", ["4.6", "4.7"])
@pytest.mark.long
def test_the_recommended_wiring_is_refused_for_its_silent_tag_only(firmware, capsys, tmp_path):
    with sailing(boat("gate", firmware=firmware)) as url:
        code, rows = check(url, capsys, tmp_path)
    assert code == 1
    assert {row["area"] for row in rows.values() if row["level"] == "refuse"} == {"uwb", "estimator"}
    assert rows["firmware"]["found"] == f"{firmware}.0"
    assert rows["MAV_GCS_SYSID" if firmware == "4.7" else "SYSID_MYGCS"]["found"] == "1"
    assert rows["output 1-4"]["found"] == "1500 us" and rows["RC receiver"]["found"] == "none"
    assert "cannot open" in rows["tag"]["found"]


@pytest.mark.long
def test_a_tag_at_half_its_rate_is_seen_though_it_tells_ranges_and_position(capsys, tmp_path):
    shutil.copytree(EXAMPLES, tmp_path / "deploy")
    vessel = tmp_path / "deploy/boats/aritra.toml"
    text = vessel.read_text(encoding="utf-8")
    head, of_tag = text.split("[sensors.uwb]")
    vessel.write_text(f"{head}[sensors.uwb]{of_tag.replace('rate_Hz = 1.0', f'rate_Hz = {2 * TAG_HZ}', 1)}", "utf-8")
    tag = tmp_path / "tag"
    with sailing(boat("gate"), tag) as url:
        words = ["--config", str(tmp_path / "deploy/aritra.toml"), "--uwb", f"serial:{tag}:115200"]
        _, rows = check(url, capsys, tmp_path, *words)
    row = rows["cycles"]
    assert row["level"] == "warning" and float(row["found"].split()[0]) < 1.3 * TAG_HZ, row


def test_what_is_wrong_is_named_and_nothing_is_moved(capsys, tmp_path):
    rover = boat("unsafe_plain")
    rover.vehicle.parameters.set("SCHED_LOOP_RATE", 50)
    rover.vehicle.loop_rate_hz = 50.0
    rover.vehicle.modes.arm(force=True)
    before = rover.vehicle.parameters.saved()
    with sailing(rover) as url:
        code, rows = check(url, capsys, tmp_path)
    assert code == 1
    assert rows["SERVO1-4_FUNCTION"]["level"] == rows["armed"]["level"] == "refuse"
    assert "FOR EVER" in rows["SERVO1-4_FUNCTION"]["why"] and rows["SERVO1-4_FUNCTION"]["fix"]
    assert rows["SCHED_LOOP_RATE"]["level"] == "warning"
    assert rover.vehicle.parameters.saved() == before
    assert rover.vehicle.modes.armed and rover.vehicle.rc.last_input_ns is None, "it neither disarms nor overrides"


@pytest.mark.long
@pytest.mark.parametrize(("lost", "level"), [(1, "refuse"), (99, "warning")])
def test_a_lost_question_for_the_arming_checks_is_asked_again(lost, level, capsys, tmp_path, monkeypatch):
    """Of a link that loses frames: nobody had heard a complaint, and the row was in order."""
    ask, asked = MavlinkEncoder.command_long, []

    def lossy(self, command, *words):
        asked.append(command)
        return b"" if command == RUN_PREARM_CHECKS and asked.count(command) <= lost else ask(self, command, *words)

    monkeypatch.setattr(MavlinkEncoder, "command_long", lossy)
    rover = boat("gate")
    rover.vehicle.modes.safety_on = True
    with sailing(rover) as url:
        _, rows = check(url, capsys, tmp_path)
    assert rows["arming checks"]["level"] == level, rows["arming checks"]
    assert ("safety switch" in rows["arming checks"]["found"]) == (level == "refuse")


@pytest.mark.long
def test_nobody_there_is_a_refusal_with_what_to_do(capsys, tmp_path):
    code, rows = check("udpout:127.0.0.1:9", capsys, tmp_path)
    assert code == 1 and rows["heartbeat"]["level"] == "refuse" and "mavlink.url" in rows["heartbeat"]["fix"]
    assert not [row for row in rows.values() if row["area"] == "autopilot"], "nothing is said of what was not read"


@pytest.mark.long
def test_an_autopilot_that_is_not_ours_is_refused_by_its_system(capsys, tmp_path):
    text = (EXAMPLES / "aritra.toml").read_text(encoding="utf-8")
    text = re.sub(r'"(boats|sites|missions)/', rf'"{EXAMPLES}/\1/', text)
    config = tmp_path / "run.toml"
    config.write_text(text.replace("[mavlink]", "[mavlink]\nautopilot_system_id = 9"), encoding="utf-8")
    with sailing(boat("gate")) as url:
        code, rows = check(url, capsys, tmp_path, "--config", str(config))
    assert (
        code == 1 and rows["heartbeat"]["found"] == "only of systems 1" and "of system 9" in rows["heartbeat"]["needed"]
    )
    assert not [row for row in rows.values() if row["area"] == "autopilot"], "it is asked for nothing"


@pytest.mark.parametrize("command", [["check"], ["provision", "--wiring", "gate"], ["provision", "--logs", "x"]])
def test_bad_input_ends_with_2_and_names_the_place(command, tmp_path, capsys):
    assert exit_code(*command, "--config", tmp_path / "none.toml") == 2
    assert f"{tmp_path / 'none.toml'}: No such file" in capsys.readouterr().err
    assert main([*command, "--mavlink", "pigeon:roof"]) == 2
    assert "--mavlink: port 'pigeon:roof'" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words", [["provision"], ["provision", "--wiring", "unsafe_plain"], ["check", "--listen-s", "0"]]
)
def test_what_is_no_command_line_is_refused(words, capsys):
    with pytest.raises(SystemExit) as end:
        main(words)
    assert end.value.code == 2 and "usage: aritra" in capsys.readouterr().err


def provision(url, capsys, *options):
    code = main(["provision", "--mavlink", url, *options])
    told = capsys.readouterr()
    return code, told.out + told.err


@pytest.mark.long
def test_a_wiring_is_shown_asked_for_written_and_restarted(capsys, monkeypatch):
    rover = boat("unsafe_plain")
    rover.files = FtpFiles()
    before, wanted = rover.vehicle.parameters.saved(), load("gate")
    answers = iter(["", "n", "yes"])
    monkeypatch.setattr("rich.console.Console.input", lambda self, prompt: next(answers))
    with sailing(rover) as url:
        code, told = provision(url, capsys, "--wiring", "gate", "--dry-run")
        assert code == 0 and "SERVO4_FUNCTION" in told and "nothing was changed" in told
        for _ in range(2):
            code, told = provision(url, capsys, "--wiring", "gate")
            assert code == 1 and "nothing was changed" in told
        assert rover.vehicle.parameters.saved() == before and rover.files.stored == {}

        rover.vehicle.modes.arm(force=True)
        code, told = provision(url, capsys, "--wiring", "gate", "--yes")
        assert code == 1 and "armed: nothing was changed; disarm it first" in told
        assert rover.vehicle.parameters.saved() == before
        rover.vehicle.modes.disarm()

        code, told = provision(url, capsys, "--wiring", "gate")
        assert code == 0 and "REBOOT the autopilot now" in told and "SCR_ENABLE" in told
        stored = rover.vehicle.parameters
        assert {name: stored[name] for name in wanted} == wanted
        assert rover.files.stored == {f"{SCRIPTS}/gate.lua": SCRIPT.read_bytes()}
        code, told = provision(url, capsys, "--wiring", "gate", "--yes", "--reboot")
        assert code == 0 and f"all {len(wanted)} parameters are as gate.param has them" in told and "restarts" in told
        assert rover.outputs_us == (0,) * 16


class Mute(FtpFiles):
    """An autopilot that does not do file transfer."""

    def answers(self, payload, t_ns):
        return []


@pytest.mark.long
def test_without_file_transfer_nothing_restarts_and_the_hand_is_told_what_to_do(capsys):
    rover = boat("scaled")
    vehicle, rover.files = rover.vehicle, Mute()
    with sailing(rover) as url:
        code, told = provision(url, capsys, "--wiring", "gate", "--yes", "--reboot")
    assert code == 1 and rover.vehicle is vehicle, "after a failed step there is no reboot"
    assert "by hand: copy" in told and "gate.lua" in told and "REBOOT" in told
    assert rover.vehicle.parameters["SERVO1_FUNCTION"] == 94


@pytest.mark.long
def test_logs_are_fetched_once(tmp_path, capsys):
    rover = boat("gate")
    rover.logs = Logs([b"one" * 100, b"two" * 1000])
    with sailing(rover) as url:
        code, told = provision(url, capsys, "--logs", str(tmp_path / "logs"))
        assert code == 0 and "2 logs" in told
        files = sorted((tmp_path / "logs").iterdir())
        assert [f.read_bytes() for f in files] == rover.logs.stored
        stamps = [f.stat().st_mtime_ns for f in files]
        assert provision(url, capsys, "--logs", str(tmp_path / "logs"))[0] == 0
    assert [f.stat().st_mtime_ns for f in files] == stamps and len(list((tmp_path / "logs").iterdir())) == 2


def test_names_of_logs_sort_and_are_names_everywhere():
    name = file_name(StoredLog(7, "2026-01-01T00:06:00Z", 1))
    assert name == "log-0007-2026-01-01T000600Z.bin"
