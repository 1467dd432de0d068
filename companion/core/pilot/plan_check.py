"""Whether a plan can be meant: what the solver is asked to keep to, checked once more by somebody else.

    finite       rows of one command for each channel: forces [N], angles [rad]
    limits       f_min <= c_k <= f_max
    steep        |c_k+1 - c_k| <= 2 R max(T_lag, step)     the problem's |c_k - f_k| <= R T_lag, with f_k+1 between both
    alternating  the first row does not turn about by more than R T / 2 in `MOST_TURNS` ticks in a row

R: rate limit of the channel, T: control period. What passes is sent within the rate limit, see `within_rate`. A
controller that keeps to its own problem never meets any of these: in calm, rough and high seas none of its first rows
turned about twice in a row by 3 N, and none of its rows was half as steep (stepped runs, aritra.toml).
"""

from __future__ import annotations

from typing import NamedTuple

import msgspec
import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.core.messages import PlanResult
from companion.core.model.actuators.propulsion import channels_of, control_limits

SLACK = 0.01
"""Share by which solvers may miss limits that they keep to; assumed. What is sent is clipped."""
MOST_TURNS = 6
"""Turns about in as many ticks: 0.6 s at 10 Hz; assumed. A boat and its sea do not change so fast."""


class Proposals(msgspec.Struct, frozen=True):
    """First row of the latest plan, how it differed from the one before, and how often in a row that turned about."""

    f_n: tuple[float, ...] = ()
    change_n: tuple[float, ...] = ()
    turns: int = 0


NO_PROPOSALS = Proposals()


class PlanVerdict(NamedTuple):
    """The proposals with this plan; why it cannot be used (None: it can); and whether its maker can be trusted with
    earlier ones: not, where it is finite and yet cannot be meant.
    """

    proposals: Proposals
    problem: str | None = None
    trusted: bool = True


class PlanCheck:
    """Limits of one vessel; `step_s`: of its plans, `period_s`: of its ticks."""

    def __init__(self, vessel: VesselFile, *, step_s: float, period_s: float):
        self._channels = channels = channels_of(vessel)
        self._n, (self._least, self._most) = len(channels), control_limits(vessel)
        range_of = self._most - self._least
        same_unit = np.array([[c.unit == other.unit for other in channels] for c in channels])
        self._room = SLACK * (same_unit * range_of).max(axis=1)  # one for all of a kind: a dead thruster has no range
        self._steep_n = np.array([(1 + SLACK) * 2 * c.rate * max(c.lag_s, step_s) for c in channels])
        self._tick_n = np.array([c.rate * period_s for c in channels])

    def judge(self, before: Proposals, plan: PlanResult) -> PlanVerdict:
        """One plan that came; `before`: what was proposed until now."""
        if plan.status != "ok":
            return PlanVerdict(before, f"plan {plan.status}: {plan.reason}")
        rows = plan.f_n
        if not rows or any(len(row) != self._n for row in rows) or not np.isfinite(rows).all():
            return PlanVerdict(before, f"plan {plan.index} is not sound: expected rows of {self._n} finite forces")
        f = np.array(rows)
        now = self._following(before, f[0])
        problem = self._problem(f) or self._alternates(now)
        return PlanVerdict(now, problem and f"plan {plan.index} is not plausible: {problem}", trusted=problem is None)

    def within_rate(self, last_n: np.ndarray, f_n: np.ndarray) -> np.ndarray:
        """Forces [N] that differ from those of the last tick by the rate limit at most, as for sticks."""
        return np.clip(f_n, last_n - self._tick_n, last_n + self._tick_n)

    def _problem(self, f: np.ndarray) -> str | None:
        beyond = np.maximum(f - self._most, self._least - f) > self._room
        if beyond.any():
            _, thruster = np.argwhere(beyond)[0]
            what, unit = "thruster" if self._channels[thruster].unit == "N" else "servo", self._channels[thruster].unit
            limits = f"{self._least[thruster]:g} to {self._most[thruster]:g} {unit}"
            found = f[:, thruster][beyond[:, thruster]][0]
            return f"{found:.3g} {unit} of {what} {thruster + 1}, which has {limits}"
        steps = np.abs(np.diff(f, axis=0))
        if steps.size and (steps > self._steep_n).any():
            worst = int((steps.max(axis=0) / self._steep_n).argmax())
            unit = self._channels[worst].unit
            most = f"{self._steep_n[worst]:.3g} {unit}"
            return f"it jumps by {steps[:, worst].max():.3g} {unit} between stages, at most {most} can be"
        return None

    def _following(self, before: Proposals, first: np.ndarray) -> Proposals:
        """The newest first row; a turn about counts where one thruster's changes are both large and opposite."""
        if not before.f_n:
            return Proposals(tuple(first))
        change, last = first - before.f_n, np.array(before.change_n or (0.0,) * self._n)
        large = self._tick_n / 2
        turned = bool(((change * last < 0) & (np.abs(change) > large) & (np.abs(last) > large)).any())
        return Proposals(tuple(first), tuple(change), before.turns + 1 if turned else 0)

    @staticmethod
    def _alternates(now: Proposals) -> str | None:
        if now.turns < MOST_TURNS:
            return None
        return f"forces turn about at every tick, {now.turns} times in a row"
