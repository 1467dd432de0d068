"""The structured model: energy, Coriolis, current invariance, terms, and the boats of deploy/."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from companion.core.model.integrate import BufferedStep, DelayLine, step_function
from companion.core.model.manoeuvring import StructuredModel, coefficients, coriolis_force, mass_matrix
from tests.support.vessel_fixtures import boat

BOATS = ("aritra", "twin", "cse1")
speed = st.floats(-2.0, 2.0)


def free_step(vessel, h=0.01):
    return BufferedStep(step_function(StructuredModel.of(vessel), h))


@pytest.mark.parametrize("name", BOATS)
def test_energy_without_thrust_only_falls(name):
    """T = nu^T M nu / 2 falls at every step, from 60 random velocities (seed 1), for 5 s each."""
    vessel = boat(name)
    M, step, n = mass_matrix(vessel), free_step(vessel), len(vessel.thrusters)
    rng = np.random.default_rng(1)
    for _ in range(60):
        x = np.concatenate([rng.uniform(-5, 5, 3), rng.uniform(-2, 2, 3), np.zeros(n)])
        energy = 0.5 * x[3:6] @ M @ x[3:6]
        for _ in range(500):
            x = step(x, np.zeros(n), np.zeros(3))
            now = 0.5 * x[3:6] @ M @ x[3:6]
            assert now < energy
            energy = now


@given(speed, speed, speed)
def test_coriolis_does_no_work(u, v, r):
    nu = np.array([u, v, r])
    power = nu @ np.array(ca.DM(coriolis_force(coefficients(boat("aritra")), ca.DM(nu)))).ravel()
    assert abs(power) < 1e-9


def test_coriolis_matches_fossens_matrix():
    """C(nu) of Fossen (2011) eq. 6.43 for M with off-diagonal m23, written out by hand."""
    vessel = boat("aritra")
    M = mass_matrix(vessel)
    u, v, r = 0.7, -0.3, 0.4
    c13 = -(M[1, 1] * v + M[1, 2] * r)
    c23 = M[0, 0] * u
    C = np.array([[0, 0, c13], [0, 0, c23], [-c13, -c23, 0]])
    ours = np.array(ca.DM(coriolis_force(coefficients(vessel), ca.DM([u, v, r])))).ravel()
    assert ours == pytest.approx(C @ [u, v, r])


@settings(max_examples=30, deadline=None)
@given(st.floats(0, 0.5), st.floats(-180, 180), speed, speed, st.floats(-0.5, 0.5))
def test_steady_current_only_carries_the_boat(v_c, beta, u, v, r):
    """Seen from the moving water, a boat in a current moves as one in still water does."""
    calm = boat("aritra")
    terms = {"current": {"V_c_m_s": v_c, "beta_c_deg": beta, "source": "test"}}
    drift = v_c * np.array([np.cos(np.deg2rad(beta)), np.sin(np.deg2rad(beta))])
    still, carried = free_step(calm), free_step(replace(calm, terms=terms))
    a = np.array([0, 0, 0.3, u, v, r, 5, 5, -5, 5.0])
    b = a.copy()
    c, s = np.cos(a[2]), np.sin(a[2])
    b[3:5] += [c * drift[0] + s * drift[1], -s * drift[0] + c * drift[1]]
    for _ in range(300):
        a, b = still(a, np.zeros(4), np.zeros(3)), carried(b, np.zeros(4), np.zeros(3))
    assert b[:2] - 3.0 * drift == pytest.approx(a[:2], abs=1e-6)
    assert b[2] == pytest.approx(a[2], abs=1e-6)


def test_wind_pushes_away_from_where_it_comes():
    """A boat at rest, wind from the north: it drifts south whatever its heading."""
    terms = {"wind": {"V_w_m_s": 5.0, "beta_w_deg": 0.0, "source": "test"}}
    step = free_step(replace(boat("aritra"), terms=terms))
    for psi in np.linspace(-3, 3, 7):
        x = np.array([0, 0, psi, 0, 0, 0, 0, 0, 0, 0.0])
        for _ in range(200):
            x = step(x, np.zeros(4), np.zeros(3))
        assert x[0] < -0.005


def test_steady_surge_is_where_drag_meets_thrust():
    """Terminal speed solves X_u u + X_uu u^2 = X; here against numpy's roots."""
    vessel = boat("aritra")
    step = free_step(vessel)
    x = np.zeros(10)
    for _ in range(6000):
        x = step(x, np.full(4, 1.8), np.zeros(3))
    X = 4 * 1.8 * np.cos(np.pi / 4)
    d = vessel.damping
    root = max(np.roots([-d.X_uu_N_s2_m2, -d.X_u_N_s_m, -X]).real)
    assert x[3] == pytest.approx(root, rel=1e-4)


@given(st.lists(st.tuples(st.integers(1, 300), st.floats(-1, 1)), max_size=30), st.integers(0, 500))
def test_delay_line_is_the_command_of_then(commands, delay):
    line, sent, t = DelayLine(delay, (0.0,)), [], 0
    for gap, value in commands:
        t += gap
        line.push(t, (value,))
        sent.append((t, value))
    for now in range(0, t + 600, 37):
        past = [v for at, v in sent if at <= now - delay]
        assert line.at(now) == ((past[-1] if past else 0.0),)
        to_come = [at + delay for at, v in sent if at > now - delay and v != line.at(now)[0]]
        assert line.next_ns() == (to_come[0] if to_come else None)
