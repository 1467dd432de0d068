"""The estimator and one simulated run (see estimator_world)."""

import pytest

from companion.core.estimation.estimator import Estimator
from tests.companion.core.estimation.estimator_world import Run, basin, simulate
from tests.support.vessel_fixtures import boat


@pytest.fixture(scope="session")
def estimator() -> Estimator:
    return Estimator(boat("aritra"), basin())


@pytest.fixture(scope="session")
def run() -> Run:
    return simulate(4, disturbed=True, seconds=40.0)
