"""Pulse widths, battery voltage and settings to steady thruster and body forces, for whole logs at once."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from companion.core.configuration.vessel_file import PitchMap, VesselFile
from companion.core.model.thrusters import configuration_matrix, forces_from_pwm
from companion.logs.runs.run import Run

Settings = Mapping[str, np.ndarray]
"""By name: what was set at each instant, NaN where unknown."""


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
    pwm, volts = np.asarray(pwm_us, dtype=float), np.asarray(battery_v, dtype=float)
    rows = dict(zip(vessel.settings, setting_rows(vessel, settings or {}, len(pwm)), strict=True))
    columns = []
    for thruster, own in zip(vessel.thrusters, pwm.T, strict=True):
        fmap = vessel.force_maps[thruster.force_map]
        setting = rows[fmap.setting] if isinstance(fmap, PitchMap) else None
        columns.append(forces_from_pwm(thruster, fmap, own, volts, setting))
    return np.stack(columns, axis=1)


def body_forces(
    vessel: VesselFile, pwm_us: np.ndarray, battery_v: np.ndarray, settings: Settings | None = None
) -> np.ndarray:
    """tau = B f, shape (k, 3) [N, N, N m], as `thruster_forces`."""
    return thruster_forces(vessel, pwm_us, battery_v, settings) @ configuration_matrix(vessel).T
