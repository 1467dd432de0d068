"""What is found is what is written: the fit's own physics against the extended file, in every program. Seed 7."""

from functools import cache

import numpy as np
import pytest

from sim.fitting.diagnose.vessel_edits.extend import extended
from tests.evidence.one_truth.draws import draw, families
from tests.evidence.one_truth.effects import GOAL, compared, engines, relative
from tests.evidence.one_truth.written import Models

TWO_EQUATIONS = ("advance_loss", "wash", "shallow_zone", "tether", "cross_flow", "turning_current")
"""Once written twice, or without a key."""
OTHERS = (
    "hull_fouling", "payload", "added_mass", "yaw_inertia", "cg_shift", "yaw_sway_coupling", "munk_moment",
    "thruster_gain", "thruster_fouling", "swapped_pair", "common_loss", "astern_asymmetry", "voltage_exponent",
    "dead_band", "lag", "dead_time", "rate_limit", "current", "wind", "accel_bias", "gyro_bias", "gyro_scale",
    "imu_misalignment", "imu_lever_arm", "heading_offset", "hard_iron", "uwb_latency", "clock_drift", "uwb_lever_arm",
    "uwb_scale",
)  # fmt: skip


@cache
def engine():
    return next(engines(7))


def drawn(name):
    return draw(families(engine().catalogue)[name], np.random.default_rng([7, len(name)]))


@pytest.mark.parametrize("name", [*TWO_EQUATIONS, *(pytest.param(n, marks=pytest.mark.long) for n in OTHERS)])
def test_the_written_file_is_the_fitted_model(name):
    assert compared(engine(), drawn(name)).worst < GOAL


def test_that_is_every_effect():
    assert set(families(engine().catalogue)) == {*TWO_EQUATIONS, *OTHERS}


@pytest.mark.parametrize(
    "names",
    [
        ("wash", "advance_loss"),
        ("hull_fouling", "shallow_zone"),
        pytest.param(("hull_fouling", "cg_shift"), marks=pytest.mark.long),
        pytest.param(("gyro_bias", "gyro_scale"), marks=pytest.mark.long),
        pytest.param(("accel_bias", "imu_misalignment"), marks=pytest.mark.long),
    ],
    ids="+".join,
)
def test_of_two_that_meet_the_file_is_the_fitted_model(names):
    assert compared(engine(), *map(drawn, names)).worst < GOAL


def test_a_file_without_the_cause_is_another_boat():
    """The comparison sees what it is for: 2 % and more of a tether, left out."""
    effect, values = drawn("tether")
    new = extended(engine().vessel, engine().cause(effect, values))
    without, x = Models(engine().vessel), engine().x
    nu_dot = engine().nu_dot([(effect, values)], x, 0.0).reshape(-1, 3)
    found = without.nu_dot(x.reshape(-1, 6), engine().forces_of(new).reshape(-1, 4), 0.0)
    assert relative(found, nu_dot) > 0.02
