"""Constants that every room shares, and what follows from one."""

GRAVITY_M_S2 = 9.80665
"""Standard gravity (CGPM 1901): one g of an accelerometer, one kgf over one kg."""
NEUTRAL_US = 1500
"""Pulse width [us] at which a thruster stands still: the middle of ArduPilot's RC and servo outputs."""
PACK_SHARES = (0.5, 1.5)
"""Voltages outside these shares of the nominal one are no pack's (0 V: no battery monitor); assumed."""
WATER_KG_M3 = 1025.0
"""Density of sea water (Fossen 2021)."""


def pack_range(nominal_v: float) -> tuple[float, float]:
    """Least and most voltage [V] that a pack of this nominal voltage can have."""
    least, most = PACK_SHARES
    return least * nominal_v, most * nominal_v
