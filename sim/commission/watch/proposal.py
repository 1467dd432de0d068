"""The proposed vessel file: the file that the watch began with, and what is believed now written into it."""

from __future__ import annotations

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.core.model.vessel_text import vessel_toml
from sim.commission.watch.mission_fit import boat_effects
from sim.fitting.diagnose.vessel_edits.edits import CauseValues
from sim.fitting.diagnose.vessel_edits.extend import refitted
from sim.fitting.diagnose.vessel_edits.public_form import public_values
from sim.fitting.diagnose.vessel_edits.public_table import LogReference


def proposed_text(vessel: VesselFile, theta: np.ndarray, note: str) -> str:
    """TOML of `vessel` with theta (B,) in it; `note`: for `source` of the tables that it changes."""
    nowhere = LogReference(np.zeros(2), 0.0)  # no watched entry has a place or time
    found = []
    for effect, value in zip(boat_effects(vessel), theta, strict=True):
        bounded = np.clip([value], *effect.limits())
        public = public_values(effect, bounded, nowhere)
        found.append(CauseValues(effect, effect.by_name(map(float, bounded)), public, note))
    return vessel_toml(refitted(vessel, found, note), f"{vessel.name}: {note}.")
