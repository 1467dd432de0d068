"""Logs that the paper's own polynomial makes, inside the box in which it means something.

A pilot wants a random speed and a random yaw rate for some seconds, and commands t_x, t_n in proportion to what is
missing, held for a while and with a random part, so that forces are no function of the state. t_y is random: it is
flown, though Table 2 gives it no effect. A run that would leave the box (abkowitz.VALIDITY) ends before it does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.core.abkowitz import KGF_N, VALIDITY, C
from sim.identify.regression import Samples, design
from sim.identify.taylor import simulate_taylor

LOW = np.array([r.low for r in VALIDITY[:3]])
HIGH = np.array([r.high for r in VALIDITY[:3]])
T_MAX = np.array([r.high for r in VALIDITY[3:]]) / KGF_N
HOLD = 10  # steps of a command: 1 s
SECONDS = 60.0


@dataclass(frozen=True)
class PolynomialLog:
    """`x` (k, 6) states, `t_kgf` (k, 3) in force from each instant on, `nu_dot` (k, 3) exact, at `rate_hz`."""

    x: np.ndarray
    t_kgf: np.ndarray
    nu_dot: np.ndarray
    rate_hz: float

    @property
    def samples(self) -> Samples:
        """With the exact accelerations."""
        return Samples(self.x[:, 3:], self.nu_dot, self.t_kgf, self.rate_hz)


def polynomial_logs(
    rng: np.random.Generator, samples: int, coefficients: np.ndarray = C, rate_hz: float = 10.0
) -> list[PolynomialLog]:
    """Runs of 10 to 60 s, `samples` instants in all, of the model with `coefficients` (3, 23)."""
    logs, wanted = [], samples
    while wanted > 0:
        log = _run(rng, coefficients, rate_hz)
        if (k := min(len(log.x), wanted)) >= min(10 * rate_hz, wanted):
            logs.append(PolynomialLog(log.x[:k], log.t_kgf[:k], log.nu_dot[:k], rate_hz))
            wanted -= k
    return logs


def _run(rng: np.random.Generator, coefficients: np.ndarray, rate_hz: float) -> PolynomialLog:
    x = np.concatenate([np.zeros(3), rng.uniform(0.8 * LOW + 0.2 * HIGH, 0.2 * LOW + 0.8 * HIGH)])
    states, forces = [x[None]], []
    for _ in range(round(SECONDS * rate_hz / HOLD)):
        wish = rng.uniform(LOW, HIGH)
        t = np.array([20.0, 0.0, 1.0]) * (wish - x[3:]) + rng.uniform(-0.4, 0.4, 3) * T_MAX
        held = np.tile(np.clip(t, -T_MAX, T_MAX), (HOLD, 1))
        part = simulate_taylor(coefficients, x[None], held[None], 1 / rate_hz)[0]
        inside = ((part[1:, 3:] > LOW) & (part[1:, 3:] < HIGH)).all(axis=1)
        if not inside.all():
            break
        x = part[-1]
        states.append(part[1:])
        forces.append(held)
    path = np.concatenate(states)[:-1] if forces else np.empty((0, 6))
    t_kgf = np.concatenate(forces) if forces else np.empty((0, 3))
    return PolynomialLog(path, t_kgf, design(path[:, 3:], t_kgf) @ coefficients.T, rate_hz)
