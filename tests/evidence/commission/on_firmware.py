"""A commissioning from end to end on the real firmware that ARDUROVER names, on our boat in lockstep."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path

import numpy as np

from sim.commission.job import NEW, OLD
from sim.world.stepped import SteppedWorld
from sim.world.world import WorldSetup
from tests.evidence.commission.boats import AS_GOOD, CROSS_TRACK
from tests.evidence.commission.one_boat import MINUTES, commissioned
from tests.evidence.line import Line, at_most, exactly, information
from tests.support.autopilots.firmware_rig import binaries, world_with

BOAT = 3


def on_firmware(full: bool) -> Iterator[Line]:
    """Commissioned on each firmware that ARDUROVER names, without GPS"""
    named = binaries()
    yield information("firmwares that ARDUROVER names", len(named))
    for binary in named:
        yield from _commissioned(binary)


def _world(binary: str, setup: WorldSetup, seed: int) -> AbstractContextManager[SteppedWorld]:
    return world_with(binary, setup, seed, gps=False)


def _commissioned(binary: Path) -> Iterator[Line]:
    one = commissioned(BOAT, worlds=partial(_world, str(binary)))
    of = f"{binary.parent.name}, boat {BOAT}"
    yield exactly(f"{of}: commissioned", one.reached, True, note="; ".join(one.said))
    yield at_most("  minutes until the file was proven", one.minutes, MINUTES, "min")
    yield at_most("  cross-track over the true file's", one.ratio(CROSS_TRACK), AS_GOOD, "x", "simulated autopilot")
    for stage, what in ((OLD, "first"), (NEW, "new")):
        own = [r.cross_track_rms_m for name, r in one.flights if name == stage and r.cross_track_rms_m is not None]
        yield information(f"  the mission on it, {what} file: cross-track", float(np.mean(own or [np.nan])), "m")
    yield information("  least room to the fence", one.room_m, "m")
    yield exactly("  thrust while out of bounds", one.outside_s, 0, "s")
