"""Boats of which length and thrusters' places are known: `aritra identify` after one flight of four manoeuvres."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from msgspec.structs import replace

from companion.boat.load_run import EXAMPLES, load_setup
from companion.core.excitation.file import Multisine
from sim.fitting.engine.split import NamedLog
from sim.fitting.identify.job import Choices, Identification, identify
from sim.fitting.identify.verdict import NAMES
from tests.evidence.commission.draw import DrawnBoat, drawn
from tests.evidence.commission.library_flight import flown, library
from tests.evidence.line import Line, at_least, at_most, information

BOATS, ALL = 4, 12
FLOWN = ("zig-zag", "multisine", "pulses", "stop and reverse")
HALF = 0.5


def identified(seed: int) -> tuple[DrawnBoat, Identification]:
    """The boat of a seed, and what a flight of the manoeuvres in its weather says of it."""
    setup = load_setup(EXAMPLES / "aritra.toml")
    boat = drawn(seed, setup.pilot.vessel)
    segments = [s for s in library().segments if s.name in FLOWN]
    if "differential" in boat.hidden:
        segments = [replace(s, Y=0.0) if isinstance(s, Multisine) else s for s in segments]
    run = flown(boat, setup, segments)
    return boat, identify([NamedLog("flight", run)], [], boat.first, Choices(taylor=False), lambda: "2026-01-01")


def first_guess(full: bool) -> Iterator[Line]:
    """Boats from a first guess, UWB 1 Hz, weather: error of identify's predictions of the last quarter of a flight"""
    count, found = ALL if full else BOATS, []
    seeds = [seed for seed in range(1, 100) if not {"swapped", "reversed"} & set(_boat(seed).hidden)][:count]
    for seed in seeds:
        boat, result = identified(seed)
        errors = result.verdict.relative_error
        own, first = errors[NAMES["structured"]], errors[NAMES["base"]]
        found.append((own, first))
        kept = ", ".join(result.chosen.refinements) or "the model as it is"
        note = f"hidden: {', '.join(boat.hidden) or 'nothing'}; first file {first:.2f}; {result.chosen.method}: {kept}"
        yield information(f"boat {seed}: error over the better guess without a model", own, note=note)
    own, first = np.array(found).T
    yield at_least("boats that the identified file predicts better than the first one", int((own < first).sum()), count)
    yield at_most("error over the first file's, median", float(np.median(own / first)), HALF)


def _boat(seed: int) -> DrawnBoat:
    return drawn(seed, load_setup(EXAMPLES / "aritra.toml").pilot.vessel)


PARTS = (first_guess,)
