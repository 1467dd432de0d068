"""The catalogue of effects: hull, propulsion, environment, sensors. `catalogue` makes it for one boat and its logs.

Every entry competes on the same terms: an equation as hooks, parameters with priors, the smallest size worth a name.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.logs.runs.run import Run
from sim.fitting.diagnose.catalogue import environment, hull, propulsion, sensors, stochastic
from sim.fitting.diagnose.catalogue.effect import Effect
from sim.fitting.diagnose.catalogue.propulsion import STARTS, Onset
from sim.fitting.diagnose.posterior.clock import LogClock
from sim.fitting.diagnose.vessel_edits.public_table import PUBLIC
from sim.fitting.engine.windows import reads_lean

ONSET_STEP_S = 60.0  # interval between the starts of the search for an onset; assumed
LONG_S = 1200.0
"""Longest span with an onset every `ONSET_STEP_S`; longer logs get no more entries than this one: memory; assumed."""
ACROSS = 3  # starts of the search for a zone along each axis; assumed


def catalogue(
    vessel: VesselFile, runs: Sequence[Run], more: Sequence[Effect] = (), clock: LogClock | None = None
) -> tuple[Effect, ...]:
    """All entries for `vessel` and the logs `runs`; `more`: a user's own; `clock`: of the logs (default: of `runs`).

    ValueError where two entries have one id.
    """
    places = np.concatenate([run.samples("north_m", "east_m")[1] for run in runs])
    low, high = np.quantile(places, (0.05, 0.95), axis=0)
    share = (np.arange(ACROSS) + 0.5) / ACROSS
    centres = tuple(
        (float(n), float(e)) for n in low[0] + share * (high - low)[0] for e in low[1] + share * (high - low)[1]
    )
    clock = clock or LogClock.of(runs)
    begins, lengths = np.array([(clock.start_s(run), run.duration_s) for run in runs]).T
    start, end = float(begins.min()), float((begins + lengths).max())
    onsets = _onsets(begins, lengths, start, end)
    levelled = not any(reads_lean(run) for run in runs)
    entries = (
        *hull.base(vessel),
        *sensors.accelerometers(vessel, levelled),
        *propulsion.base(vessel),
        *hull.effects(vessel),
        *propulsion.effects(vessel, onsets),
        *environment.effects(vessel, centres, min(end - start, LONG_S)),
        *sensors.effects(vessel, levelled),
        *more,
    )
    ids = [e.id for e in entries]
    if twice := {i for i in ids if ids.count(i) > 1}:
        raise ValueError(f"effect {sorted(twice)[0]!r} is in the catalogue twice")
    return entries


def _onsets(begins: np.ndarray, lengths: np.ndarray, start: float, end: float) -> tuple[Onset, ...]:
    """Starts of the search for an onset on the shared clock, each with the half width that it covers [s].

    `begins`, `lengths` (logs,); `start`, `end` of the shared clock [s]. One every `ONSET_STEP_S` of the span; where the
    span exceeds `LONG_S`, one every `ONSET_STEP_S` of each log; where that is too many, evenly over the logged time.
    """
    if end - start <= LONG_S:
        return tuple((t, ONSET_STEP_S / 2) for t in np.arange(start + ONSET_STEP_S / 2, end, ONSET_STEP_S).tolist())
    counts = np.maximum(np.rint(lengths / ONSET_STEP_S), 1).astype(int)
    if counts.sum() <= LONG_S / ONSET_STEP_S:
        apart = np.repeat(lengths / counts, counts)
        within = np.concatenate([np.arange(n) + 0.5 for n in counts]) * apart
        reach = np.maximum(apart / 2, STARTS)  # a second or more between two starts
        return tuple(sorted(zip((np.repeat(begins, counts) + within).tolist(), reach.tolist(), strict=True)))
    ends = np.cumsum(lengths)
    count = int(min(LONG_S, ends[-1]) // ONSET_STEP_S) or 1
    at = (np.arange(count) + 0.5) / count * ends[-1]
    log = np.searchsorted(ends, at)
    return tuple((t, ONSET_STEP_S) for t in sorted((begins[log] + at - (ends - lengths)[log]).tolist()))


def without_effects(entries: Sequence[Effect], names: Sequence[str]) -> tuple[Effect, ...]:
    """`entries` without those of `names`: full names, or families (`thruster_gain` of `thruster_gain:rear_port`).

    Shows what a diagnosis says of an effect that it does not know. ValueError for an unknown name; one that other boats
    or logs have is left out already.
    """
    known = {e.name for e in (*entries, *stochastic.effects()) if e.family != "base"}
    families = {name.partition(":")[0] for name in known} | PUBLIC.keys()
    if unknown := [name for name in names if name not in known | families]:
        raise ValueError(f"without {unknown[0]!r}: no such effect; there are {', '.join(sorted(families))}")
    return tuple(e for e in entries if e.family == "base" or not {e.name, e.name.partition(":")[0]} & set(names))
