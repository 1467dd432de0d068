"""MAVSDK sets up the simulated autopilot: parameters, script by MAVFTP, logs. Both sides are asked what happened."""

import asyncio
import random
import time

import pytest
from pymavlink.dialects.v20 import ardupilotmega as wire

from companion.cli.boat.provisioning import SCRIPT, SCRIPTS
from companion.core.preflight.parameter_diff import changes
from drivers.mavlink.provision.provisioner import Provisioner, ProvisioningError
from drivers.mavlink.provision.relay import HOST, open_relay
from drivers.mavlink.signing import Signing, SigningKey
from drivers.ports.tcp import TcpClientPort
from drivers.ports.udp import UdpServerPort
from sim.world.autopilot.mavlink.files import FtpFiles
from sim.world.autopilot.mavlink.logs import Logs
from sim.world.autopilot.parameter_table import BOARD_PARAMETERS, TABLE
from tests.sim.world.autopilot.autopilot_process import booted_rover, served
from tests.sim.world.wirings.wiring_fixture import load


def scene(rover, work, seconds=40.0):
    """Run `work(autopilot)` against the served rover; what it returns."""

    async def play():
        async with served(rover) as (_, tcp), Provisioner.connect(TcpClientPort(*tcp)) as autopilot:
            return await work(autopilot)

    return asyncio.run(asyncio.wait_for(play(), seconds))


@pytest.mark.parametrize("firmware", ["4.6", "4.7"])
@pytest.mark.long
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


@pytest.mark.long
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
    rover.files = FtpFiles(before)
    scene(rover, lambda autopilot: autopilot.upload(SCRIPT, SCRIPTS))
    assert rover.files.stored == {f"{SCRIPTS}/gate.lua": SCRIPT.read_bytes()}


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


# --- a key -------------------------------------------------------------------------------------------

KEY, OTHER = bytes(range(1, 33)), bytes(range(2, 34))


def keyed(secret):
    return Signing(SigningKey(secret), time.time_ns, key_name="boat.key")


def signed_scene(rover, work, signing):
    """Over TCP that the autopilot takes for SERIAL1, where it wants signatures, with its key in it."""

    async def play():
        rover.key.set(KEY, 1)
        async with (
            served(rover) as (_, tcp),
            Provisioner.connect(TcpClientPort(*tcp), heard_s=3.0, signing=signing) as autopilot,
        ):
            return await work(autopilot)

    return asyncio.run(asyncio.wait_for(play(), 40.0))


async def written_and_sent(autopilot):
    told = await autopilot.parameters()
    now = await autopilot.write("FS_ACTION", 5.0)
    await autopilot.upload(SCRIPT, SCRIPTS)
    return told, now, await autopilot.armed()


def test_with_the_key_all_of_it_works_where_signatures_are_asked_for():
    rover = booted_rover(serial_of=lambda peer: 1)
    rover.files, signing = FtpFiles({}), keyed(KEY)
    told, now, armed = signed_scene(rover, written_and_sent, signing)
    assert len(told) == len(TABLE) and now == rover.vehicle.parameters["FS_ACTION"] == 5.0 and not armed
    assert rover.files.stored == {f"{SCRIPTS}/gate.lua": SCRIPT.read_bytes()}
    assert signing.counts["believed"] > len(TABLE)
    assert set(signing.counts) <= {"believed", "old"}, "old: before it had heard us, whose clock is right"


@pytest.mark.long
def test_with_another_key_nothing_is_done_there():
    rover = booted_rover(serial_of=lambda peer: 1)
    before = {row.name: rover.vehicle.parameters[row.name] for row in TABLE}
    with pytest.raises(ProvisioningError, match=r"no autopilot heard .* signed with another key than boat.key"):
        signed_scene(rover, lambda autopilot: autopilot.parameters(), keyed(OTHER))
    assert {name: rover.vehicle.parameters[name] for name in before} == before


@pytest.mark.long
def test_without_signatures_nothing_is_done_there_and_it_says_so_at_once():
    rover = booted_rover(serial_of=lambda peer: 1)
    begin_s = time.monotonic()
    with pytest.raises(ProvisioningError, match=r"signs what it sends .* we have no key.*mavlink\.signing_key.*USB"):
        signed_scene(rover, lambda autopilot: autopilot.parameters(), None)
    assert time.monotonic() - begin_s < 15.0, "at once: not after the minute that all parameters may take"


def test_on_usb_an_autopilot_that_signs_takes_what_is_not_signed():
    rover = booted_rover(serial_of=lambda peer: 0)
    rover.files = FtpFiles({})
    told, now, armed = signed_scene(rover, written_and_sent, None)
    assert len(told) == len(TABLE) and now == 5.0 and not armed


def test_an_autopilot_without_a_key_is_not_believed_where_we_have_one():
    rover = booted_rover()

    async def play():
        async with served(rover) as (_, tcp):
            await Provisioner.connect(TcpClientPort(*tcp), 2.0, keyed(KEY)).__aenter__()

    with pytest.raises(ProvisioningError, match=r"not signed, and mavlink\.signing_key asks for it"):
        asyncio.run(play())


def test_a_relay_answers_the_program_that_spoke_first_and_no_other():
    rover = booted_rover(serial_of=lambda peer: 1)

    async def work(local):
        loop, heard = asyncio.get_running_loop(), {}
        for name in ("first", "second"):
            heard[name] = await loop.create_datagram_endpoint(Ear, remote_addr=(HOST, local))
            mav = wire.MAVLink(None, 255, 190)
            question = wire.MAVLink_param_request_read_message(1, 1, b"FS_ACTION", -1)
            heard[name][0].sendto(b"no frame" + question.pack(mav))
            await asyncio.sleep(0.5)
        return {name: b"".join(ear.got) for name, (transport, ear) in heard.items() if transport.close() is None}

    async def play():
        rover.key.set(KEY, 1)
        async with served(rover) as (_, tcp), open_relay(TcpClientPort(*tcp), keyed(KEY)) as relay:
            return await work(relay.number)

    got = asyncio.run(play())
    answers = [m for m in wire.MAVLink(None).parse_buffer(got["first"]) if m.get_type() == "PARAM_VALUE"]
    assert [m.param_id for m in answers] == ["FS_ACTION"] and got["second"] == b""


class Ear(asyncio.DatagramProtocol):
    def __init__(self):
        self.got = []

    def datagram_received(self, data, addr):
        self.got.append(data)


def test_nobody_there_is_told():
    async def play():
        async with Provisioner.connect(UdpServerPort("127.0.0.1", 0), heard_s=0.3):
            pass

    with pytest.raises(ProvisioningError, match=r"udpin:127.0.0.1:0: (no autopilot heard|cannot be opened)"):
        asyncio.run(play())
