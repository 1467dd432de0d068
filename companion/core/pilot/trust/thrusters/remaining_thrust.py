"""What is left of the thrusters, and the forces and pulses that make the best of it.

    gain      share of the force that comes for a pulse: 1 sound, 0.4 weak, 0 dead, -1 reversed
    stuck     force [N] that comes whatever the pulse; nobody can stop it
    swapped   pulses of two thrusters that changed places

The plan's body force tau = B f is kept: thrusters that can still be commanded take over what the others do not give.

    f' = argmin |W (B f' - tau)|   within what is left (`allocation`)
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import msgspec
import numpy as np
from msgspec.structs import replace

from companion.core.configuration.vessel_file import VesselFile
from companion.core.control.allocation import allocate, pulse_widths
from companion.core.model.actuators.propulsion import is_steered
from companion.core.model.thrusters import configuration_matrix


class ThrusterHealth(msgspec.Struct, frozen=True):
    """`gains`, `stuck_n` (None: not stuck) and `order` (whose pulse each one gets), in the vessel file's order."""

    gains: tuple[float, ...]
    stuck_n: tuple[float | None, ...]
    order: tuple[int, ...]

    @classmethod
    def sound(cls, n: int) -> ThrusterHealth:
        """All `n` thrusters as the vessel file says."""
        return cls((1.0,) * n, (None,) * n, tuple(range(n)))

    @property
    def is_sound(self) -> bool:
        """Whether nothing is wrong."""
        return self == ThrusterHealth.sound(len(self.gains))

    def known(self, names: Sequence[str]) -> str:
        """What a boat that is ordered anew still takes for granted; empty: all thrusters are sound."""
        if self.is_sound:
            return ""
        lines = [f"thruster {name} {gain_words(g)}" for name, g in zip(names, self.gains, strict=True) if g != 1.0]
        for name, force_n in zip(names, self.stuck_n, strict=True):
            if force_n is not None:
                how = f"is stuck at {force_n:.0f} N" if force_n else "counts as switched off"
                lines.append(f"thruster {name} {how}")
        for i, j in enumerate(self.order):
            if i < j:
                lines.append(f"thrusters {names[i]} and {names[j]} get each other's pulses")
        return f"as found before: {'; '.join(lines)}. Once repaired, restart the boat's program"


def gain_words(gain: float) -> str:
    """What a thruster of this gain does."""
    if gain < 0:
        return "pushes the wrong way: its pulses are turned round"
    return "pushes hardly or not at all" if gain == 0 else f"gives {100 * gain:.0f} % of its force"


PROBE_N, PROBE_NS = 3.0, 1_000_000_000
"""Forces that cancel each other, and how long they push one way; assumed: beyond any dead band, little wear."""


class RemainingThrust:
    """Forces and pulses of one vessel with what is left of its thrusters."""

    def __init__(self, vessel: VesselFile):
        self._vessel, self._B = vessel, configuration_matrix(vessel)
        self._left = lru_cache(maxsize=8)(self._without)
        _, size, V = np.linalg.svd(self._B)
        null = V[int((size > 1e-9 * size.max()).sum()) :]
        if is_steered(vessel):
            null = null[:0]  # nothing is asked of servos
        self._probe_n = PROBE_N * null[0] / np.abs(null[0]).max() if len(null) else np.zeros(len(vessel.controls))

    def _without(self, health: ThrusterHealth) -> VesselFile:
        """The vessel with what is left; one that is stuck cannot be commanded."""
        gains = [0.0 if stuck is not None else g for g, stuck in zip(health.gains, health.stuck_n, strict=True)]
        thrusters = tuple(replace(t, gain=t.gain * g) for t, g in zip(self._vessel.thrusters, gains, strict=True))
        return replace(self._vessel, thrusters=thrusters)

    def probe(self, t_ns: int) -> np.ndarray:
        """Forces (n,) [N] that do not move a sound boat, to and fro: they tell apart what moves it alike."""
        return self._probe_n if t_ns // PROBE_NS % 2 else -self._probe_n

    def redistribute(self, f_n: np.ndarray, health: ThrusterHealth) -> np.ndarray:
        """Forces (n,) [N] that come, for a plan's forces f (n,): the same body force as far as it goes."""
        if health.is_sound:
            return f_n
        stuck = np.array([0.0 if s is None else s for s in health.stuck_n])
        return allocate(self._B @ (f_n - stuck), self._left(health)) + stuck

    def pulses(self, f_n: np.ndarray, health: ThrusterHealth, voltage_v: float) -> tuple[int, ...]:
        """Pulse widths [us], in the vessel file's order, for forces of `redistribute` at a battery voltage [V]."""
        if health.is_sound:
            return pulse_widths(f_n, self._vessel, voltage_v)
        given = np.where([s is None for s in health.stuck_n], f_n, 0.0)
        widths = pulse_widths(given, self._left(health), voltage_v)
        return tuple(widths[i] for i in health.order)
