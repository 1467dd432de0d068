"""scipy on CasADi's residuals: the very problem of the structured fit, so that comparing times means something."""

from dataclasses import replace

import numpy as np
import pytest

from sim.fitting.identify.structured_fit import FitPoint, FitSettings, StructuredFit, solve
from sim.studies.boats.draw import draw_boat, in_still_air
from sim.studies.peers.casadi_fit import casadi_fit, plain_fit
from sim.studies.peers.casadi_problem import CasadiProblem
from sim.world.teleop_log import teleop_run
from tests.support.vessel_fixtures import boat

TRUE = draw_boat(boat("aritra"), np.random.default_rng(11))


@pytest.fixture(scope="module")
def fitted() -> tuple[StructuredFit, FitPoint, CasadiProblem]:
    """Noise tuned as usual, then steps with it fixed until none promises anything."""
    fit = StructuredFit([teleop_run(TRUE, 11, 30.0)], in_still_air(boat("aritra")), FitSettings(window_s=2.0))
    point, _ = solve(fit)
    fit.settings = replace(fit.settings, tolerance_nats=1e-4)
    for _ in range(20):
        point, _ = fit.step(point)
    return fit, point, CasadiProblem(fit.windows, fit.parameters, fit.noise)


def _near(fit: StructuredFit, point: FitPoint, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    return point.w + 0.05 * rng.normal(size=point.w.shape), point.z + 0.02 * rng.normal(size=point.z.shape)


def test_both_have_the_same_cost_anywhere(fitted: tuple[StructuredFit, FitPoint, CasadiProblem]) -> None:
    fit, point, problem = fitted
    rng = np.random.default_rng(0)
    for _ in range(3):
        w, z = _near(fit, point, rng)
        r = problem.residual(np.concatenate([w, z.ravel()]))
        assert len(r) == problem.size
        assert 0.5 * r @ r == pytest.approx(fit.assemble(fit.point(w, z), fit.noise)[1], rel=1e-10)


def test_the_jacobian_is_that_of_the_residuals(fitted: tuple[StructuredFit, FitPoint, CasadiProblem]) -> None:
    fit, point, problem = fitted
    rng = np.random.default_rng(1)
    w, z = _near(fit, point, rng)
    at = np.concatenate([w, z.ravel()])
    J = problem.jacobian(at)
    assert J.shape == (problem.size, len(at))
    for _ in range(5):
        along = rng.normal(size=len(at))
        by_difference = (problem.residual(at + 1e-6 * along) - problem.residual(at - 1e-6 * along)) / 2e-6
        scale = abs(J) @ np.abs(along) + 1.0
        assert np.abs(by_difference - J @ along).max() < 1e-4 * scale.max()


def test_scipy_ends_where_the_fit_does(fitted: tuple[StructuredFit, FitPoint, CasadiProblem]) -> None:
    fit, point, problem = fitted
    chain, cost, _ = fit.assemble(point, fit.noise)
    se = np.sqrt(np.diag(np.linalg.inv(chain.solve()[2])))
    found = casadi_fit(problem)
    assert found.cost == pytest.approx(cost, abs=0.1)
    assert np.abs((found.w - point.w) / se).max() < 0.2


@pytest.mark.long
def test_a_plain_call_comes_nearer_and_is_given_up(fitted: tuple[StructuredFit, FitPoint, CasadiProblem]) -> None:
    fit, point, problem = fitted
    start = 0.5 * float(np.sum(problem.residual(problem.start) ** 2))
    none, some = plain_fit(problem, 0.0), plain_fit(problem, 2.0)
    assert not none.ended and none.residuals == 1 and none.cost == pytest.approx(start)
    assert fit.assemble(point, fit.noise)[1] - 1e-3 < some.cost < start and some.residuals > 1
