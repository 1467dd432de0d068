"""Manoeuvres of the library, flown by a drawn boat in its weather: its log, read by its first file.

Flown by the true file: how to fly an unknown boat inside a fence is `commission`'s matter, and here a gift.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

from msgspec.structs import replace

from companion.boat.load_run import EXAMPLES, RunSetup, setup_of
from companion.core.excitation.file import Excitation, Segment, excitation_toml, load_excitation
from companion.core.excitation.pen import Pen
from companion.core.model.vessel_text import vessel_toml
from companion.logs.readers.read_run import ReadOptions, read_run
from companion.logs.runs.run import Run
from sim.fitting.excite.fly import fly, write_logs
from sim.world.world import WorldSetup
from tests.evidence.commission.draw import DrawnBoat

BEGIN_UNIX_NS = 1_767_225_600_000_000_000


def library() -> Excitation:
    """The manoeuvres to choose from."""
    path = EXAMPLES / "excitations" / "library.toml"
    return load_excitation(path.read_text(encoding="utf-8"), name=path.name)


def world_of(boat: DrawnBoat, setup: RunSetup) -> WorldSetup:
    """The boat in the middle of the water."""
    north_m, east_m = map(float, Pen(setup.pilot.site).middle)
    return WorldSetup(boat.true, setup.pilot.site, start=(north_m, east_m, 0.5), weather=boat.weather)


def flown(boat: DrawnBoat, setup: RunSetup, segments: Sequence[Segment]) -> Run:
    """The log of these manoeuvres one after the other."""
    plan = excitation_toml(replace(library(), segments=tuple(segments)), "manoeuvres of the library")
    files = {**setup.files, "vessel.toml": vessel_toml(boat.true), "excitation.toml": plan}
    own = setup_of(files, {name: name for name in files})
    with tempfile.TemporaryDirectory() as folder:
        log, _ = write_logs(fly(own, world_of(boat, setup), boat.seed), own, Path(folder), BEGIN_UNIX_NS)
        return read_run(log, ReadOptions(boat.first, setup.pilot.site))
