"""One log's worth of sailing: pilot, thrusters, hull and surroundings in a loop at 120 Hz; what sensors will need."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin
from typing import Protocol

import numpy as np

from tests.hidden.plant.hull import HullMotion
from tests.hidden.plant.six_dof import PLANE, SixDof
from tests.hidden.plant.surroundings import Surroundings, tilt
from tests.hidden.plant.thrusters import Propulsion
from tests.hidden.plant.world import STEP_S, STEPS_HZ, World

PILOT_STEPS = STEPS_HZ // 10
BATTERY_STEPS = STEPS_HZ // 2


class Pilot(Protocol):
    """Asked ten times a second; None keeps the last command."""

    def pwm(self, t: float, s: tuple) -> list[float] | None:
        """Pulse widths [us]."""


@dataclass
class Track:
    """What happened. Rows at IMU instants: `imu_step`, `state` (n, 6), `rate` (n, 6), `tilt` (n, 2)."""

    t0: float
    steps: int
    pwm: list[tuple[int, list[float]]]
    battery: list[tuple[int, float]]
    imu_step: np.ndarray
    state: np.ndarray
    rate: np.ndarray
    tilt: np.ndarray
    fix_step: np.ndarray
    fix_state: np.ndarray


def sail(world: World, pilot: Pilot, seconds: float, t0: float, start: tuple, rngs: list[np.random.Generator]) -> Track:
    """Sail for `seconds` from state `start`; `rngs`: one for the thrusters, one for the surroundings."""
    steps = round(seconds * STEPS_HZ)
    propulsion, hull = Propulsion(world, rngs[0]), SixDof(world) if world.afloat else HullMotion(world)
    around = Surroundings(world, steps, t0, rngs[1])
    imu_every, fix_every = STEPS_HZ // round(world.sense.imu_hz), STEPS_HZ // round(world.sense.uwb_hz)
    s = hull.begin(tuple(float(x) for x in start))
    pwm, battery, states, rates, fixes = [], [], [], [], []
    for k in range(steps):
        if k % PILOT_STEPS == 0:
            wanted = pilot.pwm(k * STEP_S, s[:PLANE])
            if wanted is not None:
                propulsion.command(k, wanted)
                pwm.append((k, wanted))
        if k % BATTERY_STEPS == 0:
            battery.append((k, propulsion.V))
        v_c = around.water_at(k, s[0], s[1])
        taus, d = _forces(propulsion, around, k, t0 + k * STEP_S, s, v_c)
        if k % imu_every == 0:
            states.append(s)
            rates.append(hull.at_imu(s, hull.rate(s, taus[0], v_c, d)))
        if k % fix_every == 0:
            fixes.append(hull.under_tag(s))
        s = hull.step(s, taus, v_c, d, STEP_S)
    imu_step, all_states, rate = np.arange(0, steps, imu_every), np.array(states), np.array(rates)
    state = all_states[:, :PLANE]
    accel = rate[:, 3:5] + np.stack([-state[:, 4], state[:, 3]], 1) * state[:, 5:]
    leaning = accel * (world.afloat is None)  # in six degrees of freedom the boat leans by itself
    heel = np.stack(tilt(world, around, imu_step, state[:, 2], leaning), 1)
    if world.afloat:
        heel = heel + all_states[:, PLANE + 1 : PLANE + 3]
    return Track(t0, steps, pwm, battery, imu_step, state, rate, heel,
                 np.arange(0, steps, fix_every), np.array(fixes))  # fmt: skip


def _forces(
    propulsion: Propulsion, around: Surroundings, k: int, t: float, s: tuple, v_c: tuple, V: float | None = None
) -> tuple:
    s = s[:PLANE]
    c, sn = cos(s[2]), sin(s[2])
    nu_r = (s[3] - c * v_c[0] - sn * v_c[1], s[4] - c * v_c[1] + sn * v_c[0], s[5])
    begin, middle, end = propulsion.advance(k, t, nu_r, V)
    x, y, n = around.force(k, s, v_c)
    taus = (
        (begin[0] + x, begin[1] + y, begin[2] + n),
        (middle[0] + x, middle[1] + y, middle[2] + n),
        (end[0] + x, end[1] + y, end[2] + n),
    )
    return taus, around.damping_at(s[0], s[1])


class Recorded:
    """A pilot that repeats commands: what another boat would have done under them."""

    def __init__(self, pwm: list[tuple[int, list[float]]]):
        self._at = dict(pwm)

    def pwm(self, t: float, s: tuple) -> list[float] | None:
        """The command that began at t, if one did."""
        return self._at.get(round(t * STEPS_HZ))


def replay(
    world: World,
    pwm: list[tuple[int, list[float]]],
    battery: list[tuple[int, float]],
    t0: float,
    starts: dict[int, tuple],
    steps: int,
) -> np.ndarray:
    """States (steps, 6) and rates (steps, 6) side by side, open loop, set to the truth at the steps in `starts`.

    No randomness: the worlds that come here have no gusts, waves or ambient force. Thrusters run on through.
    """
    rng = np.random.default_rng(0)
    propulsion, hull, around = Propulsion(world, rng), HullMotion(world), Surroundings(world, steps, t0, rng)
    commands, volts = dict(pwm), dict(battery)
    s, V = starts[0], battery[0][1]
    out = []
    for k in range(steps):
        s, V = starts.get(k, s), volts.get(k, V)
        if k in commands:
            propulsion.command(k, commands[k])
        v_c = around.water_at(k, s[0], s[1])
        taus, d = _forces(propulsion, around, k, t0 + k * STEP_S, s, v_c, V)
        out.append(s + hull.rate(s, taus[0], v_c, d))
        s = hull.step(s, taus, v_c, d, STEP_S)
    return np.array(out)
