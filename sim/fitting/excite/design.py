"""Which manoeuvre to fly next, and a whole plan for the time there is.

Each segment of a library is flown once by the vessel file's own boat (`nominal`), from rest in the middle and back.
What it would tell, added to what is known, is its worth:

    d       fall of 1/2 log det C [nats] over hull, gains, dead time and lag, per second
    worst   fall of the log of the worst parameter's share of its prior over the best that is to be had, per second

A plan takes the worthiest segment that fits, again and again. The best that is to be had: the library flown `ENOUGH`
times over.
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
from sim.fitting.excite.information import Knowledge, indices_of_interest, planned_information
from sim.fitting.excite.nominal import NominalFlight, fly_nominal

Criterion = Literal["d", "worst"]
ENOUGH = 10.0
SHORTEST_S = 5.0
"""A log as short as this tells nothing that the fit could use (two windows of 2 s, and a second to settle)."""
HARDLY = 0.95
"""A manoeuvre that leaves more than this of what is unknown is no remedy."""
MOST_TIMES = 3
"""So often a plan may hold one segment: a real boat is not quite its model, and variety shows where; assumed."""

STRETCH = 1.4
"""Segments flown one after the other take less time than each on its own with its way back; observed: 0.8 of it."""

Say = Callable[[str], None]


@dataclass(frozen=True)
class CandidateManoeuvre:
    """A segment that the vessel can fly here: how long with the way back, and what it tells (P, P)."""

    segment: Segment
    duration_s: float
    information: np.ndarray
    least_clearance_m: float


@dataclass(frozen=True)
class AdviceRow:
    """One parameter: shares of the prior now and after the segment of the library that shows it best."""

    index: int
    now: Knowledge
    after: Knowledge
    best: CandidateManoeuvre


@dataclass(frozen=True)
class Advice:
    """What to do next: candidates by worth, the parameters that it is about, and a row a parameter of interest."""

    ranked: tuple[CandidateManoeuvre, ...]
    about: tuple[int, ...]
    rows: tuple[AdviceRow, ...]


def candidates(
    library: Excitation, vessel: VesselFile, site: Site, say: Say = lambda _: None
) -> tuple[list[CandidateManoeuvre], list[str]]:
    """Segments with what they tell, and why others were left out. Raises ConfigError where none can be flown."""
    found, left_out = [], []
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
            information = planned_information(flown.run, vessel)
            found.append(CandidateManoeuvre(segment, flown.duration_s, information, flown.least_clearance_m))
    if not found:
        raise ConfigError("\n".join([f"{library.name}: no segment can be flown", *left_out]))
    return found, left_out


def least_share(known: Knowledge, library: Sequence[CandidateManoeuvre]) -> np.ndarray:
    """Share of the prior that is left when the library has been flown `ENOUGH` times, (P,)."""
    everything = sum((c.information for c in library), start=np.zeros_like(known.precision))
    return known.with_information(ENOUGH * everything).share


def worth_per_s(known: Knowledge, candidate: CandidateManoeuvre, least: np.ndarray, criterion: Criterion) -> float:
    """Of one candidate [1/s]; `least`: as `least_share`."""
    after, of = known.with_information(candidate.information), indices_of_interest(known.vessel)
    d = 0.5 * (_log_det(known, of) - _log_det(after, of)) / candidate.duration_s
    if criterion == "d":
        return d
    fall = np.log(_worst(known, least, of) / _worst(after, least, of)) / candidate.duration_s
    return float(fall) + 1e-3 * d  # where one segment alone does not help the worst, the other measure decides


def _log_det(known: Knowledge, of: np.ndarray) -> float:
    return float(np.linalg.slogdet(known.covariance[np.ix_(of, of)])[1])


def _worst(known: Knowledge, least: np.ndarray, of: np.ndarray) -> float:
    return float((known.share[of] / least[of]).max())


def advise(known: Knowledge, library: Sequence[CandidateManoeuvre]) -> Advice:
    """What to fly next, given what is known.

    It is about the parameters that are not determined and that some candidate would help; where there is none, about
    the one farthest from the best that is to be had. Ranked by the fall of their log shares per second.
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
    known: Knowledge, library: Sequence[CandidateManoeuvre], budget_s: float, criterion: Criterion = "d"
) -> tuple[CandidateManoeuvre, ...]:
    """Candidates in order of choice until nothing fits into `budget_s`, stretched by `STRETCH`, any more."""
    least, chosen, left_s = least_share(known, library), [], STRETCH * budget_s
    while True:
        fits = [c for c in library if c.duration_s <= left_s and sum(c is other for other in chosen) < MOST_TIMES]
        if not fits:
            return tuple(chosen)
        best = max(fits, key=lambda c: worth_per_s(known, c, least, criterion))
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
    """The plan of `chosen` segments and its nominal flight; last ones are dropped until it keeps to `budget_s`.

    Raises ConfigError where not even the first one fits.
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
