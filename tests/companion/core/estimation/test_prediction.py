"""What a boat's model leaves out is taken for larger the harder it is driven; gyros drift steadily."""

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.linalg import expm

from companion.core.estimation.command_history import TimedCommand
from companion.core.estimation.filter_state import B_GYRO, B_RANGE, B_TILT, GYRO_DRIFT, LATENT, NU
from companion.core.estimation.kalman import KalmanEquations
from companion.core.estimation.prediction import Predictor
from companion.core.estimation.process import Process
from companion.core.estimation.tuning import EstimatorTuning
from companion.core.model.actuators.propulsion import channels_of
from companion.core.model.manoeuvring import StructuredModel, mass_matrix
from tests.companion.core.model.test_model_error import SURE, belief
from tests.support.vessel_fixtures import boat

DT_NS = 20_000_000


def predictor_of(vessel, tuning) -> Predictor:
    model, imu = StructuredModel.of(vessel), vessel.sensors.imu
    return Predictor(Process(model, (imu.x_m, imu.y_m)), model, imu, tuning, KalmanEquations(B_RANGE), ())


def latent_variance(vessel, f_n) -> np.ndarray:
    """Of X, Y, N after one step of 20 ms with thrusters at f, from none; as its stationary value would be."""
    tuning = EstimatorTuning(model_error=vessel.model_error)
    time_s = tuning.lively_time_s if vessel.model_error else tuning.latent_time_s
    known = replace(belief(), P=np.zeros((B_RANGE, B_RANGE)), f_n=f_n)
    after = predictor_of(vessel, tuning).to(known, DT_NS, (TimedCommand(0, f_n),))
    return np.diag(after.P)[LATENT] / (1 - np.exp(-2 * DT_NS * 1e-9 / time_s))


def test_thrusters_that_push_against_each_other_count_as_all_others():
    vessel = boat("aritra")
    B, f_n = StructuredModel.of(vessel).B, np.array([5.0, -5.0, 5.0, -5.0])
    still, driven = latent_variance(vessel, np.zeros(4)), latent_variance(vessel, f_n)
    assert still == pytest.approx(np.square([1.0, 1.0, 0.5]))
    assert driven - still == pytest.approx(np.square(0.5 * 5.0 * np.abs(B).sum(axis=1)))
    assert latent_variance(vessel, -f_n) == pytest.approx(driven)


def test_a_force_that_changes_within_a_step_moves_the_speed():
    """Covariances of force and speed after 20 ms from certainty: Van Loan's integral, of a boat at rest."""
    vessel, dt_s = boat("aritra"), DT_NS * 1e-9
    tuning = EstimatorTuning()
    known = replace(belief(), P=np.zeros((B_RANGE, B_RANGE)))
    after = predictor_of(vessel, tuning).to(known, DT_NS, (TimedCommand(0, np.zeros(4)),))
    A, q = np.zeros((6, 6)), np.zeros(6)  # [nu, d]
    A[:3, 3:] = np.linalg.inv(mass_matrix(vessel))
    A[3:, 3:] = -np.eye(3) / tuning.latent_time_s
    q[3:] = 2 * np.square(tuning.latent_sigma) / tuning.latent_time_s
    loan = expm(np.block([[-A, np.diag(q)], [np.zeros((6, 6)), A.T]]) * dt_s)
    exact = loan[6:, 6:].T @ loan[:6, 6:]
    assert np.diag(after.P[LATENT, NU]) == pytest.approx(np.diag(exact[3:, :3]), rel=0.02)
    assert np.diag(after.P[LATENT, LATENT]) == pytest.approx(np.diag(exact[3:, 3:]))


def test_what_the_file_states_holds_for_all_thrust():
    for f_n in (np.zeros(4), np.full(4, 20.0)):
        assert latent_variance(SURE, f_n) == pytest.approx(np.square([0.8, 0.6, 0.3]))


def test_of_a_thruster_that_turns_nobody_relies_on_the_angle():
    vessel = boat("rudder")
    f_n = np.array([10.0 if c.unit == "N" else 0.0 for c in channels_of(vessel)])
    more = latent_variance(vessel, f_n) - latent_variance(vessel, 0 * f_n)
    assert (more > 1.0).all()


def test_a_gyro_that_warms_up_takes_its_biases_along():
    """Over 20 s at c, with sigma s of c: the biases by 20 c, their sigma by 20 s, but for a decay of 7 % in 20 s."""
    vessel, tuning = boat("aritra"), EstimatorTuning()
    imu, c, seconds = vessel.sensors.imu, np.array([1.0, -2.0, 3.0]) * 1e-5, 20.0
    known = replace(belief(), x=np.zeros(B_RANGE), P=np.zeros((B_RANGE, B_RANGE)))
    known.x[GYRO_DRIFT] = c
    known.P[GYRO_DRIFT, GYRO_DRIFT] = tuning.gyro_drift_sigma_rad_s2**2
    after = predictor_of(vessel, tuning).to(known, round(seconds * 1e9), (TimedCommand(0, np.zeros(4)),))
    assert [*after.x[B_TILT], after.x[B_GYRO]] == pytest.approx(seconds * c, rel=0.04)
    walk = imu.gyro_bias_walk_rad_s_sqrt_s**2 * seconds
    expected = walk + (seconds * tuning.gyro_drift_sigma_rad_s2) ** 2
    assert [*np.diag(after.P)[B_TILT], after.P[B_GYRO, B_GYRO]] == pytest.approx([expected] * 3, rel=0.07)
