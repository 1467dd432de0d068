"""Stability of a model: simulations from random states, under random commands and without thrust.

    driven   pulse widths drawn anew every 10 s between the limits, 60 s: share of runs that leave the enlarged box
    free     no thrust, 60 s: share that leaves it; share that comes to rest (below 20 % of the start, or 0.05 m/s)

The energy of a boat without thrust in still water can only fall: a free run that speeds up is wrong, whatever the data.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.core.constants import NEUTRAL_US
from sim.fitting.validate.protocol import STEP_S, Commands, Simulator
from sim.fitting.validate.scores import SpeedBox

SECONDS = 60.0
HOLD_S = 10.0
RUNS = 100


@dataclass(frozen=True)
class Stability:
    """Shares of `runs` runs that diverge (driven, free) or come to rest (free)."""

    name: str
    driven_diverged: float
    free_diverged: float
    free_at_rest: float
    runs: int


def stability(model: Simulator, vessel: VesselFile, box: SpeedBox, seed: int, runs: int = RUNS) -> Stability:
    """Simulate `runs` runs of `SECONDS` from states drawn uniformly in the box, driven and free.

    Pulse widths are drawn uniformly within the vessel's limits; the battery has its nominal voltage.
    """
    rng = np.random.default_rng(seed)
    n, steps, hold = len(vessel.thrusters), round(SECONDS / STEP_S), round(HOLD_S / STEP_S)
    x0 = np.hstack([np.zeros((runs, 3)), rng.uniform(box.low, box.high, (runs, 3))])
    low, high = np.array([(t.pwm_min_us, t.pwm_max_us) for t in vessel.thrusters], dtype=float).T
    drawn = rng.uniform(low, high, (runs, -(-steps // hold), n))
    neutral = np.array([NEUTRAL_US + t.trim_us for t in vessel.thrusters])
    still = np.tile(neutral, (runs, 2, 1))
    volts = np.full((runs, steps), vessel.propulsion.nominal_voltage_V)
    driven = model.simulate(x0, Commands(np.repeat(drawn, hold, axis=1)[:, :steps], volts, still))
    free = model.simulate(x0, Commands(np.tile(neutral, (runs, steps, 1)), volts, still))
    start = np.linalg.norm(x0[:, 3:], axis=1)
    end = np.linalg.norm(free[:, -1, 3:], axis=1)
    return Stability(
        name=model.name,
        driven_diverged=float(box.left(driven[..., 3:]).any(axis=1).mean()),
        free_diverged=float(box.left(free[..., 3:]).any(axis=1).mean()),
        free_at_rest=float((end < np.maximum(0.2 * start, 0.05)).mean()),
        runs=runs,
    )
