"""Units of the fit's parameters, read from the end of their names."""

from __future__ import annotations

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
