"""Pulse widths and volts to steady thruster forces, with the voltage as it must have been between its samples.

A pack sags at once when thrusters start; a log says so up to half a second later. From the samples,

    V = V_open - b sum |f|^1.5      power of a propeller over its thrust (momentum theory), f lagged forces [N]

b comes from the run itself: changes of V from sample to sample against changes of sum |f|^1.5.
"""

from __future__ import annotations

import numpy as np
from msgspec.structs import replace

from companion.core.thrusters import NEUTRAL_US, setting_share
from companion.core.vessel_file import PitchMap, RotorMap, VesselFile
from sim.identify.forces import setting_rows, settings_at, thruster_forces
from sim.identify.run import Run
from sim.identify.structured.parameters import adjustable
from sim.identify.structured.thrust import Commands, Pitch, ThrustHistory

PASSES = 3  # a force depends on the voltage by less than its own share: it settles at once
AFTER_S = (0.0, 0.05, 0.12, 0.25)  # voltage is followed in such steps after a change of command: lag about 0.1 s


def commands_of(run: Run, vessel: VesselFile) -> Commands:
    """What a run asks of the thrusters of `vessel`, at gains of one."""
    unit = replace(vessel, thrusters=tuple(replace(t, gain=1.0) for t in vessel.thrusters))
    names = [f"pwm_{t.name}" for t in vessel.thrusters]
    if not run.known("battery_v"):
        t_s, pwm = run.samples(*names)
        pwm = pwm.reshape(len(t_s), -1)
        rows = setting_rows(unit, settings_at(run, t_s), len(t_s))
        kept = _changes(np.column_stack([pwm, rows.T]))
        volts = np.full(int(kept.sum()), vessel.propulsion.nominal_voltage_V)
        return _steady(t_s[kept], pwm[kept], volts, rows[:, kept], unit)
    t_s, values = run.samples(*names, "battery_v")
    rows = setting_rows(unit, settings_at(run, t_s), len(t_s))
    kept = _changes(np.column_stack([values, rows.T]))
    t_s, pwm, volts = t_s[kept], values[kept, :-1], values[kept, -1]
    if not any(isinstance(m, RotorMap) for m in vessel.force_maps.values()):
        return _steady(t_s, pwm, volts, rows[:, kept], unit)
    return _with_sag(t_s, pwm, volts, unit)


def _steady(t_s: np.ndarray, pwm: np.ndarray, volts: np.ndarray, rows: np.ndarray, unit: VesselFile) -> Commands:
    """Commands without sag; `rows`: settings in the order of `unit.settings`."""
    settings = dict(zip(unit.settings, rows, strict=True))
    force = thruster_forces(unit, pwm, volts, settings)
    able = adjustable(unit)
    if not able:
        return Commands(t_s, force)
    ahead, astern = [], []
    for i in able:
        fmap = unit.force_maps[unit.thrusters[i].force_map]
        assert isinstance(fmap, PitchMap)
        share = setting_share(fmap, settings[fmap.setting])
        ahead.append(fmap.ahead_N * share)
        astern.append(fmap.astern_N * share)
    pulse = pwm[:, list(able)] - NEUTRAL_US
    return Commands(t_s, force, Pitch(able, pulse, np.stack(ahead, 1), np.stack(astern, 1)))


def _with_sag(t_s: np.ndarray, pwm: np.ndarray, volts: np.ndarray, unit: VesselFile) -> Commands:
    """Commands whose voltage follows the load between the samples of `volts`."""
    sampled = _changes(volts[:, None])
    t = np.unique(np.concatenate([t_s + after for after in AFTER_S]))
    row = np.searchsorted(t_s, t, side="right") - 1
    sample = np.searchsorted(t_s[sampled], t, side="right") - 1
    v = volts[sampled]
    middle = t + np.append(np.diff(t), AFTER_S[-1]) / 2
    force = thruster_forces(unit, pwm[row], volts[row])
    propulsion = unit.propulsion
    for _ in range(PASSES):
        commands = Commands(t, force)
        felt = _load(ThrustHistory(commands, propulsion.dead_time_s, propulsion.lag_s).force(t_s[sampled]))
        dv, dp = np.diff(v), np.diff(felt)
        b = max(0.0, -float(dv @ dp) / max(float(dp @ dp), 1e-9))
        now = _load(ThrustHistory(commands, 0.0, propulsion.lag_s).force(middle))
        force = thruster_forces(unit, pwm[row], (v + b * felt)[sample] - b * now)
    return Commands(t, force)


def _load(force_n: np.ndarray) -> np.ndarray:
    return (np.abs(force_n) ** 1.5).sum(axis=-1)


def _changes(values: np.ndarray) -> np.ndarray:
    """Rows that differ from the one before, and the first."""
    return np.append(True, (np.diff(values, axis=0) != 0).any(axis=1))
