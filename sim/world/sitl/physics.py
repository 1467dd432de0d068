"""The boat afloat as a firmware's sensors would find it: clean values, for the firmware adds its own noise.

    position    R(rotation) [x y]             NED about the site's origin, which is the firmware's home
    velocity    R(rotation + psi) [u v]
    accel       specific force at the IMU's place: `sensors.specific_force`
    gyro        p = phi' - psi' sin theta, q = theta' cos phi + psi' cos theta sin phi,
                r = psi' cos theta cos phi - theta' sin phi               (Fossen 2021, eq. 2.39 inverted)

Roll and pitch are those of the waves, their rates differences over one frame. Errors of the sensors that the vessel
file knows of are in them, as in the loopback: the companion takes them out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from companion.core.geometry.frames import rotate, ssa
from companion.core.model.sensor_errors import apply_heading_errors, apply_imu_errors
from sim.world.environment import Moment
from sim.world.sensors import specific_force
from sim.world.sitl.protocol import PhysicsState, Vec3
from sim.world.world import STEP_NS, Afloat, WorldSetup


class SitlPhysics:
    """A world for a firmware. Its time runs in `advance` alone."""

    def __init__(self, setup: WorldSetup, seed: int):
        self._setup, self._seed = setup, seed
        self._rotation_rad = math.radians(setup.site.rotation_deg)
        self.world = Afloat(setup, seed)
        self._start_ns = self.world.t_ns
        self._tilt: tuple[float, float] | None = None

    def restart(self) -> None:
        """The same boat at its start, the timestamp at 0; the tag stays switched on, its time and the waves go on."""
        self._start_ns = self.world.t_ns
        self.world = Afloat(replace(self._setup, boot_ns=self._start_ns), self._seed, self.world.tag)
        self._tilt = None

    def advance(self, outputs_us: Sequence[int], frame_ns: int) -> tuple[PhysicsState, bytes]:
        """One frame on with these outputs, in steps of `STEP_NS` or less: the state then, and the tag's bytes."""
        steps = -(-frame_ns // STEP_NS)
        begin_ns, uwb = self.world.t_ns, b""
        for k in range(1, steps + 1):
            moment = self.world.advance(outputs_us, begin_ns + frame_ns * k // steps - self.world.t_ns)
            uwb += self.world.tag_bytes()
        return self._state(moment, frame_ns * 1e-9), uwb

    def _state(self, moment: Moment, frame_s: float) -> PhysicsState:
        world, motion = self.world, self.world.plant.motion
        x, y, psi, u, v, r = (float(value) for value in motion.x[:6])
        imu, yaw = world.vessel.sensors.imu, psi + self._rotation_rad
        north, east = rotate(self._rotation_rad, x, y)
        north_speed, east_speed = rotate(yaw, u, v)
        tilt = moment.phi_rad, moment.theta_rad
        p, q, r = _body_rates(self._tilt or tilt, tilt, r, frame_s)
        self._tilt = tilt
        force = specific_force(imu, motion, moment)
        a_x, a_y, r = apply_imu_errors(imu, force[0], force[1], r)
        return PhysicsState(
            timestamp_s=(world.t_ns - self._start_ns) * 1e-9,
            gyro_rad_s=(p, q, float(r)),
            accel_m_s2=(float(a_x), float(a_y), float(force[2])),
            position_m=(north, east, 0.0),
            velocity_m_s=(north_speed, east_speed, 0.0),
            attitude_rad=(*tilt, ssa(apply_heading_errors(imu, psi) + self._rotation_rad)),
            voltage_v=world.plant.voltage_v,
            current_a=world.plant.current_a,
        )


def _body_rates(before: tuple[float, float], tilt: tuple[float, float], psi_dot: float, dt_s: float) -> Vec3:
    """p, q, r [rad/s] of a hull that rolled and pitched from `before` to `tilt` in `dt_s` while it yaws."""
    phi, theta = tilt
    phi_dot, theta_dot = (phi - before[0]) / dt_s, (theta - before[1]) / dt_s
    return (
        phi_dot - psi_dot * math.sin(theta),
        theta_dot * math.cos(phi) + psi_dot * math.cos(theta) * math.sin(phi),
        psi_dot * math.cos(theta) * math.cos(phi) - theta_dot * math.sin(phi),
    )
