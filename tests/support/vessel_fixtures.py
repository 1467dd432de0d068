"""Vessel files of deploy/boats, loaded for tests."""

from functools import cache
from pathlib import Path

from companion.core.configuration.vessel_file import VesselFile
from companion.core.model.load_vessel import load_vessel

BOATS = Path(__file__).resolve().parents[2] / "deploy" / "boats"


@cache
def boat(name: str) -> VesselFile:
    path = BOATS / f"{name}.toml"
    return load_vessel(path.read_text(), name=path.name)
