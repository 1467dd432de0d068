"""What a boat's model leaves out is taken for larger the harder it is driven, where the vessel file states nothing."""

import numpy as np
import pytest
from msgspec.structs import replace

from companion.core.configuration.vessel_file import ModelError
from companion.core.estimation.command_history import TimedCommand
from companion.core.estimation.filter_state import B_RANGE, LATENT, FilterState
from companion.core.estimation.gates import Gate
from companion.core.estimation.kalman import KalmanEquations
from companion.core.estimation.prediction import Predictor
from companion.core.estimation.process import Process
from companion.core.estimation.tuning import EstimatorTuning
from companion.core.model.actuators.propulsion import channels_of
from companion.core.model.manoeuvring import StructuredModel
from tests.support.vessel_fixtures import boat

DT_NS = 20_000_000
STATED = ModelError(X_sigma_N=0.8, Y_sigma_N=0.6, N_sigma_N_m=0.3, source="test")


def latent_variance(vessel, f_n) -> np.ndarray:
    """Of X, Y, N after one step of 20 ms with thrusters at f, from none; as its stationary value would be."""
    model, tuning = StructuredModel.of(vessel), EstimatorTuning(model_error=vessel.model_error)
    imu = vessel.sensors.imu
    predictor = Predictor(Process(model, (imu.x_m, imu.y_m)), model, imu, tuning, KalmanEquations(B_RANGE), ())
    belief = FilterState(
        t_ns=0, x=np.zeros(B_RANGE), P=np.zeros((B_RANGE, B_RANGE)), f_n=f_n, rates_rad_s=(0.0, 0.0, 0.0), rates_ns=0,
        anchor_gates=(), heading_gate=Gate(), position_gates=(), latest=(), imu_ns=None, position_ns=0, ranges_ns=None,
        since_ns=0,
    )  # fmt: skip
    time_s = tuning.lively_time_s if vessel.model_error else tuning.latent_time_s
    after = predictor.to(belief, DT_NS, (TimedCommand(0, f_n),))
    return np.diag(after.P)[LATENT] / (1 - np.exp(-2 * DT_NS * 1e-9 / time_s))


def test_thrusters_that_push_against_each_other_count_as_all_others():
    vessel = boat("aritra")
    B, f_n = StructuredModel.of(vessel).B, np.array([5.0, -5.0, 5.0, -5.0])
    at_rest, driven = latent_variance(vessel, np.zeros(4)), latent_variance(vessel, f_n)
    assert at_rest == pytest.approx(np.square([1.0, 1.0, 0.5]))
    assert driven - at_rest == pytest.approx(np.square(0.5 * 5.0 * np.abs(B).sum(axis=1)))
    assert latent_variance(vessel, -f_n) == pytest.approx(driven)


def test_what_the_file_states_holds_for_all_thrust():
    vessel = replace(boat("aritra"), model_error=STATED)
    for f_n in (np.zeros(4), np.full(4, 20.0)):
        assert latent_variance(vessel, f_n) == pytest.approx(np.square([0.8, 0.6, 0.3]))


def test_of_a_thruster_that_turns_nobody_relies_on_the_angle():
    vessel = boat("rudder")
    f_n = np.array([10.0 if c.unit == "N" else 0.0 for c in channels_of(vessel)])
    more = latent_variance(vessel, f_n) - latent_variance(vessel, 0 * f_n)
    assert (more > 1.0).all()
