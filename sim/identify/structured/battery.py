"""Pulse widths and volts to steady thruster forces, with the voltage as it must have been between its samples.

A pack sags at once when thrusters start; a log says so up to half a second later. From the samples,

    V = V_open - b sum |f|^1.5      power of a propeller over its thrust (momentum theory), f lagged forces [N]

b comes from the run itself: changes of V from sample to sample against changes of sum |f|^1.5.
"""

from __future__ import annotations

import numpy as np
from msgspec.structs import replace

from companion.core.vessel_file import RotorMap, VesselFile
from sim.identify.forces import thruster_forces
from sim.identify.run import Run
from sim.identify.structured.thrust import Commands, ThrustHistory

PASSES = 3  # a force depends on the voltage by less than its own share: it settles at once
AFTER_S = (0.0, 0.05, 0.12, 0.25)  # voltage is followed in such steps after a change of command: lag about 0.1 s


def commands_of(run: Run, vessel: VesselFile) -> Commands:
    """What a run asks of the thrusters of `vessel`, at gains of one."""
    unit = replace(vessel, thrusters=tuple(replace(t, gain=1.0) for t in vessel.thrusters))
    names = [f"pwm_{t.name}" for t in vessel.thrusters]
    if not run.known("battery_v"):
        t_s, pwm = run.samples(*names)
        pwm = pwm.reshape(len(t_s), -1)
        kept = _changes(pwm)
        volts = np.full(int(kept.sum()), vessel.propulsion.nominal_voltage_V)
        return Commands(t_s[kept], thruster_forces(unit, pwm[kept], volts))
    t_s, values = run.samples(*names, "battery_v")
    kept = _changes(values)
    t_s, pwm, volts = t_s[kept], values[kept, :-1], values[kept, -1]
    if not any(isinstance(m, RotorMap) for m in vessel.force_maps.values()):
        return Commands(t_s, thruster_forces(unit, pwm, volts))
    return _with_sag(t_s, pwm, volts, unit)


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
        felt = _load(ThrustHistory(commands, propulsion.dead_time_s, propulsion.lag_s).at(t_s[sampled])[0])
        dv, dp = np.diff(v), np.diff(felt)
        b = max(0.0, -float(dv @ dp) / max(float(dp @ dp), 1e-9))
        now = _load(ThrustHistory(commands, 0.0, propulsion.lag_s).at(middle)[0])
        force = thruster_forces(unit, pwm[row], (v + b * felt)[sample] - b * now)
    return Commands(t, force)


def _load(force_n: np.ndarray) -> np.ndarray:
    return (np.abs(force_n) ** 1.5).sum(axis=-1)


def _changes(values: np.ndarray) -> np.ndarray:
    """Rows that differ from the one before, and the first."""
    return np.append(True, (np.diff(values, axis=0) != 0).any(axis=1))
