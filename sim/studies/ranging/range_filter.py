"""Range-only filter: position and velocity of a tag from UWB ranges, no IMU, no vessel model.

    x = [x y v_x v_y | b_1 .. b_m],   p_dot = v,   v_dot = white,   b_i: Gauss-Markov

Start: every position that explains the first ranges (`multilaterate`) becomes a hypothesis with its own
filter. All filters are updated; one whose log-likelihood falls too far behind the best is dropped. So later ranges rule
out the mirror image behind anchors that stand almost in a line; with anchors exactly in a line they cannot.

Restart: after a silence in which the position has become less certain than a fix is, a range says where the tag is only
by its distance, and linearised about a place metres away it says so wrongly; the bank starts from fixes again.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from companion.core.configuration.tables import Table
from companion.core.estimation.gates import Gate, GateRule
from companion.core.estimation.kalman import KalmanEquations
from companion.core.estimation.ranging.multilateration import multilaterate
from companion.core.estimation.ranging.ranges import (
    PLACE_SIGMA_M,
    AnchorHistory,
    RangeFusion,
    RangeLayout,
    RangeMeasurement,
    RangeModel,
    explained_places,
    line_of_sight,
    recent_anchors,
)
from companion.core.estimation.tuning import RANGE_GATE

BIAS = 4
LAYOUT = RangeLayout(position=(0, 1), velocity=(2, 3), bias=BIAS)


class RangeFilterTuning(Table, frozen=True, kw_only=True):
    """Noise of the range-only filter. Bias figures from 4 static and moving runs' scatter."""

    acceleration_m_s2_sqrt_s: float = 1.0
    """White acceleration: a walking-speed vehicle that turns within seconds; assumed."""
    range_sigma_m: float = 0.10
    """White part of a range error; 0.02-0.04 m at rest, more in motion: observed."""
    bias_sigma_m: float = 0.10
    bias_time_s: float = 30.0
    """Slow part: offsets of 0.1-0.2 m that last 10 s and more: observed."""
    start_velocity_sigma_m_s: float = 0.5
    fix_spread_m: float = 1.0
    window_s: float = 0.35
    """Ranges no older than this belong to one fix: three cycles at 10 Hz."""
    mirror_cost: float = 6.0
    """A second place that costs so much more than the best is no hypothesis; assumed."""
    drop_log_likelihood: float = 20.0
    """A hypothesis that far behind the best is dropped: odds of e^-20; assumed."""
    gate: GateRule = RANGE_GATE


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """One filter of the bank."""

    x: np.ndarray
    P: np.ndarray
    gates: tuple[Gate, ...]
    log_likelihood: float = 0.0


FARTHEST_M = 1e4
"""No UWB radio reaches so far: a longer range is nonsense, as in the Run format."""


@dataclass(frozen=True, slots=True)
class RangeState:
    """The bank, likeliest first; empty until the first fix. `latest`: the latest range per anchor."""

    t_ns: int
    latest: tuple[AnchorHistory | None, ...]
    bank: tuple[Hypothesis, ...] = ()
    refused: int = 0
    rejected: int = 0


