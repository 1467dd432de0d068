"""Pulse widths, battery voltage and settings to steady thruster and body forces, for whole logs at once."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import casadi as ca
import numpy as np

from companion.core.thrusters import NEUTRAL_US, SPAN_US, configuration_matrix, force_expression
from companion.core.vessel_file import ForceMap, PitchMap, Thruster, VesselFile
from sim.identify.run import Run

Settings = Mapping[str, np.ndarray]
"""By name: what was set at each instant, NaN where unknown."""


@lru_cache(maxsize=64)
def _force_function(
    thrusters: tuple[Thruster, ...], maps: tuple[tuple[str, ForceMap], ...], names: tuple[str, ...], count: int
) -> ca.Function:
    """(pwm_us (n,), voltage_v, settings in the order of `names`) -> f (n,), for `count` instants."""
    pwm, volts, values = ca.SX.sym("pwm", len(thrusters)), ca.SX.sym("V"), ca.SX.sym("settings", len(names))
    force_maps, forces = dict(maps), []
    for i, thruster in enumerate(thrusters):
        fmap = force_maps[thruster.force_map]
        setting = values[names.index(fmap.setting)] if isinstance(fmap, PitchMap) else None
        forces.append(force_expression(thruster, fmap, pwm[i], volts, setting))
    return ca.Function("forces", [pwm, volts, values], [ca.vertcat(*forces)]).map(count)


def settings_at(run: Run, t_s: np.ndarray) -> dict[str, np.ndarray]:
    """What each setting of a run was at `t_s`, same shape; before its first stamp: that first value."""
    found = {}
    for column in (c for c in run.table.columns if c.startswith("setting_") and run.known(c)):
        stamps, values = run.samples(column)
        found[column.removeprefix("setting_")] = values[
            np.maximum(np.searchsorted(stamps, t_s + 1e-9, side="right") - 1, 0)
        ]
    return found


def setting_rows(vessel: VesselFile, settings: Settings, count: int) -> np.ndarray:
    """Settings that the maps of `vessel` need, (names, count); nominal where unknown."""
    rows = [np.broadcast_to(settings.get(name, np.nan), count) for name in vessel.settings]
    nominal = np.array(list(vessel.settings.values()))[:, None]
    stacked = np.array(rows, dtype=float).reshape(len(nominal), count)
    return np.where(np.isnan(stacked), nominal, stacked)


def thruster_forces(
    vessel: VesselFile, pwm_us: np.ndarray, battery_v: np.ndarray, settings: Settings | None = None
) -> np.ndarray:
    """Bollard forces [N], shape (k, n), from pulse widths (k, n), volts (k,) and settings, each (k,); no dead time, no

    lag. Settings that are not given have their nominal values.
    """
    trim = np.array([t.trim_us for t in vessel.thrusters])
    clipped = np.clip(np.asarray(pwm_us, dtype=float) - trim, NEUTRAL_US - SPAN_US, NEUTRAL_US + SPAN_US) + trim
    volts, rows = np.asarray(battery_v, dtype=float)[None, :], setting_rows(vessel, settings or {}, len(clipped))
    maps, names = tuple(vessel.force_maps.items()), tuple(vessel.settings)
    columns = _force_function(tuple(vessel.thrusters), maps, names, len(clipped))(clipped.T, volts, rows)
    return np.asarray(columns).T


def body_forces(
    vessel: VesselFile, pwm_us: np.ndarray, battery_v: np.ndarray, settings: Settings | None = None
) -> np.ndarray:
    """tau = B f, shape (k, 3) [N, N, N m], as `thruster_forces`."""
    return thruster_forces(vessel, pwm_us, battery_v, settings) @ configuration_matrix(vessel).T
