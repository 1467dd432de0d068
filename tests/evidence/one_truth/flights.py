"""Evidence: the simulator's own designed flights, identified: is its dead time in the interval that is told?

The boats: `draw_boat` of the example's file (hull, gains, UWB), dead time and lag drawn anew. What flies them and fits
their logs knows the file alone, as `aritra excite design`, `aritra excite fly` and `aritra identify` do. Nothing was
chosen by these seeds; what is as it is was found on seeds from 1000 on.
"""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from companion.boat.load_run import EXAMPLES, RunSetup
from companion.cli.options.setup import setup_instead
from companion.core.configuration.vessel_file import VesselFile
from companion.core.excitation.file import Excitation, load_excitation
from companion.core.excitation.pen import Pen
from companion.logs.readers.read_run import ReadOptions, read_run
from sim.fitting.engine.split import NamedLog
from sim.fitting.excite.design import candidates, choose, design
from sim.fitting.excite.fly import fly, write_logs
from sim.fitting.excite.information import Knowledge
from sim.fitting.identify.job import Choices, identify
from sim.fitting.identify.result import Estimate
from sim.studies.boats.draw import draw_boat
from sim.world.world import WorldSetup
from tests.evidence.line import Line, at_least, information
from tests.evidence.processes import processes

MINUTES = 3.0
"""Of the example of `aritra excite design`."""
SEEDS, OF_THEM = range(1, 31), 10
"""All flights, and how many without `full`: one takes more than half a minute."""
SHARE = 28 / 30
"""Intervals of 95 % that cover the truth, at least."""
BEGIN_UNIX_NS = 1_767_225_600_000_000_000
DEAD_TIME_S, LAG_S = (0.05, 0.20), (0.05, 0.20)
"""Between these, uniform; the file says 0.1 s each."""


class FlownAndFitted(NamedTuple):
    """The drawn boat's truth and what was identified of one flight; `done`: flown to its end."""

    done: bool
    dead_time: tuple[float, Estimate]
    lag: tuple[float, Estimate]


def example() -> RunSetup:
    """The example's run file, vessel and site."""
    return setup_instead(EXAMPLES / "aritra.toml", {}, "excitations")


def designed(setup: RunSetup) -> Excitation:
    """What `aritra excite design --minutes 3` chooses for the file's boat, nothing known of it yet."""
    vessel, site = setup.pilot.vessel, setup.pilot.site
    library = load_excitation((EXAMPLES / "excitations" / "library.toml").read_text(encoding="utf-8"), name="library")
    known, _ = candidates(library, vessel, site)
    now = Knowledge.prior(vessel)
    return design(now, library, choose(now, known, 60 * MINUTES), site, 60 * MINUTES, name="plan")[0]


def drawn(vessel: VesselFile, seed: int) -> VesselFile:
    """The boat of a seed."""
    rng = np.random.default_rng(seed)
    boat = draw_boat(vessel, rng)
    dead_time_s, lag_s = float(rng.uniform(*DEAD_TIME_S)), float(rng.uniform(*LAG_S))
    return replace(boat, propulsion=replace(boat.propulsion, dead_time_s=dead_time_s, lag_s=lag_s))


def flown_and_fitted(plan: Excitation, seed: int) -> FlownAndFitted:
    """The boat of a seed, flown by `plan`, its log identified, both by the example's file."""
    setup = example()
    vessel, site = setup.pilot.vessel, setup.pilot.site
    setup = dataclasses.replace(setup, pilot=dataclasses.replace(setup.pilot, excitation=plan))
    boat = drawn(vessel, seed)
    north, east = map(float, Pen(site).middle)
    flown = fly(setup, WorldSetup(boat, site, start=(north, east, 0.0)), seed)
    with tempfile.TemporaryDirectory() as folder:
        log = read_run(write_logs(flown, setup, Path(folder), BEGIN_UNIX_NS)[0], ReadOptions(vessel, site))
    found = identify([NamedLog("run", log)], [], vessel, Choices(taylor=False), lambda: "2000-01-01T00:00:00Z")
    result, truth = found.structured, boat.propulsion
    return FlownAndFitted(flown.done, (truth.dead_time_s, result["dead_time_s"]), (truth.lag_s, result["lag_s"]))


def flights(full: bool) -> Iterator[Line]:
    """Designed flights of boats drawn at random, in the simulator: dead time and lag as identified"""
    seeds = SEEDS if full else SEEDS[:OF_THEM]
    plan = designed(example())
    with processes(2) as pool:
        found = list(pool.map(partial(flown_and_fitted, plan), seeds))
    yield information("flights flown to their end", sum(f.done for f in found), f"/ {len(found)}")
    goal = np.ceil(SHARE * len(found) - 1e-9)
    for name, pairs in (("dead time", [f.dead_time for f in found]), ("lag", [f.lag for f in found])):
        yield from told(name, pairs, goal)


def told(name: str, pairs: list[tuple[float, Estimate]], goal: float) -> Iterator[Line]:
    """Lines on one parameter from its truths and estimates."""
    inside = [e.ci95[0] <= truth <= e.ci95[1] for truth, e in pairs]
    off_ms = np.array([1e3 * (e.value - truth) for truth, e in pairs])
    sigma_ms = np.array([1e3 * e.se for _, e in pairs])
    yield at_least(f"{name}: 95 % intervals with the truth inside", sum(inside), goal, f"/ {len(pairs)}")
    yield information(f"{name}: median error", float(np.median(np.abs(off_ms))), "ms")
    yield information(f"{name}: mean of the error, signed", float(off_ms.mean()), "ms")
    yield information(f"{name}: half an interval, median", float(np.median(1.96 * sigma_ms)), "ms")
    yield information(f"{name}: error over its standard error, rms", float(np.sqrt(np.mean((off_ms / sigma_ms) ** 2))))
