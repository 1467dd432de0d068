"""Random boats, each commissioned in the simulator from a file that knows its length and thrusters' places only."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterator, Sequence

import numpy as np

from sim.commission.stages import PROVEN, STAGES
from tests.evidence.commission.draw import CAUSES
from tests.evidence.commission.one_boat import FIRST, MINUTES, OneBoat, commissioned
from tests.evidence.commission.others import OTHERS
from tests.evidence.line import Line, at_least, at_most, exactly, information
from tests.evidence.processes import processes

BOATS, ALL, STAGED = 2, 40, 10
"""How many are commissioned, and of how many the file after each stage is driven with, too."""
AS_GOOD, AS_SURE = 1.15, 1.2
SHARE, WORDS, BETTER = 0.9, 0.75, 0.75
"""Of all boats, that must drive as well; of those that do not, that must say why; of all, that must drive better than
by what others do."""
CHANCE = 0.05
"""Two missions a boat: ratios that differ by less, as a share, are a tie; assumed."""
CROSS_TRACK, POSITION = "cross_track_rms_m", "position_rmse_m"
OVER_TRUE = "cross-track over the true file's"
KEYWORDS = {
    **{name: (name,) for name in CAUSES},
    "swapped": ("places",),
    "reversed": ("wrong way", "reversed"),
    "compass": ("compass", "heading"),
}
"""What the reason must speak of where this is hidden."""


def boats(full: bool) -> Iterator[Line]:
    """Random boats from a first guess, beside half an hour by others: 2 (--full: 40, stages of 10; seeds from 1)"""
    found = yield from _each(_commissioned, ALL if full else BOATS)
    yield from _driven(found)
    yield from _safe(found)
    yield from _others(found)
    yield from _stages(found[:STAGED])


def _commissioned(seed: int) -> OneBoat:
    return commissioned(seed, stages=seed <= STAGED, others=True)


def _each(job: Callable[[int], OneBoat], count: int) -> Generator[Line, None, list[OneBoat]]:
    """The boats of seeds 1 to `count`, side by side."""
    found = []
    with processes() as pool:
        for one in pool.map(job, range(1, count + 1)):
            found.append(one)
            yield information(f"boat {one.seed}: {OVER_TRUE}", one.ratio(CROSS_TRACK), note=_story(one))
    return found


def _story(one: OneBoat) -> str:
    hidden = f"hidden: {', '.join(one.hidden) or 'nothing'}"
    others = [f"{name} {one.ratio(CROSS_TRACK, name):.2f}" for name in OTHERS if name in one.missions]
    story = (hidden, f"{one.minutes:.1f} min", f"position {one.ratio(POSITION):.2f}", *others, *one.said)
    return "; ".join(story)


def good(one: OneBoat) -> bool:
    """Whether it drives as with the true file."""
    return one.reached and one.ratio(CROSS_TRACK) <= AS_GOOD


def rightly(one: OneBoat) -> bool:
    """Whether a boat that does not drive so says why: it speaks of what is hidden in it."""
    words = [word for name, known in KEYWORDS.items() if name in one.hidden for word in known]
    return not one.reached and any(word in text for word in words for text in one.said)


def _driven(found: Sequence[OneBoat]) -> Iterator[Line]:
    count = len(found)
    sure = [one for one in found if one.reached and one.ratio(POSITION) <= AS_SURE]
    yield at_least(f"boats with cross-track <= {AS_GOOD:g} x", sum(map(good, found)), SHARE * count, note=f"of {count}")
    yield at_least(f"boats with position error <= {AS_SURE:g} x", len(sure), SHARE * count, note=f"of {count}")
    others = [one for one in found if not good(one)]
    if others:
        why = sum(map(rightly, others))
        yield at_least("of the others, those that say why, rightly", why, WORDS * len(others), note=f"of {len(others)}")
    yield at_most("minutes until the file was proven, longest", max(one.minutes for one in found), MINUTES, "min")
    yield information("minutes, median", float(np.median([one.minutes for one in found])), "min")


def _safe(found: Sequence[OneBoat]) -> Iterator[Line]:
    yield exactly("boats that were beyond the fence", sum(one.room_m < 0 for one in found), 0)
    yield information("least room to the fence", min(one.room_m for one in found), "m")
    yield exactly("thrust while out of bounds", sum(one.outside_s for one in found), 0, "s")


def _stages(found: Sequence[OneBoat]) -> Iterator[Line]:
    """Medians over the boats: cross-track with what was believed after each stage, its nats and minutes."""
    yield information(f"first file: {OVER_TRUE}", _median([one.ratio(CROSS_TRACK, FIRST) for one in found]))
    for stage in (s.name for s in STAGES if s is not PROVEN):
        own = [flights for one in found if (flights := [r for name, r in one.flights if name == stage])]
        nats = _median([sum(r.gained or 0.0 for r in flights) for flights in own])
        minutes = _median([sum(r.seconds for r in flights) / 60 for flights in own])
        note = f"flown by {len(own)}; {nats:.1f} nats in {minutes:.1f} min"
        yield information(
            f"after {stage}: {OVER_TRUE}", _median([o.ratio(CROSS_TRACK, stage) for o in found]), note=note
        )
    yield information(f"new file: {OVER_TRUE}", _median([one.ratio(CROSS_TRACK) for one in found]))


def _others(found: Sequence[OneBoat]) -> Iterator[Line]:
    """How many boats drive better by the new file than by what others found; a boat without a file drives worst."""
    for name in OTHERS:
        pairs = [(_worst(one.ratio(CROSS_TRACK)), _worst(one.ratio(CROSS_TRACK, name))) for one in found]
        better = sum(own < other for own, other in pairs)
        note = f"of {len(found)}; {OVER_TRUE}: median {np.median([other for _, other in pairs]):.3f}"
        yield at_least(f"drive better than by {name}", better, BETTER * len(found), note=note)
        tied = sum(own <= other * (1 + CHANCE) and math.isfinite(own) for own, other in pairs)
        yield information("better, or as well within chance", tied, note=f"of {len(found)}; {name}: {MINUTES:g} min")


def _worst(ratio: float) -> float:
    return math.inf if math.isnan(ratio) else ratio


def _median(values: Sequence[float]) -> float:
    known = [v for v in values if not math.isnan(v)]
    return float(np.median(known)) if known else math.nan
