"""Whether fitted inertia is that of a boat of the file's mass and length: what no hull can have is said, not believed.

    0.9 m <= M11 <= 2 m,   0.9 m <= M22 <= 5 m,   0.1 L <= sqrt(M33 / m) <= L

m: mass of the file, L: length. Added mass in surge is 5 to 20 % of a slender hull's mass, in sway 0.5 to 2 times
(Fossen 2021, chapter 6); the bounds leave room for hulls that are not slender and masses that were guessed: assumed.
"""

from __future__ import annotations

from collections.abc import Iterator

from companion.core.configuration.vessel_file import VesselFile
from sim.fitting.identify.result import FitResult

SURGE, SWAY = (0.9, 2.0), (0.9, 5.0)
GYRATION = (0.1, 1.0)


def implausible(vessel: VesselFile, result: FitResult) -> Iterator[str]:
    """Sentences on inertias outside their bounds."""
    m, L = vessel.inertia.mass_kg, vessel.hull.length_m
    bounds = {
        "M11_kg": tuple(share * m for share in SURGE),
        "M22_kg": tuple(share * m for share in SWAY),
        "M33_kg_m2": tuple(m * (share * L) ** 2 for share in GYRATION),
    }
    for name, (low, high) in bounds.items():
        value = result[name].value
        if not low <= value <= high:
            yield (
                f"{name} = {value:.4g} is not that of a boat of {m:g} kg and {L:g} m ({low:.3g} to {high:.3g}): the "
                "logs hold too little of this motion, signs or sides are wrong, or the mass in the vessel file is."
            )
