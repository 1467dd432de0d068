"""Pulse widths and volts to steady thruster forces, with the voltage as it must have been between its samples.

A pack sags at once when thrusters start; a log says so up to half a second later. From the samples,

    V = V_open - b sum |f|^1.5      power of a propeller over its thrust (momentum theory), f lagged forces [N]

b comes from the run itself: changes of V from sample to sample against changes of sum |f|^1.5.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import polars as pl
from msgspec.structs import replace

from companion.core.configuration.vessel_file import PitchMap, RotorMap, VesselFile
from companion.core.constants import NEUTRAL_US
from companion.core.model.thrusters import setting_share
from companion.logs.runs.run import Run
from sim.fitting.engine.thrust.fitted import adjustable
from sim.fitting.engine.thrust.forces import Settings, setting_rows, settings_at, thruster_forces
from sim.fitting.engine.thrust.history import Pitch, ThrustCommands, ThrustHistory

PASSES = 3  # a force depends on the voltage by less than its own share: it settles at once
AFTER_S = (0.0, 0.05, 0.12, 0.25)  # voltage is followed in such steps after a change of command: lag about 0.1 s


@dataclass(frozen=True)
class PulseSeries:
    """What a run told its thrusters: stamps (k,) [s], pulse widths (k, n), volts (k,) or None, settings by name."""

    t_s: np.ndarray
    pwm_us: np.ndarray
    volts: np.ndarray | None
    settings: Settings


def pulses_of(run: Run, vessel: VesselFile) -> PulseSeries:
    """Those of the thrusters of `vessel`."""
    t_s, pwm, volts = held_inputs(run, [t.name for t in vessel.thrusters])
    return PulseSeries(t_s, pwm, volts, settings_at(run, t_s))


def held_inputs(run: Run, thrusters: Sequence[str]) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Stamps (k,) [s], pulse widths (k, n) and voltages (k,), None without any, of the rows once all pulses are known.

    Each is in force until its next: a blank cell, as where the voltage comes once a second, takes away no command.
    Before its first sample the voltage is that one.
    """
    names = [f"pwm_{name}" for name in thrusters]
    held = run.table.select("t_s", pl.col(*names, "battery_v").forward_fill())
    held = held.with_columns(pl.col("battery_v").backward_fill()).drop_nulls(names)
    volts = held["battery_v"].to_numpy() if run.known("battery_v") else None
    return held["t_s"].to_numpy(), held.select(names).to_numpy(), volts


def commands_of(pulses: PulseSeries, vessel: VesselFile) -> ThrustCommands:
    """What pulses ask of the thrusters of `vessel`, at gains of one."""
    unit = replace(vessel, thrusters=tuple(replace(t, gain=1.0) for t in vessel.thrusters))
    rows = setting_rows(unit, pulses.settings, len(pulses.t_s))
    volts = pulses.volts
    if volts is None:
        volts = np.full(len(pulses.t_s), vessel.propulsion.nominal_voltage_V)
    kept = _changes(np.column_stack([pulses.pwm_us, volts, rows.T]))
    t_s, pwm, volts = pulses.t_s[kept], pulses.pwm_us[kept], volts[kept]
    if pulses.volts is None or not any(isinstance(m, RotorMap) for m in vessel.force_maps.values()):
        return _steady(t_s, pwm, volts, rows[:, kept], unit)
    return _with_sag(t_s, pwm, volts, unit)


def _steady(t_s: np.ndarray, pwm: np.ndarray, volts: np.ndarray, rows: np.ndarray, unit: VesselFile) -> ThrustCommands:
    """Commands without sag; `rows`: settings in the order of `unit.settings`."""
    settings = dict(zip(unit.settings, rows, strict=True))
    force = thruster_forces(unit, pwm, volts, settings)
    able = adjustable(unit)
    if not able:
        return ThrustCommands(t_s, force)
    ahead, astern = [], []
    for i in able:
        fmap = unit.force_maps[unit.thrusters[i].force_map]
        assert isinstance(fmap, PitchMap)
        share = setting_share(fmap, settings[fmap.setting])
        ahead.append(fmap.ahead_N * share)
        astern.append(fmap.astern_N * share)
    pulse = pwm[:, list(able)] - NEUTRAL_US
    return ThrustCommands(t_s, force, Pitch(able, pulse, np.stack(ahead, 1), np.stack(astern, 1)))


def _with_sag(t_s: np.ndarray, pwm: np.ndarray, volts: np.ndarray, unit: VesselFile) -> ThrustCommands:
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
        commands = ThrustCommands(t, force)
        felt = _load(ThrustHistory(commands, propulsion.dead_time_s, propulsion.lag_s).force(t_s[sampled]))
        dv, dp = np.diff(v), np.diff(felt)
        b = max(0.0, -float(dv @ dp) / max(float(dp @ dp), 1e-9))
        now = _load(ThrustHistory(commands, 0.0, propulsion.lag_s).force(middle))
        force = thruster_forces(unit, pwm[row], (v + b * felt)[sample] - b * now)
    return ThrustCommands(t, force)


def _load(force_n: np.ndarray) -> np.ndarray:
    return (np.abs(force_n) ** 1.5).sum(axis=-1)


def _changes(values: np.ndarray) -> np.ndarray:
    """Rows that differ from the one before, and the first."""
    return np.append(True, (np.diff(values, axis=0) != 0).any(axis=1))
