"""Thruster forces over time, exactly, with their derivatives to dead time and lag.

    f_dot = (F(pwm(t - t_d), V) - f) / T_lag        one unit of gain per thruster

F holds between changes, so that f is a chain of exponentials; it knows nothing of the hull's motion. From it

    df/dt_d = -f_dot,        df/dT_lag: the same chain, driven by -(F - f) / T_lag^2
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from msgspec.structs import replace

from companion.core.vessel_file import VesselFile
from sim.identify.run import Run
from sim.identify.structured.battery import steady_forces


@dataclass(frozen=True)
class Commands:
    """Steady forces [N] at a gain of one, shape (c, n), in force from `t_s`, shape (c,), until the next."""

    t_s: np.ndarray
    force_n: np.ndarray


def commands_of(run: Run, vessel: VesselFile) -> Commands:
    """What the pulse widths and volts of a run ask of the thrusters of `vessel`, in its order."""
    unit = replace(vessel, thrusters=tuple(replace(t, gain=1.0) for t in vessel.thrusters))
    return Commands(*steady_forces(run, unit))


class ThrustHistory:
    """Forces of one run at a dead time and lag. The first command is taken to have held for ever before."""

    def __init__(self, commands: Commands, dead_time_s: float, lag_s: float):
        self._t, self._F, self._lag = commands.t_s + dead_time_s, commands.force_n, lag_s
        dt = np.diff(self._t)
        keep = np.exp(-dt / lag_s)
        fresh = dt / lag_s**2 * keep
        f = np.empty_like(self._F)  # at each change, before it acts
        s = np.zeros_like(self._F)  # df/dT_lag there
        f[0] = self._F[0]
        for j in range(len(dt)):
            gap = f[j] - self._F[j]
            f[j + 1] = self._F[j] + gap * keep[j]
            s[j + 1] = s[j] * keep[j] + gap * fresh[j]
        self._f, self._s = f, s

    def at(self, t_s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """f, df/d dead time, df/d lag at `t_s` of any shape: each (*shape, n)."""
        j = np.maximum(np.searchsorted(self._t, t_s, side="right") - 1, 0)
        since = np.maximum(t_s - self._t[j], 0.0)[..., None]
        keep = np.exp(-since / self._lag)
        gap = self._f[j] - self._F[j]
        return (
            self._F[j] + gap * keep,
            gap * keep / self._lag,
            self._s[j] * keep + gap * keep * since / self._lag**2,
        )
