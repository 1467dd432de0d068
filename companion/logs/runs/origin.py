"""Where on earth a run's positions begin if no site says it: at a fix of its own, which the source of `north_m` states.

So that logs of one water can be compared: their places on earth are the same, though each has an origin of its own.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
import polars as pl
from msgspec.structs import replace

from companion.core.geometry.frames import Origin, geodetic_from_site, site_from_geodetic
from companion.logs.runs.run import PAIRS, LogProblem, Run, RunMeta

NEAR_M = 10_000.0
"""Origins further apart than this are of two waters: the earth is no plane; assumed."""
ORIGINS = "origins"
"""Kind of a note: positions of the logs have different origins."""
_WORDS = "origin at the first fix, {:.7f} {:.7f}, axes to true north"
_STATED = re.compile(r"origin at the first fix, (-?\d+\.\d+) (-?\d+\.\d+), axes to true north")


def origin_words(origin: Origin) -> str:
    """What the source of a position says of an origin that no site file gives."""
    return _WORDS.format(origin.latitude_deg, origin.longitude_deg)


def stated_origin(run: Run) -> Origin | None:
    """The origin that the source of the run's positions states; None where it is a site's, or not known."""
    found = _STATED.search(run.meta.columns.get("north_m", ""))
    return Origin(float(found[1]), float(found[2])) if found else None


def with_one_origin(runs: Sequence[Run]) -> list[Run]:
    """Runs with positions from one origin, the first that one of them states, as far as their own are known to be near.

    Those that are moved, or whose origin is another, say so in a note.
    """
    first = next((run for run in runs if stated_origin(run)), None)
    own = {words for run in runs if run.known("north_m") and (words := _whence(run))}
    if len(own) < 2:
        return list(runs)
    return [_about(first, run) for run in runs]


def _whence(run: Run) -> str:
    """The origin of a run's positions in words; empty where nothing is known of it."""
    origin = stated_origin(run)
    if origin:
        return f"{origin.latitude_deg:.7f} {origin.longitude_deg:.7f}"
    return "" if run.meta.site == RunMeta().site else f"site {run.meta.site}"


def _about(first: Run | None, run: Run) -> Run:
    """`run` with positions from the origin of `first`, where both state one and these are near; with a note in any case
    but that of `first` itself.
    """
    to, origin = stated_origin(first) if first else None, stated_origin(run)
    if origin and origin == to:
        return run
    if first and to and origin:
        north_m, east_m = site_from_geodetic(to, origin.latitude_deg, origin.longitude_deg)
        if np.hypot(north_m, east_m) < NEAR_M:
            text = (
                f"its positions are from the origin of {first.meta.source}, {north_m:.1f} m north and {east_m:.1f} m "
                "east of which its own lies"
            )
            return _moved(run, origin, to).with_notes([LogProblem(kind=ORIGINS, text=text)])
    text = (
        f"its positions have another origin ({_whence(run) or 'not stated'}) than those of other logs: what depends on "
        "the place means nothing across them; name one site for all with --site"
    )
    return run.with_notes([LogProblem(kind=ORIGINS, text=text)])


def _moved(run: Run, origin: Origin, to: Origin) -> Run:
    """`run` with all its positions from `to`, which were from `origin`."""
    table = run.table
    for names in (pair for pair in PAIRS if pair[0].endswith("north_m") and set(pair) <= set(table.columns)):
        places = table.select(names).to_numpy()
        known = ~np.isnan(places).any(axis=1)
        places[known] = np.column_stack(site_from_geodetic(to, *geodetic_from_site(origin, *places[known].T)))
        columns = (pl.Series(name, values).fill_nan(None) for name, values in zip(names, places.T, strict=True))
        table = table.with_columns(columns)
    words = {n: c.replace(origin_words(origin), origin_words(to)) for n, c in run.meta.columns.items()}
    return Run(table, replace(run.meta, columns=words), run.of)
