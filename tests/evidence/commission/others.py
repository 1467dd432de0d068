"""What others do with half an hour: drive by hand, or zig-zags and circles, and `aritra identify` of the log.

Both in the same wide basin, with the same sensors, in the boat's weather, by the first file.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.core.excitation.file import Steps, Zigzag
from companion.core.excitation.signal import axis_reach, signal
from sim.fitting.engine.split import NamedLog
from sim.fitting.identify.job import Choices, identify
from sim.fitting.wiring.check import checked
from sim.world.teleop_log import HomingPilot, KeyboardPilot, teleop_run
from tests.evidence.commission.draw import DrawnBoat
from tests.evidence.commission.library_flight import library

HALF_AN_HOUR_S = 1800.0
ALONE_S = 1.0
"""So long the person lets each thruster push alone at first, each way."""
RUDDER = 2.5
"""Times the yaw moment of the library's: that does not turn a boat both ways whose gains the first file has wrong."""
STANDARD = ("zig-zag", "circle to starboard", "circle to port")
DATE = "2026-01-01"


class ZigzagPilot(HomingPilot):
    """Zig-zag, circle to starboard, circle to port, as the library has them, again and again."""

    def __init__(self, believed: VesselFile):
        super().__init__()
        limits = axis_reach(believed)[:, 0]
        self._turns = []
        for s in library().segments:
            if s.name in STANDARD and isinstance(s, Zigzag | Steps):
                level = s.levels[0] if isinstance(s, Steps) else 1.0
                tau = np.array([s.X, 0.0, RUDDER * s.N]) * limits * level
                self._turns.append((tau, signal(s, believed, where=s.name)))
        self._from_s, self._from_rad, self._side = 0.0, 0.0, 1.0

    def wanted(self, t_s: float, x: np.ndarray, anew: bool) -> np.ndarray:
        """The rudder of a zig-zag is laid over as the heading has turned by its angle; a circle keeps it."""
        tau, given = self._turns[0]
        turned = math.remainder(x[2] - self._from_rad, 2 * math.pi)
        if given.switch_rad is not None and self._side * turned > given.switch_rad:
            self._side = -self._side
        if t_s - self._from_s >= given.duration_s:
            self._turns.append(self._turns.pop(0))
            self._from_s, self._from_rad, self._side = t_s, x[2], 1.0
        return tau * np.array([1.0, 1.0, self._side])


def by_hand(boat: DrawnBoat) -> VesselFile | None:
    """The file that half an hour of driving by hand tells."""
    return _identified(boat, KeyboardPilot)


def zigzags_and_circles(boat: DrawnBoat) -> VesselFile | None:
    """The file that half an hour of zig-zags and circles tells."""
    return _identified(boat, lambda _rng: ZigzagPilot(boat.first))


def _identified(boat: DrawnBoat, pilot: Callable[[np.random.Generator], HomingPilot]) -> VesselFile | None:
    """The vessel file that `aritra identify` writes after half an hour of a pilot; None: it cannot use the log."""
    run = teleop_run(boat.true, boat.seed, HALF_AN_HOUR_S, weather=boat.weather, pilot=pilot, believed=boat.first,
                     alone_s=ALONE_S)  # fmt: skip
    try:
        found = checked([NamedLog("log", run)], (), boat.first)
        return identify(found.logs, (), found.vessel, Choices(taylor=False), lambda: DATE).identified
    except ValueError as error:
        print(f"  boat {boat.seed}: {error}")
        return None


OTHERS: Mapping[str, Callable[[DrawnBoat], VesselFile | None]] = {
    "driving by hand": by_hand,
    "zig-zags and circles": zigzags_and_circles,
}
