"""Battery voltage between its samples: it sags at once when thrusters start, a log says so half a second later.

    V = V_open - b sum |F|^1.5      power of a propeller over its thrust (momentum theory), F steady forces [N]

b comes from the run itself: changes of V from sample to sample against changes of sum |F|^1.5.
"""

from __future__ import annotations

import numpy as np

from companion.core.vessel_file import RotorMap, VesselFile
from sim.identify.forces import thruster_forces
from sim.identify.run import Run

PASSES = 3  # force depends on voltage by a third of a per cent per per cent: it settles at once
RISE_S = 0.2  # from command to full force: dead time and lag, about (facts: 0.1 s each)


def steady_forces(run: Run, vessel: VesselFile) -> tuple[np.ndarray, np.ndarray]:
    """Stamps (c,) at which pulse widths or open voltage changed, and steady forces (c, n) from then on [N].

    `vessel` should have gains of one. Forces include the sag that they themselves cause.
    """
    names = [f"pwm_{t.name}" for t in vessel.thrusters]
    known = run.known("battery_v")
    t_s, values = run.samples(*names, *(["battery_v"] if known else []))
    if not known:
        values = np.column_stack([values, np.full(len(t_s), vessel.propulsion.nominal_voltage_V)])
    changed = np.append(True, (np.diff(values, axis=0) != 0).any(axis=1))
    t, pwm, v = t_s[changed], values[changed, :-1], values[changed, -1]
    force = thruster_forces(vessel, pwm, v)
    if not any(isinstance(m, RotorMap) for m in vessel.force_maps.values()):
        return t, force
    fresh = np.append(True, np.diff(v) != 0)
    sample = np.maximum.accumulate(np.where(fresh, np.arange(len(v)), 0))  # row of the sample in force
    at_sample = np.maximum(np.searchsorted(t, t - RISE_S, side="right") - 1, 0)  # commands that a sample feels
    for _ in range(PASSES):
        load = (np.abs(force) ** 1.5).sum(axis=1)
        felt = load[at_sample]
        dv, dp = np.diff(v[fresh]), np.diff(felt[fresh])
        b = max(0.0, -float(dv @ dp) / max(float(dp @ dp), 1e-9))
        force = thruster_forces(vessel, pwm, (v + b * felt)[sample] - b * load)
    return t, force
