"""The stepped world with faults at its thrusters, sensors and wires; the boat's own code is not touched.

Thrusters are spoilt at the pulses that reach them, sensors at their readings, anchors at the ranges, wires at the
bytes. What a fault draws at random comes from the world's seed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from companion.core.model.thrusters import force_from_pwm, pwm_from_force
from sim.world.environment import Moment
from sim.world.plant import Motion
from sim.world.sensors import ImuReading
from sim.world.world import STEP_NS, Outgoing, World, WorldSetup
from tests.fault_lab.fault import Fault
from tests.fault_lab.faulty_ranges import FaultyRanges

NEUTRAL_US = 1500
PUSH_ARM_M, PUSH_RAMP_S = 0.3, 1.0
"""How far from the origin it is pushed, at most, and how soon; assumed."""


Spoil = Callable[[Fault, ImuReading, ImuReading, float, np.random.Generator], dict]
"""(fault, reading, reading when the fault began, seconds since then, dice) -> fields of the reading that it changes."""


def _heading(turn_deg: Callable[[Fault, float, np.random.Generator], float]) -> Spoil:
    return lambda f, now, held, s, dice: {"psi_rad": now.psi_rad + math.radians(turn_deg(f, s, dice))}


def _gyro(rate: Callable[[Fault, tuple, np.random.Generator], tuple]) -> Spoil:
    return lambda f, now, held, s, dice: {"gyro_rad_s": rate(f, now.gyro_rad_s, dice)}


def _accel(force: Callable[[Fault, tuple, np.random.Generator], tuple]) -> Spoil:
    return lambda f, now, held, s, dice: {"accel_m_s2": force(f, now.accel_m_s2, dice)}


def _held(*fields: str) -> Spoil:
    return lambda f, now, held, s, dice: {field: getattr(held, field) for field in fields}


def _noisy(f: Fault, values: tuple, dice: np.random.Generator) -> tuple:
    return tuple(np.add(values, dice.normal(0, f.size, 3)).tolist())


SPOIL: dict[tuple[str, str], Spoil] = {
    ("heading", "offset"): _heading(lambda f, s, dice: f.size),
    ("heading", "drift"): _heading(lambda f, s, dice: f.size * s),
    ("heading", "noise"): _heading(lambda f, s, dice: float(dice.normal(0, f.size))),
    ("heading", "frozen"): _held("psi_rad"),
    ("gyro", "stuck"): _held("gyro_rad_s"),
    ("gyro", "flipped"): _gyro(lambda f, w, dice: (w[0], w[1], -w[2])),
    ("gyro", "bias"): _gyro(lambda f, w, dice: (w[0], w[1], w[2] + f.size)),
    ("gyro", "scale"): _gyro(lambda f, w, dice: (w[0], w[1], w[2] * f.size)),
    ("gyro", "noise"): _gyro(_noisy),
    ("accel", "bias"): _accel(lambda f, a, dice: (a[0] + f.size, a[1] - f.size / 2, a[2])),
    ("accel", "noise"): _accel(_noisy),
    ("accel", "stuck"): _held("accel_m_s2"),
    ("accel", "flipped"): _accel(lambda f, a, dice: (-a[0], -a[1], a[2])),
    ("accel", "swapped"): _accel(lambda f, a, dice: (a[1], a[0], a[2])),
    ("accel", "saturated"): _accel(lambda f, a, dice: (*np.clip(a[:2], -f.size, f.size).tolist(), a[2])),
    ("imu", "stuck"): _held("accel_m_s2", "gyro_rad_s"),
}


class FaultyImu:
    """The autopilot's inertial sensors and heading, spoilt."""

    def __init__(self, imu, faults: Sequence[Fault], rng: np.random.Generator):
        self._imu, self._faults, self._rng = imu, faults, rng
        self._held: dict[str, ImuReading] = {}

    def measure(self, motion, moment, period_ns=None) -> ImuReading:
        """One sample."""
        reading, t_s = self._imu.measure(motion, moment, period_ns), motion.t_ns * 1e-9
        for fault in self._faults:
            if fault.acts(t_s):
                held, spoil = self._held.setdefault(str(fault), reading), SPOIL[fault.target, fault.kind]
                reading = replace(reading, **spoil(fault, reading, held, t_s - fault.from_s, self._rng))
        return reading


