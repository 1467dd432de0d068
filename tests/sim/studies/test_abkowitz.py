"""The paper's model: copied right, and every documented defect shown."""

import numpy as np
import pytest

from companion.core.model.thrusters import configuration_matrix
from sim.fitting.taylor import abkowitz
from sim.fitting.taylor.abkowitz import AbkowitzModel
from sim.fitting.taylor.abkowitz_table import SURGE, SWAY, TERMS, YAW
from sim.studies.paper.validity import VALIDITY, outside
from tests.support.vessel_fixtures import boat

B = configuration_matrix(boat("aritra"))
STILL = (0.0, 0.0, 0.0)


def nu_dot(nu, t=STILL):
    """Through the public interface, thrust given in kgf as the paper does; one column per run."""
    nu, t = np.atleast_2d(np.asarray(nu, dtype=float)), np.asarray(t, dtype=float)
    phi = abkowitz.regressor(nu.T, np.broadcast_to(t, nu.shape).T)
    return (abkowitz.C @ np.stack(np.broadcast_arrays(*phi))).T


def simulate(nu, t, seconds, h=0.05):
    """RK4 of many runs at once; returns the states and when each left |nu| < 50 (inf: it never did)."""
    nu = np.atleast_2d(np.array(nu, dtype=float))
    left = np.full(len(nu), np.inf)
    for k in range(round(seconds / h)):
        k1 = nu_dot(nu, t)
        k2 = nu_dot(nu + h / 2 * k1, t)
        k3 = nu_dot(nu + h / 2 * k2, t)
        k4 = nu_dot(nu + h * k3, t)
        nu = nu + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        gone = np.abs(nu).max(axis=1) > 50
        left[gone & np.isinf(left)] = (k + 1) * h
        nu[gone] = 0.0
    return nu, left


def test_table_2_is_copied_number_by_number(shared_data):
    text = shared_data.parent / "paper" / "paper.txt"
    if not text.is_file():
        pytest.skip("the paper's text is not here")
    lines = text.read_text().split("TABLE 2:")[1].splitlines()
    rows = [line.split("\t") for line in lines if line.startswith("C_")]
    assert [r[0].removeprefix("C_").strip("{}") for r in rows] == list(TERMS)
    assert [[float(v) for v in r[1:]] for r in rows] == [list(c) for c in zip(SURGE, SWAY, YAW, strict=True)]


def test_terms_follow_equation_4():
    """Written out again from (4), with the subscripts of Table 2 as exponents: an independent reading."""
    rng = np.random.default_rng(4)
    for _ in range(20):
        u, v, r = rng.normal(size=3)
        t = rng.normal(size=3)
        letter = {"u": u - 0.5, "v": v, "r": r, "x": t[0], "y": t[1], "n": t[2], "0": 1.0}
        by_name = [np.prod([letter[c] for c in name]) for name in TERMS]
        assert np.allclose(abkowitz.regressor((u, v, r), t), by_name)


def test_the_interface_takes_newtons():
    model = AbkowitzModel(B, 0.1)
    got = np.array(model.nu_dot(np.zeros(3), np.array([0.5, 0, 0]), np.array([9.80665, 0, 0]))).ravel()
    assert np.allclose(got, [0.0089, -0.0011, -0.00064])


def test_zero_thrust_holds_half_a_metre_per_second_for_ever():
    assert np.allclose(nu_dot((0.5, 0, 0)), 0.0)


def test_from_rest_it_speeds_up_by_itself():
    nu, _ = simulate(STILL, STILL, 5.0)
    assert nu[0, 0] == pytest.approx(0.30, abs=0.005)


def test_sway_force_does_nothing():
    assert np.array_equal(nu_dot((0.4, 0.1, 0.2), (0, 10, 0)), nu_dot((0.4, 0.1, 0.2)))


@pytest.mark.parametrize(("t", "seconds"), [((2, 0, 0), 72.3), ((14.5, 0, 0), 9.85), ((0, 0, 0.3), 65.35)], ids=str)
def test_constant_thrust_diverges(t, seconds):
    _, left = simulate((0.5, 0, 0), t, 90)
    assert left[0] == pytest.approx(seconds, abs=0.1)


def test_most_random_constant_thrusts_diverge_within_a_minute():
    c = np.random.default_rng(1).uniform(-4.0793, 5.1536, (200, 4))
    _, left = simulate(np.tile((0.5, 0, 0), (200, 1)), c @ B.T, 60)
    assert np.mean(np.isfinite(left)) > 0.9


def jacobian(nu, e=1e-6):
    return np.stack([(nu_dot(nu + e * d) - nu_dot(nu - e * d))[0] / (2 * e) for d in np.eye(3)], axis=1)


def test_the_box_is_where_its_reasons_hold():
    u, v, r = ((b.low, b.high) for b in VALIDITY[:3])
    growth = {s: np.linalg.eigvals(jacobian(np.array([s, 0, 0]))).real.max() for s in (0.40, *u)}
    assert growth[0.40] > 0 > max(growth[u[0]], growth[u[1]])
    for speed in np.linspace(*u, 30):
        J = jacobian(np.array([speed, 0, 0]))
        assert np.linalg.eigvalsh(J + J.T).max() < 0.0
    assert jacobian(np.array([0.5, v[0], 0]))[1, 1] < 0.0 < jacobian(np.array([0.5, v[0] - 0.02, 0]))[1, 1]
    cubic, linear = YAW[TERMS.index("rrr")] * r[1] ** 2, YAW[TERMS.index("r")]
    assert 0.95 < cubic / linear < 1.0


def test_what_lies_outside_the_box_is_named():
    assert outside((0.5, 0, 0), STILL) == ()
    assert outside((0.5, 0.1, 0.2), (5.0, 0.0, 2.0)) == ()
    speed, sway = outside(STILL, (0.0, 20.0, 0.0))
    assert speed.startswith("u_m_s = 0 is outside 0.43 to 0.85") and sway.startswith("Y_N = 20 is outside")
    assert len(outside((np.nan, 0, 0), STILL)) == 1
