"""Smoothing of held-out logs by models that are near, and by one that is far off."""

import numpy as np
import pytest

from sim.fitting.diagnose.posterior.noise import stated_noise
from sim.fitting.diagnose.selection.held_out import score
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
