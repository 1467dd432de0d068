"""The autopilots at hand, each in its world: the simulated one, and the firmwares that ARDUROVER names."""

from __future__ import annotations

from contextlib import AbstractContextManager
from typing import NamedTuple

from sim.world.environment import Weather
from sim.world.sitl.board import DCM, EKF3_WITH_GPS
from sim.world.world import World, WorldSetup
from tests.evidence.main_job.parts import reference_boat
from tests.support.autopilots.firmware_rig import binaries, world_with
from tests.support.autopilots.firmware_world import FirmwareWorld
from tests.support.drive_fixture import START

READY_S = 30.0
"""The mission begins so long after the autopilot's: a real one arms after 22 s. On both, so that ranges err alike."""


class Autopilot(NamedTuple):
    """Its name in the tables; binary "": the simulated one; `board`: with SITL's board, as the firmware has it."""

    name: str
    binary: str
    gps: bool
    board: bool = False


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


def stand_ins() -> list[Autopilot]:
    """The simulated autopilot with SITL's board, without and with GPS: what a firmware's figures are compared with."""
    return [Autopilot(f"simulated, SITL's board, GPS {'on' if gps else 'off'}", "", gps, True) for gps in (False, True)]


def world_of(
    autopilot: Autopilot, seed: int, weather: Weather | None = None
) -> AbstractContextManager[World | FirmwareWorld]:
    """The reference boat with this autopilot."""
    boat = reference_boat()[0]
    board = (EKF3_WITH_GPS if autopilot.gps else DCM) if autopilot.board else None
    setup = WorldSetup(boat.vessel, boat.site, start=START, weather=weather or Weather(), board=board)
    return world_with(autopilot.binary, setup, seed, gps=autopilot.gps)
