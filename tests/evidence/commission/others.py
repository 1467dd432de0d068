"""What others do with half an hour: drive by hand, or fly zig-zags and circles, and `aritra identify` of the log."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from msgspec.structs import replace

from companion.boat.load_run import RunSetup
from companion.core.configuration.vessel_file import VesselFile
from companion.core.excitation.signal import signals
from companion.logs.runs.run import Run
from sim.fitting.engine.split import NamedLog
from sim.fitting.identify.job import Choices, identify
from sim.fitting.wiring.check import checked
from sim.world.teleop_log import teleop_run
from tests.evidence.commission.draw import DrawnBoat
from tests.evidence.commission.library_flight import flown, library

HALF_AN_HOUR_S = 1800.0
ALONE_S = 1.0
"""So long the person lets each thruster push alone at first, each way."""
STANDARD = ("zig-zag", "circle to starboard", "circle to port")
DATE = "2026-01-01"


def by_hand(boat: DrawnBoat, setup: RunSetup) -> VesselFile | None:
    """The file that half an hour of driving by hand, in the boat's weather, tells."""
    run = teleop_run(boat.true, boat.seed, HALF_AN_HOUR_S, weather=boat.weather, believed=boat.first, alone_s=ALONE_S)
    return _identified(boat, run)


def zigzags_and_circles(boat: DrawnBoat, setup: RunSetup) -> VesselFile | None:
    """The file that half an hour of zig-zags and circles tells."""
    once = replace(library(), segments=tuple(s for s in library().segments if s.name in STANDARD))
    once_s = sum(signal.duration_s for signal in signals(once, boat.true, name=once.name))
    return _identified(boat, flown(boat, setup, once.segments * round(HALF_AN_HOUR_S / once_s)))


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
