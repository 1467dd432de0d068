"""Logs simulated with the paper's own polynomial, inside its validity box (`validity.VALIDITY`).

A pilot draws a desired speed and yaw rate every second and commands t_x, t_n in proportion to the error, held over the
second and with a random part, so that forces are no function of the state. t_y is random, though Table 2 gives it no
effect. A run ends before it would leave the box.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.fitting.taylor.abkowitz import KGF_N, C
from sim.fitting.taylor.regression import Samples, design
from sim.fitting.taylor.taylor_file import simulate_taylor
from sim.studies.paper.validity import VALIDITY

LOW = np.array([r.low for r in VALIDITY[:3]])
HIGH = np.array([r.high for r in VALIDITY[:3]])
T_MAX = np.array([r.high for r in VALIDITY[3:]]) / KGF_N
HOLD = 10  # steps of a command: 1 s
SECONDS = 60.0
BATCH = 64  # runs simulated at once


@dataclass(frozen=True)
class PolynomialLog:
    """`x` (k, 6) states, `t_kgf` (k, 3) in force from each instant on, `nu_dot` (k, 3) exact, at `rate_hz`."""

    x: np.ndarray
    t_kgf: np.ndarray
    nu_dot: np.ndarray
    rate_hz: float

    @property
    def samples(self) -> Samples:
        """Regression samples with the exact accelerations."""
        return Samples(self.x[:, 3:], self.nu_dot, self.t_kgf, self.rate_hz)


def polynomial_logs(
    rng: np.random.Generator, samples: int, coefficients: np.ndarray = C, rate_hz: float = 10.0
) -> list[PolynomialLog]:
    """Runs of 10 to 60 s, `samples` instants in all, of the model with `coefficients` (3, 23)."""
    logs, wanted = [], samples
    while wanted > 0:
        for x, t in _runs(rng, coefficients, rate_hz):
            k = min(len(t), wanted)
            if k < min(10 * rate_hz, max(wanted, 1)):
                continue
            nu_dot = design(x[:k, 3:], t[:k]) @ coefficients.T
            logs.append(PolynomialLog(x[:k], t[:k], nu_dot, rate_hz))
            wanted -= k
    return logs


def _runs(rng: np.random.Generator, coefficients: np.ndarray, rate_hz: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """States (k, 6) and forces (k, 3) of `BATCH` runs, each cut before the command under which it leaves the box."""
    x = np.column_stack([np.zeros((BATCH, 3)), rng.uniform(0.8 * LOW + 0.2 * HIGH, 0.2 * LOW + 0.8 * HIGH, (BATCH, 3))])
    blocks = round(SECONDS * rate_hz / HOLD)
    states, forces = np.empty((BATCH, blocks * HOLD, 6)), np.empty((BATCH, blocks * HOLD, 3))
    lasted, alive = np.zeros(BATCH, dtype=int), np.ones(BATCH, dtype=bool)
    for b in range(blocks):
        missing = rng.uniform(LOW, HIGH, (BATCH, 3)) - x[:, 3:]
        t = np.array([20.0, 0.0, 1.0]) * missing + rng.uniform(-0.4, 0.4, (BATCH, 3)) * T_MAX
        held = np.repeat(np.clip(t, -T_MAX, T_MAX)[:, None], HOLD, axis=1)
        part = simulate_taylor(coefficients, x, held, 1 / rate_hz)
        alive &= ((part[..., 3:] > LOW) & (part[..., 3:] < HIGH)).all(axis=(1, 2))
        lasted += alive * HOLD
        here = slice(b * HOLD, (b + 1) * HOLD)
        states[:, here], forces[:, here], x = part[:, :-1], held, part[:, -1]
        x[~alive] = 0.0
    return [(states[i, :k], forces[i, :k]) for i, k in enumerate(lasted)]
