"""What a fit may leave free besides hull and thrusters, how far each parameter may be off beforehand, and its unit."""

from __future__ import annotations

from dataclasses import dataclass

from companion.core.configuration.vessel_file import VesselFile
from companion.core.model.effects.term import LoadParameter
from companion.core.model.loads import REGISTRY, values

HARD_IRON: tuple[str, ...] = ("hard_iron_cos_rad", "hard_iron_sin_rad")
IMU = ("imu_x_m", "imu_y_m", *HARD_IRON)
SURROUNDINGS = tuple(
    (term, LoadParameter(f"{term}_{way}_m_s", "m/s", start, -most, most, what))
    for term, start, most, what in (("current", 0.01, 2.0, "flows towards"), ("wind", 0.5, 25.0, "comes from"))
    for way in ("north", "east")
)
"""Current and wind of the day, by their components; defaults: where a fit begins (at 0 a wind has no slope)."""
PROPULSION = "propulsion"
ADVANCE_LOSS = LoadParameter("advance_loss_s_m", "s/m", 0.0, -5.0, 5.0, "share of the thrust lost per m/s")
"""Of the table `propulsion`, as if that were a term: fitted where the file states one."""


def fitted_terms(vessel: VesselFile, surroundings: bool = False) -> tuple[tuple[str, LoadParameter], ...]:
    """Name of the term and parameter, for every parameter of the vessel's terms that a fit estimates; the advance loss
    of its propulsion, too.
    """
    own = tuple((name, p) for name in vessel.terms for p in REGISTRY[name].parameters if p.fitted)
    return own + ((PROPULSION, ADVANCE_LOSS),) * bool(vessel.propulsion.advance_loss_s_m) + SURROUNDINGS * surroundings


def stated(vessel: VesselFile, name: str, p: LoadParameter) -> float:
    """The vessel file's value of one of its `fitted_terms`."""
    if name == PROPULSION:
        return vessel.propulsion.advance_loss_s_m
    return values(name, vessel.terms[name])[p.name]


@dataclass(frozen=True)
class PriorSigmas:
    """Standard deviation of each prior of w; of the logarithm, a share, where the quantity is positive. All assumed.

    `gain`: single T200 and ESCs differ by a few per cent from the manufacturer's table. This prior alone sets the scale
    of forces in newtons: motion shows forces only relative to inertia.
    """

    hull: float = 0.5
    coupling: float = 0.3
    gain: float = 0.025
    dead_time: float = 0.5
    lag: float = 0.5
    latency_s: float = 0.05
    arm_m: float = 0.03
    trim_us: float = 50.0
    azimuth_deg: float = 15.0
    curve: float = 0.3
    astern: float = 0.2
    term: float = 1.0
    current_m_s: float = 0.15
    wind_m_s: float = 4.0
    hard_iron_rad: float = 0.1


UNITS = {
    "_N_s2_m2": "N s2/m2",
    "_N_s2": "N s2",
    "_N_s2_m": "N s2/m",
    "_N_m_s2": "N m s2",
    "_N_m_s": "N m s",
    "_N_s_m": "N s/m",
    "_kg_m2": "kg m2",
    "_kg_m": "kg m",
    "_N_s": "N s",
    "_s_m": "s/m",
    "_kg": "kg",
    "_rad": "rad",
    "_us": "us",
    "_m_s": "m/s",
    "_deg": "deg",
    "_s": "s",
    "_m": "m",
}
"""Ending of a name -> unit. An ending stands before every shorter one that it ends in: the first match counts."""


def unit_of(name: str) -> str:
    """Unit of a parameter, from its name; gains and warps have none.

    >>> unit_of("Y_vv_N_s2_m2"), unit_of("gain_bow")
    ('N s2/m2', '1')
    """
    if name.startswith(("gain_", "warp_", "curve_", "astern_")):
        return "1"
    return next(unit for end, unit in UNITS.items() if name.endswith(end))
