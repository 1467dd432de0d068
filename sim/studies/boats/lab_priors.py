"""Measurements of a boat on land before it is identified, as priors: motion shows forces only relative to inertia.

    weighed   the boat on a scale; its gains are left to the data and a wide prior
    bollard   the pull of each thruster; mass and inertia are left to the data

Either fixes the common scale of force and inertia, which no log can.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from msgspec.structs import replace

from companion.core.configuration.vessel_file import VesselFile
from companion.core.model.manoeuvring import mass_matrix
from sim.fitting.engine.free_parameters import PriorSigmas
from sim.fitting.identify.structured_fit import FitSettings

WIDE_GAIN = 0.3  # sigma of a gain that nobody measured
ADDED_MASS_SHARE = 0.145
"""One sigma of added mass in surge about the file's: its 95 % interval is that of a uniform value within 30 %."""


@dataclass(frozen=True)
class LabPriors:
    """Standard deviation of each measurement, as a share; None: not measured."""

    name: str
    mass: float | None = None
    gain: float | None = None


WEIGHED = LabPriors("boat weighed to 0.5 %", mass=0.005)
"""0.2 kg of 45 kg, a bathroom scale; assumed."""
BOLLARD = LabPriors("each thruster's pull known to 2.5 %", gain=0.025)
"""A spring scale on a line; assumed."""


def measured(
    vessel: VesselFile, boat: VesselFile, lab: LabPriors, rng: np.random.Generator
) -> tuple[VesselFile, FitSettings]:
    """The vessel file that a fit of the true `boat` starts from, with the lab's noisy measurements; fit settings."""
    if lab.mass is not None:
        mass = boat.inertia.mass_kg * (1 + lab.mass * rng.normal())
        vessel = replace(vessel, inertia=replace(vessel.inertia, mass_kg=mass))
    if lab.gain is not None:
        gains = [t.gain * (1 + lab.gain * rng.normal()) for t in boat.thrusters]
        pairs = zip(vessel.thrusters, gains, strict=True)
        vessel = replace(vessel, thrusters=tuple(replace(t, gain=gain) for t, gain in pairs))
    return vessel, settings_for(vessel, lab)


def settings_for(vessel: VesselFile, lab: LabPriors) -> FitSettings:
    """Fit settings with the lab's priors: on surge inertia where the boat was weighed, on gains where these were."""
    sigmas = PriorSigmas(gain=WIDE_GAIN if lab.gain is None else lab.gain)
    if lab.mass is None:
        return FitSettings(sigmas=sigmas)
    M11, inertia = mass_matrix(vessel)[0, 0], vessel.inertia
    sigma_kg = np.hypot(lab.mass * inertia.mass_kg, ADDED_MASS_SHARE * inertia.X_udot_kg)
    return FitSettings(sigmas=sigmas, overrides={"M11_kg": (None, float(sigma_kg / M11))})
