"""The autopilots at hand, each in its world: the simulated one, and the firmwares that ARDUROVER names."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import NamedTuple

from sim.world.environment import Weather
from sim.world.stepped import SteppedWorld
from sim.world.world import World, WorldSetup
from tests.evidence.main_job.parts import reference_boat
from tests.support.autopilots.firmware_rig import binaries, firmware_world

START = 8.0, 8.0, math.radians(20)
READY_S = 30.0
"""The mission begins so long after the autopilot's: a real one arms after 22 s. On both, so that ranges err alike."""


class Autopilot(NamedTuple):
    """Its name in the tables; binary "": the simulated one, which has no GPS to switch on."""

    name: str
    binary: str
    gps: bool


def autopilots() -> list[Autopilot]:
    """Every one that is at hand, each firmware without GPS and with it."""
    real = [
        Autopilot(f"{path.parent.name}, GPS {'on' if gps else 'off'}", str(path), gps)
        for path in binaries()
        for gps in (False, True)
    ]
    if not real:
        print("  (ARDUROVER names no firmware: the simulated autopilot alone)")
    return [Autopilot("simulated", "", False), *real]


@contextmanager
def world_of(autopilot: Autopilot, seed: int, weather: Weather | None = None) -> Iterator[SteppedWorld]:
    """The reference boat with this autopilot."""
    boat = reference_boat()[0]
    setup = WorldSetup(boat.vessel, boat.site, start=START, weather=weather or Weather())
    if not autopilot.binary:
        yield World(setup, seed)
        return
    with (
        tempfile.TemporaryDirectory() as folder,
        closing(firmware_world(Path(autopilot.binary), Path(folder), setup, seed, gps=autopilot.gps)) as world,
    ):
        yield world
