"""MAVSDK sets up the simulated autopilot: parameters, script by MAVFTP, logs. Both sides are asked what happened."""

import asyncio
import random

import pytest
from autopilot_process import booted_rover, served
from wiring_bench import load

from companion.core.parameter_diff import changes
from companion.provisioning import SCRIPT, SCRIPTS
from drivers.mavlink.provisioning import Provisioner, ProvisioningError
from sim.world.autopilot.files import Files
from sim.world.autopilot.logs import Logs
from sim.world.autopilot.parameter_table import BOARD_PARAMETERS, TABLE


def scene(rover, work, seconds=40.0):
    """Run `work(autopilot)` against the served rover; what it returns."""

    async def play():
        async with served(rover) as (_, tcp), Provisioner.connect(f"tcp:127.0.0.1:{tcp[1]}") as autopilot:
            return await work(autopilot)

    return asyncio.run(asyncio.wait_for(play(), seconds))


@pytest.mark.parametrize("firmware", ["4.6", "4.7"])
def test_the_difference_to_a_file_is_written_and_read_back(firmware):
    rover = booted_rover(parameters={**BOARD_PARAMETERS, **load("unsafe_plain"), "SYSID_MYGCS": 255}, firmware=firmware)
    stored, wanted = rover.vehicle.parameters, load("gate")

    async def work(autopilot):
        told = await autopilot.parameters()
        assert told == pytest.approx({stored.wire_name(i): stored[row.name] for i, row in enumerate(TABLE)})
        found = changes(told, wanted)
        written = [await autopilot.write(c.name, c.wanted) for c in found]
        assert written == pytest.approx([c.wanted for c in found])
        return found, changes(await autopilot.parameters(), wanted)

    found, left = scene(rover, work)
    assert left == []
    assert {name: stored[name] for name in wanted} == pytest.approx(wanted)
    assert ("MAV_GCS_SYSID" if firmware == "4.7" else "SYSID_MYGCS") in {c.name for c in found}
    assert {c.name for c in found if c.reboot} == {"SCR_ENABLE", *(f"SERVO{n}_FUNCTION" for n in range(1, 5))}


def test_armed_is_told_by_the_next_heartbeat_and_a_reboot_is_refused_then():
    rover = booted_rover()

    async def work(autopilot):
        before = await autopilot.armed()
        rover.vehicle.modes.arm(force=True)
        await asyncio.sleep(1.1)
        assert await autopilot.armed()
        with pytest.raises(ProvisioningError, match="does not reboot"):
            await autopilot.reboot()
        rover.vehicle.modes.disarm()
        await autopilot.reboot()
        return before

    assert scene(rover, work) is False
    assert rover.outputs_us == (0,) * 16, "it restarts"


@pytest.mark.parametrize("before", [{}, {f"{SCRIPTS}/gate.lua": b"-- an older and longer one\n" * 400}])
def test_the_script_arrives_whole(before):
    rover = booted_rover()
    rover.files = Files(before)
    scene(rover, lambda autopilot: autopilot.upload(SCRIPT, SCRIPTS))
    assert rover.files.stored == {f"{SCRIPTS}/gate.lua": SCRIPT.read_bytes()}


def test_a_firmware_without_file_transfer_is_told_as_such():
    with pytest.raises(ProvisioningError, match=r"/APM/scripts/gate.lua: unsupported"):
        scene(booted_rover(), lambda autopilot: autopilot.upload(SCRIPT, SCRIPTS))


def test_logs_come_whole_with_progress(tmp_path):
    dice = random.Random(11)
    contents = [dice.randbytes(n) for n in (90 * 30, 40_001, 1)]
    rover = booted_rover()
    rover.logs = Logs(contents)
    shares = []

    async def work(autopilot):
        logs = await autopilot.logs()
        for log in logs:
            await autopilot.download(log, tmp_path / str(log.number), shares.append)
        return logs

    logs = scene(rover, work, 60.0)
    assert [(log.number, log.size_bytes) for log in logs] == [(1, 2700), (2, 40_001), (3, 1)]
    assert [(tmp_path / str(n)).read_bytes() for n in (1, 2, 3)] == contents
    assert shares and all(0 <= share <= 1 for share in shares)


def test_without_logs_there_are_none():
    assert scene(booted_rover(), lambda autopilot: autopilot.logs()) == []


def test_nobody_there_is_told():
    async def play():
        async with Provisioner.connect("udpin:127.0.0.1:0", heard_s=0.3):
            pass

    with pytest.raises(ProvisioningError, match=r"udpin:127.0.0.1:0: (no autopilot heard|cannot be opened)"):
        asyncio.run(play())
