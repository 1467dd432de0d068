"""The time update of the filter: vessel model, thruster lag, process noise.

latent force, heading wander: first-order Gauss-Markov, d' = d exp(-dt / T), stationary sigma
the latent force's variance, a its activity, |B| |f| the thrusters' force with signs left out:
    sigma_rest^2 + (share |B| |f|)^2 + (e^a - 1) sigma_lively^2,      e^a sigma^2 where the vessel file states sigma
biases: random walk, those of the gyro with a drift: b' = c + w, c Gauss-Markov; roll and pitch: `tilt`
errors of the other sensors: as their `Sensor.error_states` say
u v r: white acceleration on top of the latent force
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from msgspec.structs import replace

from companion.core.configuration.sensors import Imu
from companion.core.estimation.command_history import TimedCommand, active_command
from companion.core.estimation.filter_state import (
    B_ACCEL,
    B_GYRO_XYZ,
    B_PSI,
    B_RANGE,
    DYNAMIC,
    GYRO_DRIFT,
    LATENT,
    NU,
    SPEED,
    TILT,
    FilterState,
)
from companion.core.estimation.kalman import KalmanEquations
from companion.core.estimation.latent_activity import log_variances, update_means
from companion.core.estimation.model_confidence import is_in_doubt
from companion.core.estimation.process import Process, at_rest
from companion.core.estimation.tilt import advance_tilt
from companion.core.estimation.tuning import EstimatorTuning
from companion.core.model.integrate import VesselModel
from companion.core.model.thrust_lag import lagged
from companion.core.sensors.sensor import ErrorState

Noise = Callable[[float], tuple[np.ndarray, np.ndarray]]


def noise_model(imu: Imu, tuning: EstimatorTuning, errors: Sequence[ErrorState], *, wary: bool = False) -> Noise:
    """Function dt -> (decay, q): factor per state over dt and process noise variances, both (20 + k,).

    `wary`: with the latent force of `wary_latent_sigma`, once innovations contradict the file's `model_error`.
    """
    n = B_RANGE + len(errors)
    time_s = np.full(n, np.inf)
    time_s[LATENT] = tuning.lively_time_s if tuning.model_error else tuning.latent_time_s
    time_s[B_PSI], time_s[GYRO_DRIFT] = imu.heading_wander_time_s, tuning.gyro_drift_time_s
    stationary, walk = np.zeros(n), np.zeros(n)
    stationary[LATENT] = tuning.wary_latent_sigma if wary else tuning.latent_sigma
    stationary[B_PSI], stationary[GYRO_DRIFT] = imu.heading_wander_sigma_rad, tuning.gyro_drift_sigma_rad_s2
    walk[NU] = [tuning.accel_walk_m_s2_sqrt_s] * 2 + [tuning.yaw_walk_rad_s2_sqrt_s]
    walk[B_ACCEL] = imu.accel_bias_walk_m_s2_sqrt_s
    walk[B_GYRO_XYZ] = imu.gyro_bias_walk_rad_s_sqrt_s
    walk[TILT] = imu.gyro_sigma_rad_s / np.sqrt(imu.rate_Hz)
    for i, error in enumerate(errors, B_RANGE):
        time_s[i], stationary[i], walk[i] = error.time_s, error.stationary, error.walk

    def noise(dt_s: float) -> tuple[np.ndarray, np.ndarray]:
        decay = np.exp(-dt_s / time_s)
        return decay, stationary**2 * (1 - decay**2) + walk**2 * dt_s

    return noise


class Predictor:
    """Constant parts of the time update; `to` is pure."""

    def __init__(
        self,
        process: Process,
        model: VesselModel,
        imu: Imu,
        tuning: EstimatorTuning,
        algebra: KalmanEquations,
        errors: Sequence[ErrorState],
    ):
        self._process, self._lag_s, self._slew_N_s = process, model.lag_s, model.slew_N_s
        self._tuning, self._algebra = tuning, algebra
        self._identity = np.eye(B_RANGE + len(errors))
        self._lively_variance = np.square(tuning.lively_sigma)
        actuators = model.actuators
        self._directions = np.abs(actuators.directions if actuators else model.B)
        self._thrusts = actuators.thrust_places if actuators else slice(None)
        self._noise, self._wary = (noise_model(imu, tuning, errors, wary=w) for w in (False, True))

    def to(self, belief: FilterState, t_ns: int, commands: tuple[TimedCommand, ...]) -> FilterState:
        """Belief at t_ns; an earlier t_ns leaves it as it is. Steps end where a command takes over."""
        while belief.t_ns < t_ns:
            command_n, until_ns = active_command(commands, belief.t_ns)
            end_ns = min(t_ns, until_ns or t_ns)
            steps = math.ceil((end_ns - belief.t_ns) * 1e-9 / self._tuning.max_step_s)
            belief = self._step(belief, belief.t_ns + (end_ns - belief.t_ns) // steps, command_n)
        return belief

    def _step(self, belief: FilterState, t_ns: int, command_n: np.ndarray) -> FilterState:
        """One step of constant command and mean force."""
        dt_s = (t_ns - belief.t_ns) * 1e-9
        f_n, mean_n = lagged(belief.f_n, command_n, dt_s, self._lag_s, self._slew_N_s)
        decay, q = (self._wary if is_in_doubt(belief, self._tuning) else self._noise)(dt_s)
        levels = log_variances(belief.activity)
        if self._tuning.model_error:
            q[LATENT] *= np.exp(levels)
        else:
            q[LATENT] += self._of_thrust(mean_n) * (1 - decay[LATENT] ** 2)
            q[LATENT] += self._of_activity(levels) * -math.expm1(-2 * dt_s / self._tuning.lively_time_s)
        drive = self._process.drive(mean_n)
        x = belief.x * decay
        F = self._identity * decay
        x[DYNAMIC], F[DYNAMIC, DYNAMIC] = self._process.step(belief.x[DYNAMIC], drive, dt_s)
        if belief.is_settling(self._tuning.settle_most_s):
            F[SPEED, SPEED] = self._process.step(at_rest(belief.x[DYNAMIC]), drive, dt_s)[1][SPEED, SPEED]
        x[B_GYRO_XYZ] += dt_s * belief.x[GYRO_DRIFT]
        F[B_GYRO_XYZ, GYRO_DRIFT] = dt_s
        x[LATENT] *= decay[LATENT]
        F[LATENT, LATENT] *= decay[LATENT]
        seen = belief.t_ns - belief.rates_ns <= self._tuning.rates_hold_s * 1e9
        advance_tilt(x, F, belief.x, _rates(belief, t_ns) if seen else (0.0, 0.0), dt_s)
        if not seen:
            q[TILT] += self._tuning.unseen_tilt_rad_sqrt_s**2 * dt_s
        # Half of the noise comes before the step, grown by what decays: a force that changes within it moves the speed.
        P = self._algebra.predict(belief.P + self._identity * (q / 2 / decay**2), x, F, self._identity * (q / 2))
        means = update_means(belief.latent_means, x[LATENT].tolist(), levels, dt_s)
        return replace(belief, t_ns=t_ns, x=x, P=P, f_n=f_n, latent_means=means)

    def _of_thrust(self, f_n: np.ndarray) -> np.ndarray:
        """(share |B| |f|)^2, shape (3,), of thruster forces f; of thrusters that turn, in any direction."""
        return np.square(self._tuning.thrust_share * (self._directions @ np.abs(f_n[self._thrusts])))

    def _of_activity(self, levels: Sequence[float]) -> np.ndarray:
        """(e^a - 1) sigma_lively^2, shape (3,); `levels`: a by axis, `log_variances`."""
        return np.expm1(levels) * self._lively_variance


def _rates(belief: FilterState, t_ns: int) -> tuple[float, float]:
    """Roll and pitch rate in the middle of a step that ends at t [rad/s], by the last ones and their slopes."""
    ahead_s = ((belief.t_ns + t_ns) / 2 - belief.rates_ns) * 1e-9
    (p, q, _), (p_dot, q_dot, _) = belief.rates_rad_s, belief.slopes_rad_s2
    return p + ahead_s * p_dot, q + ahead_s * q_dot