class FaultyWorld(World):
    """One boat in its basin with faults."""

    def __init__(self, setup: WorldSetup, seed: int, faults: Sequence[Fault]):
        super().__init__(setup, seed)
        self.faults = tuple(faults)
        rng = np.random.default_rng([seed, 4711])
        self.imu = FaultyImu(self.imu, self._of("heading", "gyro", "accel", "imu"), rng)
        self.uwb_sensor = FaultyRanges(self.uwb_sensor, setup.site.anchors, self._of("uwb", "anchor"), rng)
        self._rng, self._late = rng, list[tuple[int, tuple]]()
        if pushes := self._of("boat"):
            dice = np.random.default_rng([seed, 4711])  # of its own: what other faults draw does not change
            self.plant.step = self._pushed(self.plant.step, pushes, dice)

    def _of(self, *targets: str) -> list[Fault]:
        return [f for f in self.faults if f.target in targets]

    def advance(
        self,
        outputs_us: Sequence[int],
        step_ns: int = STEP_NS,
        changes: Iterable[tuple[int, Sequence[int]]] = (),
    ) -> Moment:
        """One step on; thruster faults change the pulses that reach the thrusters."""
        (_, pulses_us), *more = ((t_ns, self._arriving(t_ns, us)) for t_ns, us in ((self.t_ns, outputs_us), *changes))
        for fault in self._of("battery"):
            if fault.acts(self.t_ns * 1e-9):
                self.plant.voltage_v = fault.size
        return super().advance(pulses_us, step_ns, more)

    def _arriving(self, t_ns: int, outputs_us: Sequence[int]) -> list[int]:
        """What of these outputs reaches the thrusters from `t_ns` on."""
        pulses = [p or NEUTRAL_US for p in outputs_us[: len(self.vessel.thrusters)]]
        for fault in self._of("thruster", "thrusters"):
            if fault.acts(t_ns * 1e-9):
                self._spoil(pulses, fault)
        return [round(p) for p in pulses]

    def _pushed(
        self, step: Callable[..., Motion], pushes: Sequence[Fault], dice: np.random.Generator
    ) -> Callable[..., Motion]:
        """The plant's step while something pushes the boat, in one direction of the basin, beside its origin."""
        towards_rad, arm_m = dice.uniform(-math.pi, math.pi), dice.uniform(-PUSH_ARM_M, PUSH_ARM_M)

        def pushed(moment: Moment, step_ns: int | None = None) -> Motion:
            t_s, psi = self.t_ns * 1e-9, self.plant.motion.x[2]
            force_n = sum(f.size * min(1.0, (t_s - f.from_s) / PUSH_RAMP_S) for f in pushes if f.acts(t_s))
            X, Y = force_n * math.cos(towards_rad - psi), force_n * math.sin(towards_rad - psi)
            return step(replace(moment, wave_n=moment.wave_n + np.array([X, Y, force_n * arm_m])), step_ns)

        return pushed

    def _spoil(self, pulses: list, fault: Fault) -> None:
        which = range(len(pulses)) if fault.target == "thrusters" else [fault.number - 1]
        if fault.kind == "swapped":
            i, j = which[0], (round(fault.size) - 1) % len(pulses)
            pulses[i], pulses[j] = pulses[j], pulses[i]
            return
        for i in which:
            if fault.kind == "dead":
                pulses[i] = NEUTRAL_US
            elif fault.kind == "stuck":
                pulses[i] = fault.size
            else:
                share = -1.0 if fault.kind == "reversed" else fault.size
                thruster = self.vessel.thrusters[i]
                fmap, volts = self.vessel.force_maps[thruster.force_map], self.plant.voltage_v
                force = share * force_from_pwm(thruster, fmap, pulses[i], volts)
                pulses[i] = pwm_from_force(thruster, fmap, force, volts)

    def step(self) -> Outgoing:
        """One step on; wire faults change the bytes that the autopilot's link brings."""
        outgoing, t_s = super().step(), self.t_ns * 1e-9
        frames = outgoing.mavlink
        for fault in self._of("wire"):
            if not fault.acts(t_s):
                continue
            if fault.kind == "silent":
                frames = []
            elif fault.kind == "lost":
                frames = [f for f in frames if self._rng.uniform() > fault.size]
            else:
                self._late += [(self.t_ns + round(fault.size * 1e9), frame) for frame in frames]
                frames = []
        frames = [frame for due_ns, frame in self._late if due_ns <= self.t_ns] + frames
        self._late = [(due_ns, frame) for due_ns, frame in self._late if due_ns > self.t_ns]
        return replace(outgoing, mavlink=frames)
