"""A vessel file that says how far its model may be trusted. Seeds stated; worlds of `estimator_world`."""

import numpy as np
import pytest
from msgspec.structs import replace

from companion.core.configuration.tables import ConfigError
from companion.core.configuration.vessel_file import ModelError
from companion.core.estimation.estimator import Estimator
from companion.core.estimation.filter_state import B_RANGE, LATENT, FilterState
from companion.core.estimation.gates import Gate
from companion.core.estimation.model_confidence import is_in_doubt, update_confidence
from companion.core.estimation.prediction import noise_model
from companion.core.estimation.tuning import EstimatorTuning
from companion.core.messages import Innovation
from companion.core.model.load_vessel import load_vessel
from companion.core.model.vessel_text import vessel_toml
from tests.companion.core.estimation.estimator_world import basin, estimate, simulate
from tests.support.vessel_fixtures import boat

BASE = boat("aritra")
SURE = replace(BASE, model_error=ModelError(X_sigma_N=0.8, Y_sigma_N=0.6, N_sigma_N_m=0.3, source="test"))


def test_without_it_the_filter_goes_by_its_own_tuning():
    assert Estimator(BASE, basin()).tuning.latent_sigma == (1.0, 1.0, 0.5)
    assert Estimator(SURE, basin()).tuning.latent_sigma == (0.8, 0.6, 0.3)


@pytest.mark.parametrize("dt_s", [0.02, 1.0])
def test_the_latent_force_settles_at_what_is_stated(dt_s):
    decay, q = noise_model(SURE.sensors.imu, Estimator(SURE, basin()).tuning, ())(dt_s)
    assert q[LATENT] / (1 - decay[LATENT] ** 2) == pytest.approx(np.square([0.8, 0.6, 0.3]))


def test_it_survives_being_written_and_must_be_positive():
    text = vessel_toml(SURE)
    assert load_vessel(text, name="x") == SURE
    with pytest.raises(ConfigError, match=r"model_error\.X_sigma_N"):
        load_vessel(text.replace("X_sigma_N = 0.8", "X_sigma_N = 0.0"), name="x")


@pytest.mark.long
def test_an_exact_model_that_is_trusted_estimates_better_and_is_consistent():
    """Seeds 13 and 14; the filter's noise is tuned for models that are off, so that NEES is below 6."""
    nees = []
    for run in (simulate(seed, disturbed=False, seconds=60.0) for seed in (13, 14)):
        plain, sure = (estimate(run, Estimator(v, basin())) for v in (BASE, SURE))
        rms = [np.sqrt((s.error**2).mean(axis=0)) for s in (plain, sure)]
        assert (rms[1][3:5] < [0.6 * rms[0][3], 0.35 * rms[0][4]]).all()  # observed: 0.49, 0.56 and 0.30, 0.33
        assert sure.state.history[-1].belief.doubt < 10.0
        nees.append(sure.nees.mean())
    assert 3.0 < np.mean(nees) < 7.5


@pytest.mark.long
def test_trust_that_the_day_does_not_bear_out_ends():
    """Current, wind and a boat off by 10 %, of which the file says nothing: errors of 0.15 m, until the ranges tell."""
    run = simulate(12, disturbed=True, seconds=100.0)
    plain, sure = (estimate(run, Estimator(v, basin())) for v in (BASE, SURE))
    late = len(sure.error) // 2
    assert is_in_doubt(sure.state.history[-1].belief, EstimatorTuning(model_error=SURE.model_error))
    ratio = [np.sqrt((s.error[late:, :2] ** 2).sum(axis=1).mean()) for s in (plain, sure)]
    assert ratio[1] < 1.2 * ratio[0]
    assert plain.state.history[-1].belief.doubt == 0.0


def innovation(d2: float) -> Innovation:
    return Innovation(t_ns=0, sensor="range 1", innovation=(d2**0.5,), S=(1.0,), d2=d2, accepted=True)


def belief() -> FilterState:
    n = B_RANGE
    return FilterState(
        t_ns=0, x=np.zeros(n), P=np.eye(n), f_n=np.zeros(4), rates_rad_s=(0.0, 0.0, 0.0), rates_ns=0, anchor_gates=(),
        heading_gate=Gate(), position_gates=(), latest=(), imu_ns=None, position_ns=0, ranges_ns=None, since_ns=0,
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(5))
def test_doubt_does_not_come_by_chance_and_comes_of_errors_half_as_large_again(seed):
    """Half an hour at four ranges a second; then d2 with a mean of 2.25."""
    tuning, rng = EstimatorTuning(model_error=SURE.model_error), np.random.default_rng(seed)
    calm = update_confidence(belief(), map(innovation, rng.normal(size=7200) ** 2), tuning)
    assert not is_in_doubt(calm, tuning) and np.array_equal(calm.P, np.eye(B_RANGE))
    off = update_confidence(calm, map(innovation, 2.25 * rng.normal(size=400) ** 2), tuning)
    assert is_in_doubt(off, tuning)
    assert np.diag(off.P)[LATENT] == pytest.approx(1 + np.square([3.0, 3.0, 1.5]))


def test_wild_ranges_count_no_more_than_three_sigma_and_plain_files_are_never_in_doubt():
    tuning = EstimatorTuning(model_error=SURE.model_error)
    assert update_confidence(belief(), [innovation(1e6)] * 5, tuning).doubt == pytest.approx(5 * 7.5)
    assert update_confidence(belief(), [innovation(9.0)] * 500, EstimatorTuning()).doubt == 0.0


def test_where_the_file_says_more_than_the_tuning_doubt_changes_nothing():
    much = ModelError(X_sigma_N=9.0, Y_sigma_N=1.0, N_sigma_N_m=0.3, source="test")
    assert EstimatorTuning(model_error=much).wary_latent_sigma == (9.0, 3.0, 1.5)
