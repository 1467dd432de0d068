"""Manual driving: shares of the thrusters' reach, and the dead man's grip.

Sticks count while they are fresh. When they are silent for `manual_timeout_s`, or their source changes, the mode
is `locked`: neutral, until all three have been at rest. So a stick that is held, or a client that comes back, never
moves the boat by itself.

    tau_i = share_i * reach_i(sign of share_i)       reach: force along the axis alone, from the thrusters' limits;
                                                     of a boat with servos: the most along it whatever else comes
"""

from __future__ import annotations

import math

import msgspec
import numpy as np
from msgspec.structs import replace

from companion.core.configuration.vessel_file import VesselFile
from companion.core.control.allocation import allocate
from companion.core.excitation.signal import axis_reach
from companion.core.messages import ManualInput
from companion.core.model.actuators.propulsion import ActuatorSet, is_steered
from companion.core.pilot.monitors.monitor import NOTHING, Monitor, MonitorReport

AT_REST = 0.05
"""Shares below this are a stick that nobody holds; assumed: the dead zone of ordinary gamepads."""
AHEAD_NS = 50_000_000
"""A stamp so far in the future is a clock that cannot be trusted; assumed."""


class Sticks(msgspec.Struct, frozen=True):
    """The latest valid input, and whether its source has been at rest since its latest silence or change."""

    last: ManualInput | None = None
    rested: bool = False


NOBODY = Sticks()


class StickMonitor(Monitor[Sticks]):
    """Keeps the latest valid input; `rejection` judges it, in the modes that want sticks."""

    hears = (ManualInput,)
    initial = NOBODY

    def __init__(self, timeout_s: float):
        self._timeout_s = timeout_s

    def on_message(self, state: Sticks, message: ManualInput, t_ns: int) -> tuple[Sticks, MonitorReport]:
        """One input."""
        return take_input(state, message, t_ns, self._timeout_s), NOTHING


def take_input(sticks: Sticks, message: ManualInput, t_ns: int, timeout_s: float) -> Sticks:
    """The state after an input; one that is not finite, beyond -1 to 1, out of order or from the future is ignored."""
    shares, last = _shares(message), sticks.last
    if not all(math.isfinite(s) and abs(s) <= 1.0 for s in shares) or message.t_ns > t_ns + AHEAD_NS:
        return sticks
    if last is not None and message.t_ns < last.t_ns:
        return sticks
    anew = last is None or message.source != last.source or silent(sticks, t_ns, timeout_s) is not None
    rested = max(map(abs, shares)) < AT_REST or (sticks.rested and not anew)
    return Sticks(message, rested)


def silent(sticks: Sticks, t_ns: int, timeout_s: float) -> str | None:
    """Why the sticks are silent, or None."""
    if sticks.last is None:
        return "no sticks yet"
    age_s = (t_ns - sticks.last.t_ns) * 1e-9
    return f"nothing from the sticks ({sticks.last.source}) for {age_s:.1f} s" if age_s > timeout_s else None


def rejection(sticks: Sticks, t_ns: int, timeout_s: float) -> str | None:
    """Why they may not drive, or None."""
    why = silent(sticks, t_ns, timeout_s)
    if why is None and not sticks.rested:
        return f"the sticks ({sticks.last.source if sticks.last else ''}) have not been at rest yet"
    return why


def locked(sticks: Sticks) -> Sticks:
    """The same sticks, which must come to rest again."""
    return replace(sticks, rested=False)


class StickForce:
    """From sticks to tau [N, N, N m] of one vessel, and to commands."""

    def __init__(self, vessel: VesselFile):
        self._vessel = vessel
        self._reach = _most(vessel) if is_steered(vessel) else axis_reach(vessel)

    def commands(self, sticks: Sticks, now: np.ndarray, within_s: float = math.inf) -> np.ndarray:
        """Commands (n,) [N; angles rad], whatever the boat's speed; `now`, `within_s`: as in `allocate`."""
        return allocate(self.tau(sticks), self._vessel, now=now, within_s=within_s)

    def tau(self, sticks: Sticks) -> np.ndarray:
        """Force asked for, shape (3,)."""
        shares = np.array(_shares(sticks.last) if sticks.last else (0.0, 0.0, 0.0))
        return shares * np.where(shares >= 0, self._reach[:, 0], self._reach[:, 1])


def _most(vessel: VesselFile) -> np.ndarray:
    """Largest force along each axis, shape (3, 2), ahead and astern, both positive."""
    actuators = ActuatorSet.of(vessel)
    lower, upper = (side * actuators.directions for side in actuators.limits(None))
    return np.column_stack([np.maximum(lower, upper).sum(axis=1), -np.minimum(lower, upper).sum(axis=1)])


def _shares(message: ManualInput) -> tuple[float, float, float]:
    return message.surge, message.sway, message.yaw
