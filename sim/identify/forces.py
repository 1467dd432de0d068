"""Pulse widths and battery voltage to steady thruster and body forces, for whole logs at once."""

from __future__ import annotations

import casadi as ca
import numpy as np

from companion.core.thrusters import NEUTRAL_US, SPAN_US, configuration_matrix, force_expression
from companion.core.vessel_file import VesselFile


def _force_function(vessel: VesselFile) -> ca.Function:
    """(pwm_us (n,), voltage_v) -> f (n,)."""
    pwm, volts = ca.SX.sym("pwm", len(vessel.thrusters)), ca.SX.sym("V")
    forces = [
        force_expression(thruster, vessel.force_maps[thruster.force_map], pwm[i], volts)
        for i, thruster in enumerate(vessel.thrusters)
    ]
    return ca.Function("forces", [pwm, volts], [ca.vertcat(*forces)])


def thruster_forces(vessel: VesselFile, pwm_us: np.ndarray, battery_v: np.ndarray) -> np.ndarray:
    """Bollard forces [N], shape (k, n), from pulse widths (k, n) and volts (k,); no dead time, no lag."""
    trim = np.array([t.trim_us for t in vessel.thrusters])
    clipped = np.clip(np.asarray(pwm_us, dtype=float) - trim, NEUTRAL_US - SPAN_US, NEUTRAL_US + SPAN_US) + trim
    columns = _force_function(vessel).map(len(clipped))(clipped.T, np.asarray(battery_v, dtype=float)[None, :])
    return np.asarray(columns).T


def body_forces(vessel: VesselFile, pwm_us: np.ndarray, battery_v: np.ndarray) -> np.ndarray:
    """tau = B f, shape (k, 3) [N, N, N m], as `thruster_forces`."""
    return thruster_forces(vessel, pwm_us, battery_v) @ configuration_matrix(vessel).T
