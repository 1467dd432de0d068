"""What others do with half an hour: drive by hand, or fly zig-zags and circles, and `aritra identify` of the log."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

from msgspec.structs import replace

from companion.boat.load_run import EXAMPLES, RunSetup, setup_of
from companion.core.configuration.vessel_file import VesselFile
from companion.core.excitation.file import excitation_toml, load_excitation
from companion.core.excitation.pen import Pen
from companion.core.excitation.signal import signals
from companion.core.model.vessel_text import vessel_toml
from companion.logs.readers.read_run import ReadOptions, read_run
from companion.logs.runs.run import Run
from sim.fitting.engine.split import NamedLog
from sim.fitting.excite.fly import fly, write_logs
from sim.fitting.identify.job import Choices, identify
from sim.fitting.wiring.check import checked
from sim.world.teleop_log import teleop_run
from sim.world.world import WorldSetup
from tests.evidence.commission.draw import DrawnBoat

HALF_AN_HOUR_S = 1800.0
ALONE_S = 1.0
"""So long the person lets each thruster push alone at first, each way."""
STANDARD = ("zig-zag", "circle to starboard", "circle to port")
BEGIN_UNIX_NS = 1_767_225_600_000_000_000
DATE = "2026-01-01"


def by_hand(boat: DrawnBoat, setup: RunSetup) -> VesselFile | None:
    """The file that half an hour of driving by hand, in the boat's weather, tells."""
    run = teleop_run(boat.true, boat.seed, HALF_AN_HOUR_S, weather=boat.weather, believed=boat.first, alone_s=ALONE_S)
    return _identified(boat, run)


def zigzags_and_circles(boat: DrawnBoat, setup: RunSetup) -> VesselFile | None:
    """The file that half an hour of zig-zags and circles tells. Flown by the true file: how to fly an unknown boat
    inside a fence is `commission`'s matter, and here a gift.
    """
    path = EXAMPLES / "excitations" / "library.toml"
    library = load_excitation(path.read_text(encoding="utf-8"), name=path.name)
    plan = replace(library, segments=tuple(s for s in library.segments if s.name in STANDARD))
    once_s = sum(signal.duration_s for signal in signals(plan, boat.true, name=path.name))
    plan = replace(plan, segments=plan.segments * round(HALF_AN_HOUR_S / once_s))
    files = {
        **setup.files,
        "vessel.toml": vessel_toml(boat.true),
        "excitation.toml": excitation_toml(plan, "zig-zags and circles"),
    }
    own = setup_of(files, {name: name for name in files})
    north_m, east_m = map(float, Pen(setup.pilot.site).middle)
    world = WorldSetup(boat.true, setup.pilot.site, start=(north_m, east_m, 0.5), weather=boat.weather)
    with tempfile.TemporaryDirectory() as folder:
        log, _ = write_logs(fly(own, world, boat.seed), own, Path(folder), BEGIN_UNIX_NS)
        return _identified(boat, read_run(log, ReadOptions(boat.first, setup.pilot.site)))


def _identified(boat: DrawnBoat, run: Run) -> VesselFile | None:
    """The vessel file that `aritra identify` writes; None: it cannot use the log."""
    try:
        found = checked([NamedLog("log", run)], (), boat.first)
        return identify(found.logs, (), found.vessel, Choices(taylor=False), lambda: DATE).identified
    except ValueError as error:
        print(f"  boat {boat.seed}: {error}")
        return None


OTHERS: Mapping[str, Callable[[DrawnBoat, RunSetup], VesselFile | None]] = {
    "by hand": by_hand,
    "zig-zags and circles": zigzags_and_circles,
}
