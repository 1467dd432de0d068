"""The size of the latent force follows the innovations: white ones leave it, a wave's raise it, and it comes back."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.core.estimation.latent_activity import (
    CALM,
    MOST,
    SPREAD,
    STEADY_S,
    UNKNOWN,
    AxisActivity,
    LatentMeans,
    log_variances,
    update_activity,
    update_means,
)

DT_S = 0.02


def after(z, activity=CALM):
    for value in z:
        activity = update_activity(activity, (1,), (value,), DT_S)
    return activity


@pytest.mark.parametrize("seed", range(5))
def test_white_innovations_of_the_predicted_size_leave_the_model_s_own_error(seed):
    levels, activity = [], CALM
    for value in np.random.default_rng(seed).normal(size=3000):
        activity = update_activity(activity, (1,), (value,), DT_S)
        levels.append(activity[1].log_variance)
    assert np.median(levels) < 0.5 and np.mean(levels) < 1.0


def test_a_wave_that_is_smaller_than_the_noise_raises_it_within_a_second():
    noise = np.random.default_rng(1).normal(size=50)
    wave = 0.9 * np.sin(2.5 * DT_S * np.arange(50) + 0.8)
    assert after(noise + wave)[1].log_variance > 3.0
    assert after(noise)[1].log_variance < 1.0


def test_it_comes_back_within_half_a_minute_and_other_axes_stay():
    lively = after([3.0] * 50)
    assert lively[1].log_variance == MOST and lively[0] == lively[2] == CALM[0]
    calm = after(np.random.default_rng(2).normal(size=1500), lively)
    assert calm[1].log_variance < 1.0


@given(st.tuples(*[st.floats(0.0, MOST)] * 3))
def test_no_axis_is_calm_amid_waves_and_all_are_in_calm_water(levels):
    counted = log_variances(tuple(AxisActivity(log_variance=a) for a in levels))
    assert all(c >= a for c, a in zip(counted, levels, strict=True)) and max(counted) == max(levels)
    assert max(counted) - min(counted) <= SPREAD + 1e-9


def test_one_outlier_is_no_wave():
    assert after([0.0] * 50 + [1000.0])[1].log_variance < 2.0


def test_no_time_no_change():
    assert update_activity(UNKNOWN, (0, 1), (9.0, 9.0), 0.0) is UNKNOWN


@given(st.lists(st.tuples(st.floats(-1e6, 1e6), st.floats(1e-6, 100.0)), max_size=40))
def test_it_stays_within_its_bounds(samples):
    activity = CALM
    for z, dt_s in samples:
        activity = update_activity(activity, (0, 1, 2), (z, -z, 0.0), dt_s)
    for axis in activity:
        assert 0.0 <= axis.log_variance <= MOST and np.isfinite(axis.mean)


@pytest.mark.parametrize("dt_s", [0.01, 0.1])
def test_a_controller_plans_against_what_stays_and_monitors_see_a_push_at_once_in_calm_water(dt_s):
    means = LatentMeans()
    for _ in range(round(STEADY_S[0] / dt_s)):
        means = update_means(means, (4.0, -2.0, 1.0), (0.0, 0.0, 0.0), dt_s)
        assert means.lasting == (4.0, -2.0, 1.0)
    part = 1 - np.exp(-1)
    assert means.steady == pytest.approx((4.0 * part, -2.0 * part, 1.0))


def test_in_waves_both_are_means():
    means = LatentMeans()
    for k in range(1000):
        push = 30.0 * np.sin(2.5 * k * DT_S)
        means = update_means(means, (5.0 + push, push, 0.1 * push), (MOST, MOST, MOST), DT_S)
    assert means.lasting == pytest.approx((5.0, 0.0, 0.0), abs=3.0)
    assert means.steady == pytest.approx((5.0, 0.0, 0.0), abs=3.0)
