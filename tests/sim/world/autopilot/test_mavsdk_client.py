"""MAVSDK's own client against the simulated autopilot: an implementation of MAVLink that is not ours."""

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

pytestmark = pytest.mark.alone


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


async def session(mavsdk, rover):
    """Everything a ground station does first; both sides are asked what happened."""
    system = await mavsdk.first_autopilot(8.0)
    assert system is not None
    assert await system.autopilot_type() == Autopilot.ARDUPILOT
    vehicle, modes = rover.vehicle, rover.vehicle.modes
    param, action, telemetry = ParamAsync(system), ActionAsync(system), TelemetryAsync(system)
    direct = MavlinkDirectAsync(system)

    everything = await param.get_all_params()
    got = {p.name: p.value for p in [*everything.int_params, *everything.float_params]}
    assert got == pytest.approx({row.name: vehicle.parameters[row.name] for row in TABLE})
    assert len(everything.float_params) == sum(row.kind is WireType.REAL32 for row in TABLE)
    await param.set_param_int("SERVO_RC_FS_MSK", 3840)
    assert vehicle.parameters["SERVO_RC_FS_MSK"] == 3840
    assert await param.get_param_int("SERVO_RC_FS_MSK") == 3840

    assert modes.mode is Mode.HOLD  # no RC input: it booted into HOLD
    assert await do_set_mode(direct, Mode.MANUAL) == 0
    assert modes.mode is Mode.MANUAL
    assert await told(telemetry.flight_mode, FlightMode.MANUAL) == FlightMode.MANUAL
    await action.arm()
    assert modes.armed
    assert await told(telemetry.armed, True)
    await action.hold()
    assert modes.mode is Mode.HOLD
    assert await told(telemetry.flight_mode, FlightMode.HOLD) == FlightMode.HOLD
    assert await do_set_mode(direct, Mode.GUIDED) == 4  # refused: armed and no position
    assert await do_set_mode(direct, 99) == 4
    await action.disarm()
    assert not modes.armed
    assert not await told(telemetry.armed, False)

    assert await do_set_mode(direct, Mode.GUIDED) == 0
    with pytest.raises(ActionError):
        await action.arm()
    assert not modes.armed
    version = await InfoAsync(system).get_version()
    assert (version.flight_sw_major, version.flight_sw_minor) == (4, 6)


@pytest.mark.parametrize("transport", ["tcp", pytest.param("udp", marks=pytest.mark.long)])
def test_mavsdk_connects_reads_parameters_arms_changes_mode_and_disarms(transport):
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
            await session(mavsdk, rover)
            assert all(link.bad_data == 0 for link in rover.links.values())
        assert await until(lambda: transport == "udp" or not rover.links)

    asyncio.run(asyncio.wait_for(scene(), 40.0))
