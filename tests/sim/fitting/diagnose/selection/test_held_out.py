"""Smoothing of held-out logs by models that are near, and by one that is far off; how sure a short one is."""

import numpy as np
import pytest

from sim.fitting.diagnose.posterior.noise import stated_noise
from sim.fitting.diagnose.selection.held_out import CHANNELS, LEAST_BLOCKS, MODELS, open_loop_errors, score
from sim.fitting.diagnose.selection.smoothed_logs import ModelUnderTest
from tests.sim.fitting.diagnose.posterior_fixture import VESSEL, bench, short


def scored(**theta: list[float]):
    fit, noise = bench()[0], stated_noise(VESSEL)
    model = ModelUnderTest({name: np.array(values) for name, values in theta.items()}, noise)
    sound = ModelUnderTest({}, noise)
    return score([short()], VESSEL, fit.effects, {"base": sound, "refit": sound, "extended": model}, fit.physics, 0)


@pytest.mark.parametrize(("theta", "least"), [({"hull_fouling": [0.5]}, 300.0), ({"cg_shift": [1.0, 0.5]}, 1e5)])
def test_a_model_that_is_off_foretells_less_and_one_that_is_far_off_is_no_error(theta, least):
    """A centre of gravity a metre off, whose motion diverges by a whole step, as a first guess may be."""
    found = scored(**theta)
    assert found.nats["refit"] - found.nats["extended"] > least
    near = {e.channel: e for e in found.errors if e.horizon_s == 10}
    assert near["position"].rms["extended"] > near["position"].rms["refit"]


@pytest.mark.parametrize("blocks", [1, 2, LEAST_BLOCKS - 1])
def test_equal_models_are_seldom_surely_apart_however_few_the_stretches(blocks):
    """Noise alone, four windows in each block: at most one in eight; without the bound all of them, or half."""
    rng, apart, tries = np.random.default_rng(0), 0, 25
    groups = np.repeat(np.arange(blocks), 4)
    for _ in range(tries):
        squares = {
            m: {
                c: np.column_stack([np.arange(len(groups)), np.full(len(groups), 9.5), rng.chisquare(2, len(groups))])
                for c in CHANNELS
            }
            for m in MODELS
        }
        found = open_loop_errors(squares, groups, 0)
        apart += sum(not e.gain_ci95[0] <= 0 <= e.gain_ci95[1] for e in found)
        assert all(e.ci95[m][0] < e.rms[m] < e.ci95[m][1] and e.blocks == blocks for e in found for m in MODELS)
    assert apart <= tries * len(CHANNELS) / 8


def test_four_stretches_that_all_say_the_same_are_sure():
    groups = np.repeat(np.arange(4), 4)
    rng = np.random.default_rng(1)
    rows = np.column_stack([np.arange(16), np.full(16, 9.5), rng.chisquare(20, 16)])
    half = rows * [1, 1, 0.25]
    squares = {m: dict.fromkeys(CHANNELS, half if m == "extended" else rows) for m in MODELS}
    assert all(e.gain_ci95 == pytest.approx((0.5, 0.5)) for e in open_loop_errors(squares, groups, 0))
