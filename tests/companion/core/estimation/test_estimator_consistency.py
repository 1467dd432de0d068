"""Errors against the goals of the project and against the filter's own covariance, over seeds.

NEES = e^T P^-1 e over [x y psi u v r]; six degrees of freedom. Averaged over 20 runs at one instant its 95 % band
is chi2(120) / 20 = 4.58 .. 7.60; errors are correlated in time, so the mean over a run scatters more.

Where the boat is exactly the model, in still water, the filter may be too careful: it allows for the errors of a
model, and for wind. It may never be too sure.
"""

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.stats import chi2

from companion.core.estimation.estimator import Estimator
from companion.core.messages import ImuSample, Message
from tests.companion.core.estimation.changed_runs import changed
from tests.companion.core.estimation.estimator_world import Score, basin, estimate, simulate
from tests.support.vessel_fixtures import boat

LOW, HIGH = (float(chi2.ppf(q, 120)) / 20 for q in (0.025, 0.975))


def scores(seeds: range, disturbed: bool, seconds: float) -> list[Score]:
    estimator = Estimator(boat("aritra"), basin())
    return [estimate(simulate(s, disturbed=disturbed, seconds=seconds), estimator) for s in seeds]


def assert_goals(runs: list[Score]) -> None:
    """Position: 0.10 m over all runs, and 0.125 m in each."""
    assert np.sqrt(np.mean([score.rms()["position_m"] ** 2 for score in runs])) <= 0.10
    for score in runs:
        rms = score.rms()
        assert rms["position_m"] <= 0.125
        assert rms["u_m_s"] <= 0.05
        assert rms["v_m_s"] <= 0.05
        assert rms["heading_deg"] <= 2.0
        assert score.state.restarts == 0


@pytest.mark.parametrize("disturbed", [False, True])
@pytest.mark.long
def test_two_seeds_reach_the_goals_and_are_not_overconfident(disturbed: bool) -> None:
    runs = scores(range(1, 3), disturbed, 50.0)
    assert_goals(runs)
    assert np.mean([s.nees.mean() for s in runs]) < 10.0


def test_accelerometers_that_are_noisier_than_the_file_says_make_the_estimate_less_sure_not_wrong() -> None:
    """0.8 m/s^2 instead of 0.05, from 15 s on, seed 4. Believed as in the file: 2.4 m, 1.6 m/s wrong."""
    dice = np.random.default_rng(4)

    def noisy(m: Message) -> Message:
        if not isinstance(m, ImuSample) or m.t_ns < 15e9:
            return m
        x, y = dice.normal(0, 0.8, 2)
        return replace(m, ax_m_s2=m.ax_m_s2 + x, ay_m_s2=m.ay_m_s2 + y)

    run = changed(simulate(4, disturbed=True, seconds=45.0), noisy)
    score = estimate(run, Estimator(boat("aritra"), basin()))
    rms = score.rms()
    assert rms["position_m"] < 0.2 and rms["u_m_s"] < 0.1 and rms["v_m_s"] < 0.1
    assert score.nees.mean() < 12.0


@pytest.mark.long
@pytest.mark.matrix
@pytest.mark.parametrize("disturbed", [False, True])
def test_twenty_seeds_reach_the_goals_and_are_consistent(disturbed: bool) -> None:
    runs = scores(range(1, 21), disturbed, 150.0)
    assert_goals(runs)
    over_runs = np.mean([s.nees for s in runs], axis=0)
    assert (LOW if disturbed else 0.6 * 6) <= over_runs.mean() <= HIGH
    assert np.mean(over_runs <= HIGH) >= 0.95
