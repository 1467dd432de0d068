"""The estimator and one simulated run (see estimator_world)."""

import pytest

from companion.core.estimation.estimator import Estimator, EstimatorState
from tests.companion.core.estimation.estimator_world import Run, basin, simulate
from tests.support.vessel_fixtures import boat


@pytest.fixture(scope="session")
def estimator() -> Estimator:
    return Estimator(boat("aritra"), basin())


@pytest.fixture(scope="session")
def run() -> Run:
    return simulate(4, disturbed=True, seconds=40.0)


@pytest.fixture(scope="module")
def running(run: Run, estimator: Estimator) -> EstimatorState:
    """The state 3.3 s into the run."""
    state = estimator.initial()
    for m in run.messages[:330]:
        state, _ = estimator.step(state, m)
    return state
