"""The simulated world: hull, weather, sensors, autopilot and UWB tag, advanced in steps of 10 ms.

    step() -> Outgoing          one step on; the bytes that are due on the wires
    mavlink(data, peer)         bytes from a MAVLink peer; what is answered at once
    uwb(data)                   bytes from the companion to the tag; what is answered at once

`tamper`, by key of a sensor: what a fault makes of its messages, None: nothing arrives.

`Afloat` is the world without an autopilot, for a firmware that is not ours (`sim.world.sitl`).

It has no clock: real time (`loopback`) and stepped tests call the same `step`. The same setup, seed and
incoming bytes give the same outgoing bytes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from companion.core.configuration.site_file import Site
from companion.core.configuration.vessel_file import VesselFile
from companion.core.constants import NEUTRAL_US
from companion.core.messages import GroundTruth, Measured
from companion.core.messages.sensors import GnssFix
from companion.core.model.sensor_errors import apply_heading_errors
from companion.core.sensors.table import sensors_of
from drivers.devices import DEVICES
from sim.world.ahrs import Ahrs
from sim.world.autopilot import SensorFrame
from sim.world.autopilot.parameter_table import BOAT_PARAMETERS
from sim.world.autopilot.rover import Rover
from sim.world.channel_sensor import ChannelSensor
from sim.world.environment import Environment, Moment, Weather, with_terms_of
from sim.world.plant import Plant, perturbed
from sim.world.sensors import ImuSensor, UwbFaults, UwbSensor
from sim.world.sitl.board import VOLTAGE_V, HeadingGains, SitlBoard
from sim.world.uwb_tag import UwbTag

STEP_NS = 10_000_000


@dataclass(frozen=True)
class WorldSetup:
    """What world to make. `mismatch`: how far plant parameters lie off the vessel file (share, uniform).

    Of the autopilot: `parameters`, `firmware` ("4.6", "4.7"), `receiver_us` (pulse widths of an RC receiver, empty
    without one), `serial` (the autopilot's port that the MAVLink peers are on; 0 is USB, which signing trusts), `board`
    (heading, gyros and battery as ArduPilot's simulator has them; None: as the vessel file says).
    """

    vessel: VesselFile
    site: Site
    start: tuple[float, float, float] = (6.0, 6.0, 0.0)
    weather: Weather = field(default_factory=Weather)
    mismatch: float = 0.0
    faults: UwbFaults = field(default_factory=UwbFaults)
    voltage_v: float = 15.6
    drift_ppm: float = 20.0
    parameters: Mapping[str, float] = field(default_factory=lambda: BOAT_PARAMETERS)
    firmware: str = "4.6"
    receiver_us: tuple[int, ...] = ()
    serial: int = 0
    boot_ns: int = 0
    board: HeadingGains | None = None


@dataclass(frozen=True)
class Outgoing:
    """Bytes that leave the simulated devices in one step. `devices`: of other sensors with a wire, by their keys."""

    mavlink: list[tuple[Hashable, bytes]]
    uwb: bytes
    devices: Mapping[str, bytes] = field(default_factory=dict)


class Afloat:
    """One simulated boat in its basin, without an autopilot. `tag`: one that is switched on already.

    `zero_ns`: instant from which current and waves count their time; None: the boat's start.
    """

    def __init__(self, setup: WorldSetup, seed: int, tag: UwbTag | None = None, zero_ns: int | None = None):
        draws = _draws(seed)
        self.zero_ns = setup.boot_ns if zero_ns is None else zero_ns
        vessel = perturbed(setup.vessel, draws["vessel"], setup.mismatch) if setup.mismatch else setup.vessel
        self.t_ns = setup.boot_ns
        self.vessel = vessel
        x0 = np.array([*setup.start, 0.0, 0.0, 0.0])
        self.plant = Plant(vessel, x0, step_ns=STEP_NS, voltage_v=setup.voltage_v, t_ns=setup.boot_ns)
        self._environment = Environment(with_terms_of(setup.weather, setup.vessel), draws["weather"])
        self.imu = ImuSensor(vessel.sensors.imu, draws["imu"])
        self.uwb_sensor, self.tag = None, tag
        if uwb := vessel.sensors.uwb:
            self.uwb_sensor = UwbSensor(uwb, setup.site.anchors, setup.faults, draws["uwb"])
            places = {a.id: (a.east_m, a.north_m, -a.down_m) for a in setup.site.anchors}
            self.tag = tag or UwbTag(uwb.wire_format, anchors=places, rate_hz=uwb.rate_Hz)
        self.tamper: dict[str, Callable[[Any], Measured | None]] = {}
        chosen = [sensor for sensor in sensors_of(vessel.sensors, setup.site) if sensor.channels]
        rngs = draws["more"].spawn(len(chosen))
        self.channel_sensors = [ChannelSensor(*each, setup.boot_ns) for each in zip(chosen, rngs, strict=True)]
        self._uwb_due_ns = setup.boot_ns
        self.in_flight: list[tuple[int, bytes]] = []
        self.silent_uwb = False

    def advance(
        self,
        outputs_us: Sequence[int],
        step_ns: int = STEP_NS,
        changes: Iterable[tuple[int, Sequence[int]]] = (),
    ) -> Moment:
        """One step on with these outputs of the autopilot; what the environment was.

        Outputs 1..n go to thrusters and servos in the order of `vessel.controls`; 0 is no pulse. `changes`: others that
        take their place on the way, when [ns] and what.
        """
        for t_ns, all_us in ((self.t_ns, outputs_us), *changes):
            pulses = all_us[: len(self.vessel.controls)]
            self.plant.command(t_ns, tuple(float(p) if p else float(NEUTRAL_US) for p in pulses))
        moment = self._environment.step((self.t_ns - self.zero_ns) * 1e-9, step_ns * 1e-9)
        self.plant.step(moment, step_ns)
        self.t_ns += step_ns
        return moment

    def tag_bytes(self) -> bytes:
        """Measure when due; hand out what has been under way for the tag's latency; nothing without a tag."""
        if self.tag is None or self.uwb_sensor is None:
            return b""
        if self.t_ns >= self._uwb_due_ns:
            self._uwb_due_ns += round(1e9 / self.tag.rate_hz)
            ranges = self.uwb_sensor.measure(self.plant.motion)
            if not self.silent_uwb:
                data = self.tag.cycle(ranges, self.uwb_sensor.fix(ranges), self.t_ns)
                self.in_flight.append((self.uwb_sensor.arrival_ns(self.t_ns), data))
        due = b"".join(data for ready_ns, data in self.in_flight if ready_ns <= self.t_ns)
        self.in_flight = [(ready_ns, data) for ready_ns, data in self.in_flight if ready_ns > self.t_ns]
        return due

    def sensed(self, moment: Moment) -> list[tuple[str, Measured]]:
        """Messages of the other sensors that arrive now, with the sensors' keys."""
        arrived = [
            (each.sensor.key, m)
            for each in self.channel_sensors
            for m in each.step(self.plant.motion, moment, self.t_ns)
        ]
        sent = [(key, self.tamper[key](m) if key in self.tamper else m) for key, m in arrived]
        return [(key, m) for key, m in sent if m is not None]

    def uwb(self, data: bytes) -> bytes:
        """Bytes from the companion to the UWB tag now; its answer."""
        return self.tag.receive(data, self.t_ns) if self.tag else b""

    def truth(self) -> GroundTruth:
        """What really is."""
        x = [float(value) for value in self.plant.motion.x]
        return GroundTruth(
            t_ns=self.t_ns,
            north_m=x[0],
            east_m=x[1],
            psi_rad=x[2],
            u_m_s=x[3],
            v_m_s=x[4],
            r_rad_s=x[5],
            f_n=tuple(x[6:]),
        )


class World(Afloat):
    """A boat with its autopilot. `receiver_us` may be set: the pilot moves the sticks, the receiver dies."""

    def __init__(self, setup: WorldSetup, seed: int):
        super().__init__(setup, seed)
        wired = _wired(self.vessel, setup.parameters)
        channels, serial = _channels(self.vessel), setup.serial
        self.rover = Rover(setup.boot_ns, wired, setup.drift_ppm, channels, setup.firmware, lambda peer: serial)
        self.receiver_us = setup.receiver_us
        self._ahrs = Ahrs(STEP_NS * 1e-9)
        self._board = SitlBoard(setup.board, setup.site, STEP_NS * 1e-9) if setup.board else None
        self._fix: GnssFix | None = None
        self._rotation_rad = math.radians(setup.site.rotation_deg)  # an autopilot's heading is from true north

    def step(self) -> Outgoing:
        """Advance the world by `STEP_NS`."""
        moment = self.advance(self.rover.outputs_us, changes=self.rover.outputs_before(self.t_ns + STEP_NS))
        devices: dict[str, bytes] = {}
        for key, m in self.sensed(moment):
            if isinstance(m, GnssFix):  # its receiver is the autopilot's
                self._fix = m
            elif encode := DEVICES[key].encode:
                devices[key] = devices.get(key, b"") + encode(m)
        frame = self._sense(moment)
        return Outgoing(self.rover.step(self.t_ns, frame), self.tag_bytes(), devices)

    def add_peer(self, peer: Hashable) -> None:
        """A MAVLink peer is there: what the autopilot streams goes to it from now on."""
        self.rover.add_link(peer)

    def mavlink(self, data: bytes, peer: Hashable) -> bytes:
        """Bytes from a MAVLink peer now; the autopilot's answer."""
        return self.rover.receive(data, peer, self.t_ns)

    def _sense(self, moment: Moment) -> SensorFrame:
        """The sensors' next sample, as the autopilot holds it."""
        motion = self.plant.motion
        reading = self.imu.measure(motion, moment, STEP_NS)
        if self._board:
            compass_rad = apply_heading_errors(self.vessel.sensors.imu, float(motion.x[2]))
            phi, theta = self._ahrs.tilt_rad or (moment.phi_rad, moment.theta_rad)
            tilt_error = phi - moment.phi_rad, theta - moment.theta_rad
            reading = self._board.sense(reading, compass_rad, math.hypot(*motion.x[3:5]), tilt_error)
        p, q, r = reading.gyro_rad_s
        raw = SensorFrame(
            accel_m_s2=reading.accel_m_s2, gyro_rad_s=reading.gyro_rad_s, phi_rad=reading.phi_rad,
            theta_rad=reading.theta_rad, psi_rad=reading.psi_rad + self._rotation_rad, p_rad_s=p, q_rad_s=q, r_rad_s=r,
            voltage_v=VOLTAGE_V if self._board else self.plant.voltage_v, current_a=self.plant.current_a,
            receiver_us=self.receiver_us, gnss=self._fix,
        )  # fmt: skip
        parameters = self.rover.vehicle.parameters
        return self._ahrs.advance(raw, parameters["INS_GYRO_FILTER"], parameters["INS_ACCEL_FILTER"])


def _draws(seed: int) -> dict[str, np.random.Generator]:
    """A generator for each source of chance, from the seed alone."""
    made = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(5))
    return dict(zip(("vessel", "weather", "imu", "uwb", "more"), made, strict=True))


def _channels(vessel: VesselFile) -> tuple[int, ...]:
    return tuple(control.channel for control in vessel.controls)


def _wired(vessel: VesselFile, parameters: Mapping[str, float]) -> dict[str, float]:
    """Parameters with outputs 1..n given to the Lua gate's Script1..n, one a thruster or servo, and GNSS or none."""
    wired = {**{f"SERVO{n}_FUNCTION": 93.0 + n for n in range(1, len(vessel.controls) + 1)}, **parameters}
    return {**wired, "GPS1_TYPE": 1.0} if vessel.sensors.gnss else wired
