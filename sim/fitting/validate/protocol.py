"""What a model must be able to do to be validated: simulate many windows of commands from many initial states."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

STEP_S = 0.05
"""Commands are sampled this often: a change of pulse width is met to 25 ms."""
CHANNELS = ("position", "heading", "u", "v", "r")
"""What errors are taken of; position: distance between the two tracks."""
UNITS = {"position": "m", "heading": "rad", "u": "m/s", "v": "m/s", "r": "rad/s"}


@dataclass(frozen=True)
class Commands:
    """What m windows of k steps were told, each held over its step of `STEP_S`.

    `pwm_us` (m, k, n), thrusters in the vessel file's order; `battery_v` (m, k); `before_us` (m, b, n): the steps just
    before the window, oldest first, for dead time and lag. `settings`: by name, (m, k); what is not there is nominal.
    """

    pwm_us: np.ndarray
    battery_v: np.ndarray
    before_us: np.ndarray
    settings: Mapping[str, np.ndarray] = field(default_factory=dict)


class Simulator(Protocol):
    """A model in open loop."""

    @property
    def name(self) -> str:
        """As in tables and pictures."""
        ...

    def simulate(self, x0: np.ndarray, commands: Commands) -> np.ndarray:
        """[x y psi u v r] at the start and after every step, shape (m, k + 1, 6), from `x0` (m, 6).

        NaN from where a run has gone off beyond all bounds; never an exception for that.
        """
        ...
