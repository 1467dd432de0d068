"""A firmware that can be driven: our simulated autopilot in the place of ArduPilot, on ArduPilot's JSON interface.

    python json_rover.py JSON_PORT TCP_PORT

sends servo packets to JSON_PORT in lockstep and in real time (`json_firmware`) and serves MAVLink on TCP_PORT, with
the parameters of `deploy/ardupilot/gate.param`. It adds noise to what it is told, as the real one does. Seed 4.
"""

from __future__ import annotations

import asyncio
import sys
import time

import numpy as np

from companion.boat.load_run import EXAMPLES
from companion.core.preflight.parameter_file import parse_parameters
from sim.world.autopilot import Rover, SensorFrame
from sim.world.autopilot.parameter_table import BOARD_PARAMETERS
from sim.world.mavlink_server import MavlinkServer
from tests.sim.world.sitl.json_firmware import Firmware


def sensed(state, rng):
    """What the autopilot makes of a state."""
    phi, theta, psi = state["attitude"]
    accel = np.array(state["accel_body"]) + rng.normal(0, 0.02, 3)
    p, q, r = np.array(state["gyro"]) + rng.normal(0, 0.002, 3)
    return SensorFrame(
        accel_m_s2=tuple(map(float, accel)),
        gyro_rad_s=(float(p), float(q), float(r)),
        phi_rad=phi,
        theta_rad=theta,
        psi_rad=psi,
        p_rad_s=float(p),
        q_rad_s=float(q),
        r_rad_s=float(r),
        voltage_v=state["voltage"],
        current_a=state["current"],
    )


async def main(json_port, tcp_port):
    gate = parse_parameters((EXAMPLES / "ardupilot" / "gate.param").read_text(), name="gate.param")
    rover, rng = Rover(0, {**BOARD_PARAMETERS, **gate}), np.random.default_rng(4)
    firmware = Firmware(json_port, rate_hz=200.0)
    server = MavlinkServer(rover, lambda: round(firmware.seen.clock_s * 1e9))
    await server.open_tcp(("127.0.0.1", tcp_port))
    lag_s = time.monotonic()
    while True:
        state = firmware.exchange(rover.outputs_us)
        server.send(rover.step(round(firmware.seen.clock_s * 1e9), sensed(state, rng)))
        lag_s = max(lag_s, time.monotonic() - firmware.seen.clock_s - 0.2)  # lost time is not made up
        await asyncio.sleep(max(0.0, firmware.seen.clock_s + lag_s - time.monotonic()))


if __name__ == "__main__":
    asyncio.run(main(int(sys.argv[1]), int(sys.argv[2])))
