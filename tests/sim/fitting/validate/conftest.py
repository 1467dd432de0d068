"""A simulated log and its windows."""

import pytest

from sim.fitting.engine.smoothing import smooth
from sim.fitting.taylor.abkowitz import C
from sim.fitting.taylor.pipeline import smoother_samples
from sim.fitting.taylor.regression import least_squares
from sim.fitting.validate.models import TaylorSimulator, VesselSimulator
from sim.fitting.validate.study import HeldOut, validate
from sim.world.teleop_log import teleop_run
from tests.sim.fitting.validate.example_vessel import NOISE, VESSEL


@pytest.fixture(scope="session")
def run():
    return teleop_run(VESSEL, 4, 90.0)


@pytest.fixture(scope="session")
def found(run):
    samples = smoother_samples(run, VESSEL, smooth(run, NOISE))
    taylor = TaylorSimulator("Taylor", least_squares([samples]).C, VESSEL)
    printed = TaylorSimulator("printed", C, VESSEL)
    return validate(
        [VesselSimulator("true", VESSEL), taylor, printed], [HeldOut(run)], VESSEL, NOISE, horizon_s=30.0, stride_s=15.0
    )
