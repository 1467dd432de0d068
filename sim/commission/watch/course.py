"""The course of a boat over its missions: belief with forgetting, changes by evidence, and how far to trust a log.

    theta_k+1 = theta_k + drift,  drift ~ N(0, diag(q))                          as believed
    theta_k+1 = theta_k + drift + d_c step  from mission j on                     cause c, step ~ N(0, sigma_c^2)

Each mission's information is weighed by what the model cannot explain: its covariance is s^2 Lambda^-1 + diag(e^2),
e the share that is `unexplained`, and s^2 the median of past missions' squared innovations over their expectation: so
many samples count as one. Evidence for (j, c) is the log ratio of probabilities of all missions since j [nats]. By
Ville's inequality it ever exceeds h with probability exp(-h) at most while nothing changes, as far as the law above
holds; the threshold divides the false alarms wanted among all causes and onsets of `MISSIONS` missions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim.commission.watch.causes import DRIFT, FIRST, Cause, Watched, unexplained
from sim.commission.watch.filter import Belief, Likelihood
from sim.commission.watch.mission_fit import MissionInformation

MISSIONS, FALSE = 200, 0.05
"""At most this chance of any false alarm in so many missions."""
ONSETS = 8  # missions back in which a change may have begun; assumed
REVISED = 2  # missions after it was told in which name, onset and size of a change may still be revised; assumed
SCALE, COUNTS = 2.5, 3  # s^2 before any mission (median of 63 simulated ones), and how many missions this counts as
Z95 = 1.96
SAME_NATS = 1.0  # within this two onsets are as likely; assumed
RIVAL_NATS = 6.0  # as in a diagnosis: within this another cause is not ruled out


@dataclass(frozen=True)
class BegunChange:
    """A change by `cause` in mission `onset` (index), during it or from its start on; belief (B + 1,) since then."""

    cause: Cause
    onset: int
    during: bool
    belief: Belief

    @property
    def step(self) -> float:
        """Size of the change, in units of the cause."""
        return float(self.belief.mean[-1])

    @property
    def se(self) -> float:
        """Its standard error."""
        return float(np.sqrt(self.belief.covariance[-1, -1]))

    @property
    def worth_a_name(self) -> bool:
        """Whether the lower 95 % limit of its size exceeds the smallest size worth a name."""
        return abs(self.step) - Z95 * self.se > self.cause.smallest

    def closed(self) -> Belief:
        """The belief about theta (B,) with the change in it."""
        d = self.cause.direction
        return self.belief.through(np.column_stack([np.eye(len(d)), d]))


@dataclass(frozen=True)
class ToldChange:
    """A change that was told after mission `told` (index): what, evidence [nats], relative size and its 95 % interval.

    `rivals`: names of causes within `RIVAL_NATS`. Of shares the size is relative to what was believed before.
    """

    cause: Cause
    onset: int
    during: bool
    told: int
    nats: float
    size: float
    ci95: tuple[float, float]
    rivals: tuple[str, ...]


@dataclass(frozen=True)
class MissionCourse:
    """After one mission: belief about theta, gain over the vessel file in force, weights.

    gain_nats   log p(this log | believed before it) - log p(this log | file): of data that the belief had not seen
    scale       s^2 by which the log was weighed; `unexplained`: mean of the shares e; `surprise`: squared innovation
    best        evidence of the best change [nats], and its name
    """

    belief: Belief
    gain_nats: float
    scale: float
    unexplained: float
    surprise: float
    best: tuple[float, str]


@dataclass(frozen=True)
class BoatCourse:
    """All missions in order, and the changes that were told."""

    watched: Watched
    missions: tuple[MissionCourse, ...]
    changes: tuple[ToldChange, ...]


def course(missions: Sequence[MissionInformation], watched: Watched, files: Sequence[np.ndarray]) -> BoatCourse:
    """The course over `missions`, in order of time; `files`: theta (B,) of the vessel file in force in each of them."""
    tracker = _Tracker(watched)
    found = [tracker.take(k, mission, file) for k, (mission, file) in enumerate(zip(missions, files, strict=True))]
    return BoatCourse(watched, tuple(found), (*tracker.told, *([tracker.pending] if tracker.pending else [])))


def threshold_nats(causes: int) -> float:
    """Evidence from which a change is told: two hypotheses for each cause begin in every mission."""
    return float(np.log(MISSIONS * 2 * causes / FALSE))


class _Tracker:
    """Belief, hypotheses and changes after the missions taken so far."""

    def __init__(self, watched: Watched):
        self.watched, B = watched, len(watched.names)
        self.base = Belief(np.zeros(B), np.diag((FIRST * watched.scale) ** 2))
        self.bank: list[BegunChange] = []
        self.told: list[ToldChange] = []
        self.pending: ToldChange | None = None
        self.surprises: list[float] = COUNTS * [SCALE]
        self.threshold = threshold_nats(len(watched.causes))

    def take(self, k: int, mission: MissionInformation, file: np.ndarray) -> MissionCourse:
        """One mission further; `file`: theta of the vessel file in force."""
        # 1. The mission's likelihood, by what its model leaves unexplained and by how surprising missions were.
        share, scale = unexplained(mission), max(1.0, float(np.median(self.surprises)))
        plain = Likelihood(mission.precision, mission.eta)
        error = (share * self.watched.scale) ** 2
        seen, before = plain.weighed(scale, error), self.believed
        gain = seen.log_ratio(before.mean, file)
        # 2. As believed, and every change that may have begun.
        drift = (DRIFT * self.watched.scale) ** 2
        self.base = self.base.later(drift)
        surprise = self.base.surprise(plain.weighed(1.0, error))
        self.bank += [
            BegunChange(c, k, d, self.base.with_step(c.sigma)) for c in self.watched.causes for d in (False, True)
        ]
        self.bank = [self._further(h, k, drift, seen) for h in self.bank if self.pending or h.onset > k - ONSETS]
        self.base = self.base.after(seen)
        # 3. Is one of them told?
        best = self._best()
        nats = best.belief.log_p - self.base.log_p
        if self.pending or (nats > self.threshold and best.worth_a_name):
            told = self.pending.told if self.pending else k
            self.pending = self._change(best, told)
        else:
            self.surprises.append(surprise)
        believed = self.believed
        if self.pending and k - self.pending.told >= REVISED:
            self._settle(best)
        return MissionCourse(believed, gain, scale, float(share.mean()), surprise, (nats, best.cause.name))

    @property
    def believed(self) -> Belief:
        """The belief about theta now: with the change that was told last."""
        if not self.pending:
            return self.base
        return self._best().closed()

    def _best(self) -> BegunChange:
        """The likeliest change; of its onsets the latest that is hardly less likely: it began by then."""
        best = max(self.bank, key=lambda h: h.belief.log_p)
        close = [h for h in self.bank if h.cause is best.cause and h.belief.log_p > best.belief.log_p - SAME_NATS]
        return max(close, key=lambda h: (h.onset, h.belief.log_p))

    def _further(self, h: BegunChange, k: int, drift: np.ndarray, seen: Likelihood) -> BegunChange:
        """The hypothesis after mission k; one that began during a mission has its full size from the next on."""
        belief = h.belief
        if h.onset < k:
            growth = h.cause.sigma**2 if h.during and h.onset == k - 1 else 0.0
            belief = belief.later(np.append(drift, growth))
        A = np.column_stack([np.eye(len(drift)), h.cause.direction])
        return replace(h, belief=belief.after(seen.through(A)))

    def _change(self, h: BegunChange, told: int) -> ToldChange:
        now = self.base.log_p
        rivals = {o.cause.name: o.belief.log_p for o in sorted(self.bank, key=lambda o: o.belief.log_p)}
        close = tuple(n for n, p in rivals.items() if n != h.cause.name and p > h.belief.log_p - RIVAL_NATS)
        size, se = h.step, h.se
        if h.cause.unit == "1":  # relative to what was believed before
            d = h.cause.direction
            whole = 1 + float(d @ h.belief.mean[:-1]) / float(d @ d)
            size, se = size / whole, se / abs(whole)
        nats = h.belief.log_p - now
        return ToldChange(h.cause, h.onset, h.during, told, nats, size, (size - Z95 * se, size + Z95 * se), close)

    def _settle(self, best: BegunChange) -> None:
        assert self.pending
        self.told.append(self.pending)
        self.base, self.bank, self.pending = best.closed(), [], None
