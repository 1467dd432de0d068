"""Interface of a model that is validated: it simulates many windows of commands from many initial states."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

STEP_S = 0.05
"""Sampling time of the commands: a change of pulse width is represented to 25 ms."""
CHANNELS = ("position", "heading", "u", "v", "r")
"""Channels of errors; position: distance between simulated and measured position."""
UNITS = {"position": "m", "heading": "rad", "u": "m/s", "v": "m/s", "r": "rad/s"}


@dataclass(frozen=True)
class Commands:
    """Commands of m windows of k steps, each held over its step of `STEP_S`.

    pwm_us     (m, k, n) pulse widths, thrusters in the vessel file's order
    battery_v  (m, k)
    before_us  (m, b, n) pulse widths of the b steps before the window, oldest first, for dead time and lag
    settings   by name, (m, k); a missing setting, or NaN, is nominal
    wind_m_s   (m, k, 2) measured wind, north and east of where it comes from, NaN where unknown; None: there is none
    """

    pwm_us: np.ndarray
    battery_v: np.ndarray
    before_us: np.ndarray
    settings: Mapping[str, np.ndarray] = field(default_factory=dict)
    wind_m_s: np.ndarray | None = None


class Simulator(Protocol):
    """A model in open loop."""

    @property
    def name(self) -> str:
        """Name in tables and pictures."""
        ...

    def simulate(self, x0: np.ndarray, commands: Commands) -> np.ndarray:
        """[x y psi u v r] at the start and after every step, (m, k + 1, 6), from `x0` (m, 6).

        NaN from where a run has diverged beyond all bounds; that raises no exception.
        """
        ...
