"""From a run to regression samples (nu, nu_dot, forces), by the paper's pipeline or by the smoother.

    paper     kinematic Kalman filter at 10 Hz, no biases -> Lanczos low-pass of u, v, r -> 7-point differences
    smoother  RTS smoother with biases; its accelerations are taken as they are

Forces: the pulse widths in force at each instant through the vessel file's map and B, in kgf. As in the paper they act
at once: dead time and lag of the thrusters are not modelled.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.core.constants import NEUTRAL_US
from companion.core.geometry.frames import R2, point_acceleration
from companion.logs.runs.on_time import on_time
from companion.logs.runs.run import Run
from sim.fitting.engine.smoothing import RATE_HZ, Smoothed, SmootherNoise, binned
from sim.fitting.engine.thrust.battery import held_inputs
from sim.fitting.engine.thrust.forces import body_forces, settings_at
from sim.fitting.taylor.abkowitz import KGF_N
from sim.fitting.taylor.differences import derivative
from sim.fitting.taylor.kinematic_filter import KinematicData, KinematicNoise, kinematic_filter
from sim.fitting.taylor.lanczos import CUTOFF_HZ, HALF_WIDTH_S, lanczos_filter
from sim.fitting.taylor.regression import Samples


@dataclass(frozen=True)
class PaperMotion:
    """Motion by the paper's pipeline at k instants, SI units.

    eta, nu_raw  (k, 3) of the Kalman filter
    nu           (k, 3) after the Lanczos filter
    nu_dot       (k, 3) by differences of nu
    """

    t_s: np.ndarray
    eta: np.ndarray
    nu_raw: np.ndarray
    nu: np.ndarray
    nu_dot: np.ndarray


def paper_motion(
    run: Run, noise: SmootherNoise, cutoff_hz: float = CUTOFF_HZ, half_width_s: float = HALF_WIDTH_S
) -> PaperMotion:
    """The paper's three steps. Lever arms and latency are removed first (the paper does not mention them)."""
    data, kept = _kinematic_data(run, noise)
    per_sample = KinematicNoise(noise.accel_m_s2 / math.sqrt(kept), 0.0, 0.0, noise.position_m)
    estimate = kinematic_filter(data, per_sample)
    nu = lanczos_filter(estimate.nu, RATE_HZ, cutoff_hz, half_width_s)
    return PaperMotion(data.t_s, estimate.eta, estimate.nu, nu, derivative(nu, 1 / RATE_HZ))


def paper_samples(run: Run, vessel: VesselFile, noise: SmootherNoise) -> Samples:
    """Regression samples of a run by the paper's pipeline."""
    motion = paper_motion(run, noise)
    return Samples(motion.nu, motion.nu_dot, forces_kgf(run, vessel, motion.t_s), RATE_HZ)


def smoother_samples(run: Run, vessel: VesselFile, smoothed: Smoothed) -> Samples:
    """Regression samples of a run from its smoothed motion, whose grid must be uniform."""
    rate_hz = 1.0 / float(np.median(np.diff(smoothed.t_s)))
    return Samples(smoothed.nu, smoothed.nu_dot, forces_kgf(run, vessel, smoothed.t_s), rate_hz)


def held_commands(run: Run, t_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pulse widths (k, n) [us] and voltages (k,) [V] in force at `t_s` (k,): zero-order hold.

    Before the first stamp: neutral, and the first voltage. NaN volts where the run has none.
    """
    stamps, pwm, volts = held_inputs(run, run.thrusters)
    if volts is None or not len(volts):
        volts = np.full(max(len(stamps), 1), np.nan)
    after = np.searchsorted(stamps, t_s + 1e-9, side="right")
    pwm = np.vstack([np.full((1, pwm.shape[1]), float(NEUTRAL_US)), pwm])
    return pwm[after], volts[np.maximum(after - 1, 0)]


def forces_kgf(run: Run, vessel: VesselFile, t_s: np.ndarray) -> np.ndarray:
    """t = [t_x t_y t_n] in force at `t_s` (k,), (k, 3) [kgf, kgf, kgf m].

    ValueError where run and vessel have other thrusters.
    """
    names = tuple(t.name for t in vessel.thrusters)
    if run.thrusters != names:
        raise ValueError(f"{run.meta.source}: thrusters {run.thrusters}, but {vessel.name} has {names}")
    pwm, volts = held_commands(run, t_s)
    volts = np.where(np.isnan(volts), vessel.propulsion.nominal_voltage_V, volts)
    return body_forces(vessel, pwm, volts, settings_at(run, t_s)) / KGF_N


def _kinematic_data(run: Run, noise: SmootherNoise) -> tuple[KinematicData, float]:
    """The run on the filter's grid, referred to the body origin; and the median number of IMU samples per instant."""
    t, run = run.measured_s(), on_time(run)
    grid = t[0] + np.arange(int((t[-1] - t[0]) * RATE_HZ + 1e-9) + 1) / RATE_HZ
    t_psi, psi = run.samples("psi_rad")
    heading = np.interp(grid, t_psi, np.unwrap(psi))
    t_r, r = run.samples("r_rad_s")
    rate, at = binned(t_r, r, grid), np.arange(len(grid))
    yaw_rate = np.interp(at, at[rate.count > 0], rate.z[rate.count > 0, 0])
    force = binned(*run.samples("ax_m_s2", "ay_m_s2"), grid)
    r_dot = np.gradient(lanczos_filter(yaw_rate, RATE_HZ), grid)
    arm = np.column_stack(point_acceleration((0.0, 0.0, yaw_rate), (0.0, 0.0, r_dot), noise.imu_arm_m))
    known = force.count > 0
    accel = np.column_stack([np.interp(at, at[known], column) for column in force.z[known].T]) - arm
    t_p, tag = run.samples("north_m", "east_m")
    t_p = t_p - noise.latency_s
    tag = tag - np.einsum("kij,j->ki", R2(np.interp(t_p, grid, heading)), noise.tag_arm_m)
    place = binned(t_p, tag, grid)
    position = np.where(place.count[:, None] > 0, place.z, np.nan)
    return KinematicData(grid, heading, yaw_rate, accel, position), max(float(np.median(force.count)), 1.0)