class RangeFilter:
    """Constant settings of one filter; `step` is pure in the state."""

    def __init__(self, anchors_m: np.ndarray, down_m: float, tuning: RangeFilterTuning | None = None):
        """`anchors_m` (m, 3) NED (or any axes with a common vertical), `down_m`: the tag's height there."""
        self.anchors_m, self.down_m = anchors_m, down_m
        self.tuning = tuning or RangeFilterTuning()
        self._algebra = KalmanEquations(BIAS + len(anchors_m))
        noise = self.tuning
        self._ranges = RangeFusion(self._algebra, LAYOUT, noise.range_sigma_m, noise.gate, noise.fix_spread_m)

    def initial(self) -> RangeState:
        """State before the first range."""
        return RangeState(-(1 << 62), (None,) * len(self.anchors_m))

    def step(self, state: RangeState, t_ns: int, anchor: int, range_m: float) -> RangeState:
        """State after one range of anchor number `anchor`, in order of time; nonsense is counted."""
        if not 0 < range_m <= FARTHEST_M or t_ns < state.t_ns:
            return replace(state, refused=state.refused + 1)
        if state.bank and self._is_lost(state, t_ns):
            state = replace(state, bank=(), latest=self.initial().latest)
        latest = tuple(AnchorHistory(t_ns, range_m) if i == anchor else old for i, old in enumerate(state.latest))
        if not state.bank:
            return RangeState(t_ns, latest, self._start(latest, t_ns), state.refused, state.rejected)
        dt_s = (t_ns - state.t_ns) * 1e-9
        bank = [self._advance(h, dt_s, t_ns, anchor, latest, range_m) for h in state.bank]
        bank.sort(key=lambda h: -h.log_likelihood)
        least = bank[0].log_likelihood - self.tuning.drop_log_likelihood
        rejected = state.rejected + bool(bank[0].gates[anchor].rejections)
        kept = tuple(h for h in bank if h.log_likelihood >= least)
        return RangeState(t_ns, latest, kept, state.refused, rejected)

    def _is_lost(self, state: RangeState, t_ns: int) -> bool:
        """Whether no range has come for so long that a fix knows more of the position than the filter does."""
        best, dt_s = state.bank[0], (t_ns - state.t_ns) * 1e-9
        if dt_s <= self.tuning.window_s:
            return False
        _, P = self._predict(best.x, best.P, dt_s)
        return bool(np.linalg.eigvalsh(P[:2, :2])[-1] > PLACE_SIGMA_M**2)

    def _start(self, latest: tuple[AnchorHistory | None, ...], t_ns: int) -> tuple[Hypothesis, ...]:
        """One hypothesis per place that explains the ranges at hand; none before the window has passed."""
        tuning, m = self.tuning, len(self.anchors_m)
        use = recent_anchors(latest, t_ns, tuning.window_s)
        first_ns = min(seen.t_ns for seen in latest if seen)
        if len(use) < 3 or (len(use) < m and t_ns - first_ns < tuning.window_s * 1e9):
            return ()
        ranges = np.array([seen.range_m for i in use if (seen := latest[i])])
        fixes = multilaterate(self.anchors_m[use], ranges, self.down_m, tuning.fix_spread_m)
        sigmas = [PLACE_SIGMA_M] * 2 + [tuning.start_velocity_sigma_m_s] * 2 + [tuning.bias_sigma_m] * m
        P = np.diag(np.square(sigmas))
        return tuple(
            Hypothesis(np.array([f.north_m, f.east_m] + [0.0] * (2 + m)), P, (Gate(),) * m, -f.cost)
            for f in fixes
            if f.inliers.sum() >= 3 and f.cost <= fixes[0].cost + tuning.mirror_cost
        )

    def _advance(
        self,
        old: Hypothesis,
        dt_s: float,
        t_ns: int,
        anchor: int,
        latest: tuple[AnchorHistory | None, ...],
        range_m: float,
    ) -> Hypothesis:
        """Predict one hypothesis over dt_s and judge the new range with it."""
        tuning = self.tuning
        x, P = self._predict(old.x, old.P, dt_s)
        m = RangeMeasurement(anchor, range_m, self._model, partial(self._find, latest, t_ns))
        fused = self._ranges.fuse(x, P, old.gates, m, t_ns)
        gates = tuple(fused.gate if i == anchor else g for i, g in enumerate(old.gates))
        d2 = min(fused.innovation**2 / fused.S, tuning.gate.limit**2)
        return Hypothesis(fused.x, fused.P, gates, old.log_likelihood - (d2 + math.log(fused.S)) / 2)

    def _model(self, anchor: int, x: np.ndarray) -> RangeModel:
        """Distance and bias, and their derivatives."""
        distance, e = line_of_sight(np.array([x[0], x[1], self.down_m]), self.anchors_m[anchor])
        row = np.zeros(len(x))
        row[:2], row[BIAS + anchor] = e[:2], 1.0
        return RangeModel(distance + x[BIAS + anchor], row)

    def _find(self, latest: tuple[AnchorHistory | None, ...], t_ns: int, x: np.ndarray) -> tuple[float, float] | None:
        """The place nearest to x that the latest ranges explain."""
        places = explained_places(
            self.anchors_m, latest, x[BIAS:], t_ns, window_s=self.tuning.window_s, down_m=self.down_m,
            spread_m=self.tuning.fix_spread_m,
        )  # fmt: skip
        return min(places, key=lambda place: math.dist(place, x[:2]), default=None)

    def _predict(self, x: np.ndarray, P: np.ndarray, dt_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Constant velocity with white acceleration; biases decay towards zero."""
        tuning = self.tuning
        keep = math.exp(-dt_s / tuning.bias_time_s)
        F = np.diag([1.0] * BIAS + [keep] * len(self.anchors_m))
        F[0, 2] = F[1, 3] = dt_s
        Q = np.diag([0.0] * BIAS + [tuning.bias_sigma_m**2 * (1 - keep**2)] * len(self.anchors_m))
        q = tuning.acceleration_m_s2_sqrt_s**2
        for p, v in ((0, 2), (1, 3)):
            Q[p, p], Q[p, v], Q[v, p], Q[v, v] = q * dt_s**3 / 3, q * dt_s**2 / 2, q * dt_s**2 / 2, q * dt_s
        return F @ x, self._algebra.predict(P, F @ x, F, Q)
