"""The boat afloat as a firmware's sensors find it.

    position    R(rotation) [x y]             NED about the site's origin, which is the firmware's home
    velocity    R(rotation + psi) [u v]
    accel, gyro `sensors.ImuSensor`: with the noise, the biases and the errors of the vessel file, as in the loopback

Roll and pitch are those of the waves. Of the heading's errors the scale and the like are the vessel file's; its noise
and wander are the firmware's own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from companion.core.geometry.frames import rotate, ssa
from companion.core.model.sensor_errors import apply_heading_errors
from sim.world.environment import Moment
from sim.world.sitl.protocol import PhysicsState
from sim.world.world import STEP_NS, Afloat, WorldSetup


class SitlPhysics:
    """A world for a firmware. Its time runs in `advance` alone."""

    def __init__(self, setup: WorldSetup, seed: int):
        self._setup, self._seed = setup, seed
        self._rotation_rad = math.radians(setup.site.rotation_deg)
        self.world = Afloat(setup, seed)
        self._start_ns = self.world.t_ns

    def restart(self) -> None:
        """The same boat at its start, the timestamp at 0; the tag stays switched on, its time and the waves go on."""
        self._start_ns = self.world.t_ns
        later = replace(self._setup, boot_ns=self._start_ns)
        self.world = Afloat(later, self._seed, self.world.tag, self.world.zero_ns)

    def advance(self, outputs_us: Sequence[int], frame_ns: int) -> tuple[PhysicsState, bytes]:
        """One frame on with these outputs, in steps of `STEP_NS` or less: the state then, and the tag's bytes."""
        steps = -(-frame_ns // STEP_NS)
        begin_ns, uwb = self.world.t_ns, b""
        for k in range(1, steps + 1):
            moment = self.world.advance(outputs_us, begin_ns + frame_ns * k // steps - self.world.t_ns)
            uwb += self.world.tag_bytes()
        return self._state(moment, frame_ns), uwb

    def _state(self, moment: Moment, frame_ns: int) -> PhysicsState:
        world, motion = self.world, self.world.plant.motion
        x, y, psi, u, v, _ = (float(value) for value in motion.x[:6])
        imu, yaw = world.vessel.sensors.imu, psi + self._rotation_rad
        north, east = rotate(self._rotation_rad, x, y)
        north_speed, east_speed = rotate(yaw, u, v)
        reading = world.imu.measure(motion, moment, frame_ns)
        return PhysicsState(
            timestamp_s=(world.t_ns - self._start_ns) * 1e-9,
            gyro_rad_s=reading.gyro_rad_s,
            accel_m_s2=reading.accel_m_s2,
            position_m=(north, east, 0.0),
            velocity_m_s=(north_speed, east_speed, 0.0),
            attitude_rad=(moment.phi_rad, moment.theta_rad, ssa(apply_heading_errors(imu, psi) + self._rotation_rad)),
            voltage_v=world.plant.voltage_v,
            current_a=world.plant.current_a,
        )
