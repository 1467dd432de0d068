"""The real firmware that ARDUROVER names, on our boat in lockstep: ARDUROVER=path[:path], desktop builds of Rover.

Everything is in simulated time: a busy machine makes it slow and nothing else.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path

from sim.world.world import World, WorldSetup
from tests.support.autopilots.firmware_world import FirmwareSetup, FirmwareWorld

ARDUPILOT = Path(__file__).resolve().parents[3] / "deploy" / "ardupilot"
BASIN = {"GPS1_TYPE": 0.0, "COMPASS_DEC": -0.0213}
"""No GPS, as under a roof; the declination at the origin of deploy/sites/basin.toml [rad], which nobody else tells then
(pymavlink.mavextra.expected_earth_field_lat_lon)."""


def binaries() -> list[Path]:
    """The firmwares that are named; raises ValueError for one that is not there."""
    paths = [Path(name) for name in os.environ.get("ARDUROVER", "").split(os.pathsep) if name]
    for path in paths:
        if not os.access(path, os.X_OK):
            raise ValueError(f"ARDUROVER names {path}, which is no program")
    return paths


def firmware_world(
    binary: Path,
    folder: Path,
    setup: WorldSetup,
    seed: int,
    *,
    gps: bool,
    wiring: str = "gate",
    parameters: Mapping[str, float] | None = None,
) -> FirmwareWorld:
    """The boat with this firmware and wiring in an empty folder."""
    more = {**({} if gps else BASIN), **(parameters or {})}
    files, scripts = [ARDUPILOT / f"{wiring}.param"], [ARDUPILOT / "gate.lua"] if wiring == "gate" else []
    return FirmwareWorld(setup, seed, FirmwareSetup(binary, folder, files, more, scripts))


@contextmanager
def world_with(
    binary: str,
    setup: WorldSetup,
    seed: int,
    *,
    gps: bool,
    wiring: str = "gate",
    parameters: Mapping[str, float] | None = None,
) -> Iterator[World | FirmwareWorld]:
    """The boat with this firmware in a folder of its own; binary "": with the simulated autopilot, as `setup` says."""
    if not binary:
        yield World(setup, seed)
        return
    with (
        tempfile.TemporaryDirectory() as folder,
        closing(
            firmware_world(Path(binary), Path(folder), setup, seed, gps=gps, wiring=wiring, parameters=parameters)
        ) as world,
    ):
        yield world
