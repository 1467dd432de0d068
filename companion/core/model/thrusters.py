"""PWM <-> force of one thruster at a voltage, and the configuration matrix B.

Rotor (facts: the manufacturer's bollard table follows F = k n |n| with k nearly free of voltage):

    c = (pwm - trim - 1500) / 400                     command in -1..1
    e = max(|c| - dead_band / 400, 0)
    n = (V / V_ref)^(a0 + a1 e) (c1 e^q + c2 e^2)     [rev/s], sign of c
    F = gain k n |n|                                  [N], k and the curve by sign

Pitch (a propeller at a set speed s, its blades turned by the command; momentum of the stream goes with speed squared):

    F = gain (s / s_nominal)^exponent c (1 - curve + curve |c|) ahead_N           astern_N for c < 0

It rises with c as long as |curve| < 1.

Gains may be nil (a dead thruster) or negative (one that is wired or turned the wrong way round).

The curve rises without a step, so it has one inverse; the table's own five small steps back are smoothed.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from companion.core.configuration.vessel_file import (
    ForceMap,
    LinearMap,
    PitchMap,
    RotorCurve,
    RotorMap,
    Thruster,
    VesselFile,
)
from companion.core.constants import NEUTRAL_US

SPAN_US = 400.0
_GRID = np.linspace(0.0, 1.0, 2001)  # command grid of the inverse, 0.2 us apart


def rotor_rps(curve: RotorCurve, e: Any, voltage_v: Any, v_ref_v: float) -> Any:
    """Speed n [rev/s] >= 0 over the command e >= 0 beyond the dead band; numpy or CasADi."""
    shape = curve.c1_rps * e**curve.q + curve.c2_rps * e**2
    return (voltage_v / v_ref_v) ** (curve.a0 + curve.a1 * e) * shape


def setting_share(fmap: ForceMap, setting: Any) -> Any:
    """Force at a setting over force at the nominal one; 1 where `setting` is None or the map knows none.

    >>> from companion.core.configuration.vessel_file import PitchMap
    >>> setting_share(PitchMap(setting="speed", nominal_setting=0.4, ahead_N=1, astern_N=1, source="example"), 0.2)
    0.25
    """
    if setting is None or not isinstance(fmap, PitchMap):
        return 1.0
    return (setting / fmap.nominal_setting) ** fmap.exponent


def _force_ahead(fmap: ForceMap, c: Any, voltage_v: Any, sign: int) -> Any:
    """Size of the force [N] at command size c in 0..1, ahead (sign 1) or astern (-1)."""
    if isinstance(fmap, PitchMap):
        c = c * (1 - fmap.curve + fmap.curve * c)
    if isinstance(fmap, LinearMap | PitchMap):
        return c * (fmap.ahead_N if sign > 0 else fmap.astern_N)
    e = np.maximum(c - fmap.dead_band_us / SPAN_US, 0.0)
    curve, k = (fmap.ahead, fmap.k_ahead_N_s2) if sign > 0 else (fmap.astern, fmap.k_astern_N_s2)
    return k * rotor_rps(curve, e, voltage_v, fmap.V_ref_V) ** 2


def force_from_pwm(
    thruster: Thruster, fmap: ForceMap, pwm_us: float, voltage_v: float, setting: float | None = None
) -> float:
    """Steady bollard force [N] at a pulse width [us], battery voltage [V] and setting (None: the nominal one)."""
    c = min(max(float(pwm_us - thruster.trim_us - NEUTRAL_US) / SPAN_US, -1.0), 1.0)
    sign = 1 if c >= 0 else -1
    share = thruster.gain * setting_share(fmap, setting)
    return sign * float(share * _force_ahead(fmap, abs(c), voltage_v, sign))


def forces_from_pwm(
    thruster: Thruster, fmap: ForceMap, pwm_us: np.ndarray, voltage_v: np.ndarray, setting: np.ndarray | None = None
) -> np.ndarray:
    """`force_from_pwm` of whole logs: pulse widths, voltages and settings (k,), forces (k,); NaN at no real voltage."""
    c = np.clip((pwm_us - thruster.trim_us - NEUTRAL_US) / SPAN_US, -1.0, 1.0)
    dead = fmap.dead_band_us / SPAN_US if isinstance(fmap, RotorMap) else 0.0
    force = 0.0 * c  # in the dead band at any voltage, and also at one that is not known
    with np.errstate(invalid="ignore"):
        for sign, side in ((1, c > dead), (-1, c < -dead)):
            force[side] = sign * _force_ahead(fmap, np.abs(c[side]), voltage_v[side], sign)
    return thruster.gain * setting_share(fmap, setting) * force


def force_expression(thruster: Thruster, fmap: ForceMap, pwm_us: Any, voltage_v: Any, setting: Any = None) -> Any:
    """`force_from_pwm` as a CasADi expression, for fits. Smooth but at the dead band's edge."""
    c = (pwm_us - thruster.trim_us - NEUTRAL_US) / SPAN_US
    if isinstance(fmap, PitchMap):
        c = c * (1 - fmap.curve + fmap.curve * ca.fabs(c))
    if isinstance(fmap, LinearMap | PitchMap):
        share = thruster.gain * setting_share(fmap, setting)
        return share * c * ca.if_else(c >= 0, fmap.ahead_N, fmap.astern_N)
    e = ca.fmax(ca.fabs(c) - fmap.dead_band_us / SPAN_US, 0.0)
    safe = ca.fmax(e, 1e-9)
    ahead = fmap.k_ahead_N_s2 * rotor_rps(fmap.ahead, safe, voltage_v, fmap.V_ref_V) ** 2
    astern = -fmap.k_astern_N_s2 * rotor_rps(fmap.astern, safe, voltage_v, fmap.V_ref_V) ** 2
    return ca.if_else(e > 0, thruster.gain * ca.if_else(c >= 0, ahead, astern), 0.0)


