"""Design of experiments: which manoeuvre to fly next, and a whole plan for a given time.

Each segment of a library is simulated once with the vessel file's own boat (`nominal`), from rest in the middle and
back. Its Fisher information I is added to the present precision P^-1, C = (P^-1 + I)^-1. The worth of the segment, per
second, by one of two criteria over hull, gains, dead time and lag:

    d       decrease of 1/2 log det C [nats]                                            (D-optimality)
    worst   decrease of log max_i (share_i / least_share_i)

share_i: posterior over prior sigma of parameter i; least_share_i: that after the whole library has been flown `ENOUGH`
times. A plan is made greedily: the segment of greatest worth that fits into the time left, again and again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import msgspec
import numpy as np

from companion.core.configuration.site_file import Site
from companion.core.configuration.tables import ConfigError
from companion.core.configuration.vessel_file import VesselFile
from companion.core.excitation.file import Excitation, Segment
from sim.fitting.excite.information import PLANNED, Knowledge, indices_of_interest, planned_information
from sim.fitting.excite.nominal import NominalFlight, fly_nominal
from sim.fitting.identify.structured_fit import FitSettings

Criterion = Literal["d", "worst"]
ENOUGH = 10.0
"""Flights of the whole library that count as all the information it can give; assumed."""
SHORTEST_S = 5.0
"""A shorter log cannot be fitted (two windows of 2 s, and a second to settle)."""
HARDLY = 0.95
"""A manoeuvre helps a parameter if it lowers its sigma to less than this share; assumed."""
MOST_TIMES = 3
"""Most repetitions of one segment in a plan: a real boat is not quite its model, and variety shows where; assumed."""
STRETCH = 1.4
"""Factor on the time budget: a plan takes less time than its segments with a way back each; observed: 0.8 of it."""

Say = Callable[[str], None]


@dataclass(frozen=True)
class CandidateManoeuvre:
    """A segment that the vessel can fly here: duration with the way back, and Fisher information (P, P) of w."""

    segment: Segment
    duration_s: float
    information: np.ndarray
    least_clearance_m: float


@dataclass(frozen=True)
class AdviceRow:
    """One parameter: knowledge now, and after the segment of the library that is most informative on it."""

    index: int
    now: Knowledge
    after: Knowledge
    best: CandidateManoeuvre


@dataclass(frozen=True)
class Advice:
    """Advice on the next manoeuvre.

    ranked  candidates, the best first
    about   indices of the parameters that the ranking is about
    rows    one for each parameter of interest
    """

    ranked: tuple[CandidateManoeuvre, ...]
    about: tuple[int, ...]
    rows: tuple[AdviceRow, ...]


def candidates(
    library: Excitation, vessel: VesselFile, site: Site, say: Say = lambda _: None, settings: FitSettings = PLANNED
) -> tuple[list[CandidateManoeuvre], list[str]]:
    """Segments with their information, and texts why others were left out. Raises ConfigError if none can be flown.

    `settings`: of the fit that shall be informed.
    """
    usable, left_out = [], []
    for segment in library.segments:
        say(f"flies {segment.name}")
        alone = msgspec.structs.replace(library, segments=(segment,), name=segment.name)
        try:
            flown = fly_nominal(alone, vessel, site)
        except ConfigError as error:
            left_out.append(str(error))
            continue
        if not flown.done:
            left_out.append(f"{segment.name}: the boat did not come back to the middle")
        elif flown.duration_s < SHORTEST_S:
            left_out.append(f"{segment.name}: {flown.duration_s:.1f} s are too short to tell anything")
        else:
            information = planned_information(flown.run, vessel, settings)
            usable.append(CandidateManoeuvre(segment, flown.duration_s, information, flown.least_clearance_m))
    if not usable:
        raise ConfigError("\n".join([f"{library.name}: no segment can be flown", *left_out]))
    return usable, left_out


def least_share(known: Knowledge, library: Sequence[CandidateManoeuvre]) -> np.ndarray:
    """Posterior over prior sigma (P,) after the whole library has been flown `ENOUGH` times."""
    everything = sum((c.information for c in library), start=np.zeros_like(known.precision))
    return known.with_information(ENOUGH * everything).share


def worth_per_s(
    known: Knowledge,
    candidate: CandidateManoeuvre,
    least: np.ndarray,
    criterion: Criterion,
    about: np.ndarray | None = None,
) -> float:
    """Worth of one candidate [1/s] by a criterion (module docstring). `least`: `least_share` of the library.

    `about`: indices of the parameters that it is about (default: hull, gains, dead time and lag).
    """
    of = indices_of_interest(known.vessel) if about is None else about
    after = known.with_information(candidate.information)
    d = gain_nats(known, after, of) / candidate.duration_s
    if criterion == "d":
        return d
    fall = np.log(_worst(known, least, of) / _worst(after, least, of)) / candidate.duration_s
    return float(fall) + 1e-3 * d  # where one segment alone does not help the worst, the other measure decides


def gain_nats(before: Knowledge, after: Knowledge, of: np.ndarray, of_after: np.ndarray | None = None) -> float:
    """1/2 log of the ratio of the determinants of both covariances, of the parameters `of` [nats].

    `of_after`: where these stand in the model of `after`, if it has others beside them.
    """
    return 0.5 * (_log_det(before, of) - _log_det(after, of if of_after is None else of_after))


def _log_det(known: Knowledge, of: np.ndarray) -> float:
    return float(np.linalg.slogdet(known.covariance[np.ix_(of, of)])[1])


def _worst(known: Knowledge, least: np.ndarray, of: np.ndarray) -> float:
    return float((known.share[of] / least[of]).max())


def advise(known: Knowledge, library: Sequence[CandidateManoeuvre]) -> Advice:
    """What to fly next, given present knowledge.

    The advice is about the parameters that are undetermined and that some candidate helps; if there are none, about the
    one furthest from its least share. Candidates are ranked by the decrease of the log shares of these, per second.
    """
    of, after = indices_of_interest(known.vessel), [known.with_information(c.information) for c in library]
    shares = np.array([k.share for k in after])
    helped = shares.min(axis=0) < HARDLY * known.share
    about = [int(i) for i in of if known.undetermined[i] and helped[i]]
    if not about:
        about = [int(of[np.argmax(known.share[of] / least_share(known, library)[of])])]
    fall = np.log(known.share[about] / shares[:, about]).sum(axis=1) / [c.duration_s for c in library]
    ranked = tuple(library[i] for i in np.argsort(-fall))
    best = shares.argmin(axis=0)
    rows = tuple(AdviceRow(int(i), known, after[best[i]], library[best[i]]) for i in of)
    return Advice(ranked, tuple(about), rows)


def choose(
    known: Knowledge,
    library: Sequence[CandidateManoeuvre],
    budget_s: float,
    criterion: Criterion = "d",
    about: np.ndarray | None = None,
) -> tuple[CandidateManoeuvre, ...]:
    """Greedy choice of candidates, in order, until none fits into what is left of `STRETCH` times `budget_s`.

    `about`: as of `worth_per_s`.
    """
    least, chosen, left_s = least_share(known, library), [], STRETCH * budget_s
    while True:
        fits = [c for c in library if c.duration_s <= left_s and sum(c is other for other in chosen) < MOST_TIMES]
        if not fits:
            return tuple(chosen)
        best = max(fits, key=lambda c: worth_per_s(known, c, least, criterion, about))
        chosen.append(best)
        known, left_s = known.with_information(best.information), left_s - best.duration_s


def design(
    known: Knowledge,
    library: Excitation,
    chosen: Sequence[CandidateManoeuvre],
    site: Site,
    budget_s: float,
    *,
    name: str,
) -> tuple[Excitation, NominalFlight]:
    """The plan of `chosen` segments and its nominal flight. The last ones are dropped until it keeps to `budget_s`.

    Raises ConfigError where not even the first fits.
    """
    count = len(chosen)
    while count:
        segments = tuple(c.segment for c in chosen[:count])
        plan = msgspec.structs.replace(library, name=name, segments=segments)
        flown = fly_nominal(plan, known.vessel, site, limit_s=budget_s)
        if flown.done:
            return plan, flown
        count = min(count - 1, flown.statuses[-1].segment)
    raise ConfigError(f"{library.name}: no segment can be flown in {budget_s:g} s")
