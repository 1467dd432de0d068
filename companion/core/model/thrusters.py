"""PWM <-> force of one thruster at a voltage, and the configuration matrix B.

Rotor (facts: the manufacturer's bollard table follows F = k n |n| with k nearly free of voltage):

    c = (pwm - trim - 1500) / 400                     command in -1..1; `mirrored`: with the other sign
    e = max(|c| - dead_band / 400, 0)
    n = (V / V_ref)^(a0 + a1 e) (c1 e^q + c2 e^2)     [rev/s], sign of c
    F = gain k n |n|                                  [N], k and the curve by sign; astern times astern_share

Pitch (a propeller at a set speed s, its blades turned by the command; momentum of the stream goes with speed squared):

    F = gain (s / s_nominal)^exponent c (1 - curve + curve |c|) ahead_N           astern_N for c < 0

It rises with c as long as |curve| < 1.

Gains may be 0 (a dead thruster) or negative (one that is wired or turned the wrong way round).

The curve rises without a step, so it has one inverse; the table's own five small steps back are smoothed.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial
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


Side = Callable[[Any, Any], Any]
"""(number ahead, number astern) -> the one of the direction in which the thruster pushes."""


def force_size(fmap: ForceMap, c: Any, voltage_v: Any, side: Side) -> Any:
    """Size of the force [N] at command size c = |command| in 0..1: the map's equation above, at a gain of one.

    Numbers, arrays and CasADi expressions alike; a setting is the nominal one.
    """
    if isinstance(fmap, PitchMap):
        c = c * (1 - fmap.curve + fmap.curve * c)
    if isinstance(fmap, PitchMap):
        return c * side(fmap.ahead_N, fmap.astern_N)
    share = side(1.0, 1.0 if fmap.astern_share is None else fmap.astern_share)
    if isinstance(fmap, LinearMap):
        return share * c * side(fmap.ahead_N, fmap.astern_N)
    dead = fmap.dead_band_us / SPAN_US
    e = np.maximum(c - dead, 0.0) if isinstance(c, float | np.ndarray) else ca.fmax(c - dead, 0.0)
    rps = rotor_rps(side(fmap.ahead, fmap.astern), e, voltage_v, fmap.V_ref_V)
    return share * side(fmap.k_ahead_N_s2, fmap.k_astern_N_s2) * rps**2


def _command(thruster: Thruster, pwm_us: Any) -> Any:
    """c above, not clipped, of a pulse width [us]: numbers, arrays and CasADi expressions alike."""
    beyond_us = pwm_us - thruster.trim_us - NEUTRAL_US
    return (-beyond_us if thruster.mirrored else beyond_us) / SPAN_US


def _ahead(ahead: Any, _: Any) -> Any:
    return ahead


def _astern(_: Any, astern: Any) -> Any:
    return astern


def force_from_pwm(
    thruster: Thruster, fmap: ForceMap, pwm_us: float, voltage_v: float, setting: float | None = None
) -> float:
    """Steady bollard force [N] at a pulse width [us], battery voltage [V] and setting (None: the nominal one)."""
    c = min(max(float(_command(thruster, pwm_us)), -1.0), 1.0)
    sign, side = (1, _ahead) if c >= 0 else (-1, _astern)
    share = thruster.gain * setting_share(fmap, setting)
    return sign * float(share * force_size(fmap, abs(c), voltage_v, side))


def forces_from_pwm(
    thruster: Thruster, fmap: ForceMap, pwm_us: np.ndarray, voltage_v: np.ndarray, setting: np.ndarray | None = None
) -> np.ndarray:
    """`force_from_pwm` of whole logs: pulse widths, voltages and settings (k,), forces (k,); NaN at no real voltage."""
    c = np.clip(_command(thruster, pwm_us), -1.0, 1.0)
    dead = fmap.dead_band_us / SPAN_US if isinstance(fmap, RotorMap) else 0.0
    force = 0.0 * c  # in the dead band at any voltage, and also at one that is not known
    with np.errstate(invalid="ignore"):
        for sign, side, where in ((1, _ahead, c > dead), (-1, _astern, c < -dead)):
            force[where] = sign * force_size(fmap, np.abs(c[where]), voltage_v[where], side)
    return thruster.gain * setting_share(fmap, setting) * force


def steady_forces(vessel: VesselFile, pwm_us: Any, voltage_v: Any) -> list[Any]:
    """`force_from_pwm` of all thrusters as CasADi expressions, for simulation; settings are the nominal ones.

    The curve is chosen by sign before it is evaluated, which halves the powers; it has no slope at 0.
    """
    return [
        steady_force(t, vessel.force_maps[t.force_map], pwm_us[i], voltage_v) for i, t in enumerate(vessel.thrusters)
    ]


def steady_force(thruster: Thruster, fmap: ForceMap, pwm_us: Any, voltage_v: Any) -> Any:
    """`force_from_pwm` as a CasADi expression."""
    c = ca.fmax(ca.fmin(_command(thruster, pwm_us), 1.0), -1.0)
    force = force_size(fmap, ca.fabs(c), voltage_v, partial(_by_sign, c >= 0))
    return ca.if_else(c >= 0, 1.0, -1.0) * (thruster.gain * force)


def _by_sign(is_ahead: Any, ahead: Any, astern: Any) -> Any:
    """A number or a curve's numbers by the sign of a CasADi expression."""
    if isinstance(ahead, RotorCurve):
        both = ((name, getattr(ahead, name), getattr(astern, name)) for name in RotorCurve.__struct_fields__)
        return RotorCurve(**{name: _by_sign(is_ahead, one, other) for name, one, other in both})
    return ahead if ahead == astern else ca.if_else(is_ahead, ahead, astern)


@lru_cache(maxsize=256)
def _inverse_table(fmap: ForceMap, voltage_dv: int, sign: int) -> np.ndarray:
    """Force sizes [N] over `_GRID` at a voltage given in tenths of a volt."""
    return np.asarray(force_size(fmap, _GRID, voltage_dv / 10.0, _ahead if sign > 0 else _astern))


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
    ahead = -1 if thruster.mirrored else 1
    return int(np.clip(round(neutral + ahead * sign * c * SPAN_US), thruster.pwm_min_us, thruster.pwm_max_us))


def force_limits(vessel: VesselFile) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper force of each thruster [N], shapes (n,), that may be asked for.

    The file's limits are what the map reaches at a gain of 1. A thruster that gives less can be asked for less, a dead
    one for nothing; one that is the wrong way round reaches astern what the map reaches ahead.
    """
    lower, upper = (np.array(side) for side in zip(*map(force_reach, vessel.thrusters), strict=True))
    return lower, upper


def force_reach(t: Thruster) -> tuple[float, float]:
    """Lower and upper force of one thruster [N], as in `force_limits`."""
    share = min(max(t.gain, -1.0), 1.0)
    lower, upper = sorted((share * t.force_min_N, share * t.force_max_N))
    return lower + 0.0, upper + 0.0  # + 0.0: no negative zero


def configuration_matrix(vessel: VesselFile) -> np.ndarray:
    """B, shape (3, n): tau = B f with rows X [N], Y [N], N [N m]; N = x sin(a) - y cos(a).

    Columns of servos, which follow those of the thrusters, are 0: B is that of centred servos.
    """
    x, y, a = vessel.positions.T
    B = np.vstack([np.cos(a), np.sin(a), x * np.sin(a) - y * np.cos(a)])
    return np.hstack([B, np.zeros((3, len(vessel.servos)))])