def steady_forces(vessel: VesselFile, pwm_us: Any, voltage_v: Any) -> list[Any]:
    """`force_from_pwm` of all thrusters as CasADi expressions, for simulation; settings are the nominal ones.

    The curve is chosen by sign before it is evaluated: half the powers of `force_expression`, but no slope at 0.
    """
    maps = [vessel.force_maps[t.force_map] for t in vessel.thrusters]
    return [
        _steady_force(t, fmap, pwm_us[i], voltage_v)
        for i, (t, fmap) in enumerate(zip(vessel.thrusters, maps, strict=True))
    ]


def _steady_force(thruster: Thruster, fmap: ForceMap, pwm_us: Any, voltage_v: Any) -> Any:
    c = ca.fmax(ca.fmin((pwm_us - thruster.trim_us - NEUTRAL_US) / SPAN_US, 1.0), -1.0)
    size, ahead = ca.fabs(c), c >= 0
    if isinstance(fmap, PitchMap):
        size = size * (1 - fmap.curve + fmap.curve * size)
    if isinstance(fmap, LinearMap | PitchMap):
        force = size * _by_sign(ahead, fmap.ahead_N, fmap.astern_N)
    else:
        e = ca.fmax(size - fmap.dead_band_us / SPAN_US, 0.0)
        names = RotorCurve.__struct_fields__
        numbers: dict[str, Any] = {
            name: _by_sign(ahead, getattr(fmap.ahead, name), getattr(fmap.astern, name)) for name in names
        }
        rps = rotor_rps(RotorCurve(**numbers), e, voltage_v, fmap.V_ref_V)
        force = _by_sign(ahead, fmap.k_ahead_N_s2, fmap.k_astern_N_s2) * rps**2
    return ca.if_else(ahead, 1.0, -1.0) * (thruster.gain * force)


def _by_sign(ahead: Any, yes: float, no: float) -> Any:
    return yes if yes == no else ca.if_else(ahead, yes, no)


@lru_cache(maxsize=256)
def _inverse_table(fmap: ForceMap, voltage_dv: int, sign: int) -> np.ndarray:
    """Force sizes [N] over `_GRID` at a voltage given in tenths of a volt."""
    return np.asarray(_force_ahead(fmap, _GRID, voltage_dv / 10.0, sign))


def pwm_from_force(thruster: Thruster, fmap: ForceMap, force_n: float, voltage_v: float) -> int:
    """Pulse width [us] for a force [N], clamped to the thruster's limits and rounded; 0 N is neutral.

    The voltage is taken to 0.1 V, a setting is the nominal one. A force beyond what the map reaches gives the limit.
    """
    neutral = NEUTRAL_US + thruster.trim_us
    if force_n == 0.0 or thruster.gain == 0.0:
        return neutral
    sign = 1 if (force_n > 0) == (thruster.gain > 0) else -1
    table = _inverse_table(fmap, round(voltage_v * 10), sign) * abs(thruster.gain)
    first = int(np.searchsorted(table, 0.0, side="right")) - 1  # the dead band's edge
    c = float(np.interp(abs(force_n), table[first:], _GRID[first:]))
    return int(np.clip(round(neutral + sign * c * SPAN_US), thruster.pwm_min_us, thruster.pwm_max_us))


def force_limits(vessel: VesselFile) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper force of each thruster [N], shapes (n,), that may be asked for.

    The file's limits are what the map reaches at a gain of 1. A thruster that gives less can be asked for less, a dead
    one for nothing; one that is the wrong way round reaches astern what the map reaches ahead.
    """
    limits = []
    for t in vessel.thrusters:
        share = min(max(t.gain, -1.0), 1.0)
        limits.append(sorted((share * t.force_min_N, share * t.force_max_N)))
    lower, upper = (np.array(side) + 0.0 for side in zip(*limits, strict=True))  # + 0.0: no negative zero
    return lower, upper


def configuration_matrix(vessel: VesselFile) -> np.ndarray:
    """B, shape (3, n): tau = B f with rows X [N], Y [N], N [N m]; N = x sin(a) - y cos(a)."""
    x, y, a = vessel.positions.T
    return np.vstack([np.cos(a), np.sin(a), x * np.sin(a) - y * np.cos(a)])
