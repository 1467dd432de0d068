"""MAVSDK's own client, an implementation of MAVLink that is not ours: one session with the simulated autopilot and with
a real firmware, the same answers from both."""

import asyncio
import json
import socket

import pytest
from mavsdk.asyncio import Autopilot, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync, ActionError
from mavsdk.asyncio.plugins.info import InfoAsync
from mavsdk.asyncio.plugins.mavlink_direct import MavlinkDirectAsync, MavlinkMessage
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.asyncio.plugins.telemetry import FlightMode, TelemetryAsync

from sim.world.autopilot.modes import Mode
from sim.world.autopilot.parameter_table import TABLE, WireType
from tests.sim.world.autopilot.autopilot_process import booted_rover, served, until
from tests.support.autopilots.client_autopilots import autopilot
from tests.support.autopilots.firmware_rig import binaries

pytestmark = pytest.mark.real_time

FIRMWARES = [
    pytest.param(path, id=path.parent.name, marks=[pytest.mark.firmware, pytest.mark.long]) for path in binaries()
]
ANSWERS = {
    "autopilot": Autopilot.ARDUPILOT,
    "parameter set and read": 3840,
    "MANUAL": 0,
    "MANUAL told": FlightMode.MANUAL,
    "armed told": True,
    "HOLD told": FlightMode.HOLD,
    "GUIDED while armed": 4,
    "mode 99": 4,
    "RTL while armed": 4,
    "disarmed told": False,
    "GUIDED": 0,
    "arming in GUIDED": "refused",
    "HOLD": 0,
    "arming again": "done",
    "version": 4,
}


def free_udp_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


async def told(read, wanted, seconds=4.0):
    """Poll the client until it says `wanted`: it learns of it with the next heartbeat."""
    end = asyncio.get_running_loop().time() + seconds
    while (value := await read()) != wanted and asyncio.get_running_loop().time() < end:
        await asyncio.sleep(0.05)
    return value


async def do_set_mode(direct, custom_mode):
    fields = {"target_system": 1, "target_component": 1, "command": 176, "param1": 1, "param2": custom_mode}
    message = MavlinkMessage(
        message_name="COMMAND_LONG", system_id=255, component_id=190,
        target_system_id=1, target_component_id=1, fields_json=json.dumps(fields),
    )  # fmt: skip
    return json.loads((await direct.send_command(message)).fields_json)["result"]


async def arm(action):
    try:
        await action.arm()
    except ActionError:
        return "refused"
    return "done"


async def session(system):
    """Everything a ground station does first: question -> answer."""
    param, action, telemetry = ParamAsync(system), ActionAsync(system), TelemetryAsync(system)
    direct = MavlinkDirectAsync(system)
    got = {"autopilot": await system.autopilot_type()}
    await param.set_param_int("SERVO_RC_FS_MSK", 3840)
    got["parameter set and read"] = await param.get_param_int("SERVO_RC_FS_MSK")
    got["MANUAL"] = await do_set_mode(direct, Mode.MANUAL)
    got["MANUAL told"] = await told(telemetry.flight_mode, FlightMode.MANUAL)
    await action.arm()
    got["armed told"] = await told(telemetry.armed, True)
    await action.hold()
    got["HOLD told"] = await told(telemetry.flight_mode, FlightMode.HOLD)
    got["GUIDED while armed"] = await do_set_mode(direct, Mode.GUIDED)
    got["mode 99"] = await do_set_mode(direct, 99)
    got["RTL while armed"] = await do_set_mode(direct, Mode.RTL)
    await action.disarm()
    got["disarmed told"] = await told(telemetry.armed, False)
    got["GUIDED"] = await do_set_mode(direct, Mode.GUIDED)
    got["arming in GUIDED"] = await arm(action)
    got["HOLD"] = await do_set_mode(direct, Mode.HOLD)
    got["arming again"] = await arm(action)
    await action.disarm()
    got["version"] = (await InfoAsync(system).get_version()).flight_sw_major
    return got


async def parameters(system):
    """All parameters by name, and how many are real numbers."""
    everything = await ParamAsync(system).get_all_params()
    return {p.name: p.value for p in [*everything.int_params, *everything.float_params]}, len(everything.float_params)


@pytest.mark.parametrize("binary", [pytest.param(None, id="simulated"), *FIRMWARES])
def test_mavsdk_arms_changes_mode_and_disarms(binary, tmp_path):
    async def scene():
        async with (
            autopilot(binary, tmp_path) as (host, port),
            Mavsdk(Configuration.create_manual(255, 190, True)) as mavsdk,
        ):
            await mavsdk.add_any_connection(f"tcpout://{host}:{port}")
            system = await mavsdk.first_autopilot(20.0)
            assert system is not None
            assert await session(system) == ANSWERS

    asyncio.run(asyncio.wait_for(scene(), 200.0))


@pytest.mark.parametrize("transport", ["tcp", pytest.param("udp", marks=pytest.mark.long)])
def test_mavsdk_reads_all_parameters_of_the_simulated_autopilot(transport):
    port = free_udp_port()

    async def scene():
        rover = booted_rover()
        target = ("127.0.0.1", port) if transport == "udp" else None
        async with (
            served(rover, udp_target=target) as (_, tcp),
            Mavsdk(Configuration.create_manual(255, 190, True)) as mavsdk,
        ):
            where = f"udpin://127.0.0.1:{port}" if transport == "udp" else f"tcpout://127.0.0.1:{tcp[1]}"
            await mavsdk.add_any_connection(where)
            system = await mavsdk.first_autopilot(8.0)
            got, floats = await parameters(system)
            assert got == pytest.approx({row.name: rover.vehicle.parameters[row.name] for row in TABLE})
            assert floats == sum(row.kind is WireType.REAL32 for row in TABLE)
            assert all(link.bad_data == 0 for link in rover.links.values())
        assert await until(lambda: transport == "udp" or not rover.links)

    asyncio.run(asyncio.wait_for(scene(), 40.0))
