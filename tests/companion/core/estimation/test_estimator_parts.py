"""The estimator's rooms one by one, against independent oracles."""

import math

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace
from scipy.integrate import solve_ivp
from scipy.optimize import approx_fprime, least_squares

from companion.core.estimation.command_history import TimedCommand, active_command, drop_expired, insert_command
from companion.core.estimation.filter_state import B_RANGE, LAYOUT
from companion.core.estimation.gates import Gate, GateRule, judge
from companion.core.estimation.kalman import KalmanEquations
from companion.core.estimation.process import Process
from companion.core.estimation.ranging.multilateration import multilaterate
from companion.core.estimation.ranging.ranges import position_sigma_m
from companion.core.estimation.ranging.uwb_fusion import UwbFusion
from companion.core.estimation.tuning import RANGE_GATE, EstimatorTuning
from companion.core.geometry.frames import to_level
from companion.core.messages import AnchorRange, UwbRanges
from companion.core.model.manoeuvring import StructuredModel
from companion.core.model.thrust_lag import lagged
from companion.core.sensors.table import screen
from tests.companion.core.estimation.estimator_world import basin
from tests.support.vessel_fixtures import boat

S = 1_000_000_000
ANCHORS = np.array([(a.north_m, a.east_m, a.down_m) for a in basin().anchors])


@pytest.fixture(scope="module")
def process() -> Process:
    return Process(StructuredModel.of(boat("aritra")), (0.10, 0.03))


def random_state(rng: np.random.Generator) -> np.ndarray:
    return rng.normal(0, [5, 5, 2, 0.5, 0.3, 0.5, 3, 3, 2])


def test_process_and_imu_jacobians_equal_finite_differences(process: Process) -> None:
    rng = np.random.default_rng(0)
    for _ in range(10):
        s, tau = random_state(rng), rng.normal(0, 10, 3)
        _, F = process.step(s, tau, 0.02)
        _, H = process.acceleration(s, tau)
        np.testing.assert_allclose(
            F, approx_fprime(s, lambda s, tau=tau: process.step(s, tau, 0.02)[0], 1e-7), atol=2e-6
        )
        np.testing.assert_allclose(
            H, approx_fprime(s, lambda s, tau=tau: process.acceleration(s, tau)[0], 1e-7), atol=2e-5
        )


def test_process_equals_scipys_integrator(process: Process) -> None:
    model, rng = StructuredModel.of(boat("aritra")), np.random.default_rng(1)
    w, tau = ca.SX.sym("w", 6), ca.SX.sym("tau", 3)
    accel = ca.Function("a", [w, tau], [model.nu_dot(w[:3], w[3:], tau)])
    s, force = random_state(rng), np.array([20.0, -5.0, 3.0])

    def rate(_t: float, y: np.ndarray) -> np.ndarray:
        c, sn = math.cos(y[2]), math.sin(y[2])
        eta_dot = [c * y[3] - sn * y[4], sn * y[3] + c * y[4], y[5]]
        return np.concatenate([eta_dot, np.array(accel(y, force + s[6:])).ravel()])

    truth = solve_ivp(rate, (0, 0.05), s[:6], rtol=1e-10, atol=1e-12).y[:, -1]
    np.testing.assert_allclose(process.step(s, force, 0.05)[0][:6], truth, atol=1e-5)


def test_imu_equation_equals_the_second_derivative_of_the_imus_place(process: Process) -> None:
    """Position of the IMU in NED, differentiated twice along the model's own path, turned into the body."""
    s, tau = np.array([1.0, 2.0, 0.7, 0.5, -0.2, 0.4, 1.0, -2.0, 0.5]), np.array([15.0, 3.0, 4.0])

    def place(dt: float) -> np.ndarray:
        x = process.step(s, tau, dt)[0]
        c, sn = math.cos(x[2]), math.sin(x[2])
        return np.array([x[0] + c * 0.10 - sn * 0.03, x[1] + sn * 0.10 + c * 0.03])

    h = 1e-3
    accel = (place(h) - 2 * place(0.0) + place(-h)) / h**2
    c, sn = math.cos(s[2]), math.sin(s[2])
    body = np.array([c * accel[0] + sn * accel[1], -sn * accel[0] + c * accel[1]])
    np.testing.assert_allclose(process.acceleration(s, tau)[0], body, atol=1e-5)


def test_levelled_removes_gravity_whatever_roll_and_pitch() -> None:
    for phi, theta in ((0.1, 0.0), (0.0, -0.2), (0.3, 0.25)):
        at_rest = -9.81 * np.array([-math.sin(theta), math.sin(phi) * math.cos(theta), math.cos(phi) * math.cos(theta)])
        np.testing.assert_allclose(to_level(phi, theta, *at_rest), [0, 0, -9.81], atol=1e-12)


def test_lag_is_exact_and_its_mean_is_the_mean() -> None:
    f, command = np.array([1.0, -2.0]), np.array([5.0, 4.0])
    t = np.linspace(0, 0.07, 7001)
    dense = command + (f - command) * np.exp(-t[:, None] / 0.1)
    end, mean = lagged(f, command, 0.07, 0.1)
    np.testing.assert_allclose(end, dense[-1], atol=1e-12)
    np.testing.assert_allclose(mean, np.trapezoid(dense, t, axis=0) / 0.07, atol=1e-8)


def test_commands_act_after_the_dead_time_and_the_past_is_forgotten() -> None:
    p = boat("aritra").propulsion
    line = (TimedCommand(-(1 << 62), np.zeros(4)),)
    line = insert_command(line, 0, (1.0,) * 4, p.dead_time_s)
    line = insert_command(line, S, (2.0,) * 4, p.dead_time_s)
    act = round(p.dead_time_s * 1e9)
    assert active_command(line, act - 1)[0][0] == 0.0
    assert active_command(line, act)[0][0] == 1.0
    assert active_command(line, act)[1] == S + act
    assert active_command(line, 5 * S) == (line[-1].f_n, None)
    assert len(drop_expired(line, act)) == 2
    assert len(insert_command(line, 0, (3.0,) * 4, p.dead_time_s)) == 2


def test_gate_lets_no_spike_pass_however_wide_the_filter_is() -> None:
    verdict, _ = judge(Gate(), RANGE_GATE, 0, 15.0, 10.0)
    assert verdict == "rejected"
    assert judge(Gate(), RANGE_GATE, 0, 0.3, 0.01)[0] == "accepted"


@pytest.mark.parametrize("period_s", [0.1, 1.0])
def test_gate_reopens_on_agreeing_rejections_at_any_rate(period_s: float) -> None:
    gate, verdicts = Gate(0), []
    for k in range(40):
        verdict, gate = judge(gate, RANGE_GATE, round(k * period_s * S), 4.0 + 0.1 * (k % 2), 0.15)
        verdicts.append(verdict)
        if verdict == "reopened":
            break
    assert verdicts[-1] == "reopened"
    assert RANGE_GATE.reopen_span_s <= (len(verdicts) - 1) * period_s <= 2.0
    assert gate.rejections == ()


def test_gate_stays_shut_to_spikes_that_disagree_and_to_quick_repeats() -> None:
    rng, gate = np.random.default_rng(2), Gate(0)
    for k in range(100):
        verdict, gate = judge(gate, RANGE_GATE, k * S, rng.uniform(3, 40), 0.15)
        assert verdict == "rejected"
    gate = Gate(0)
    for k in range(10):
        verdict, gate = judge(gate, RANGE_GATE, k * S // 10, 15.0, 0.15)
        assert verdict == "rejected"


@given(
    st.lists(st.tuples(st.integers(0, 10**10), st.floats(-50, 50), st.floats(0.0, 50)), max_size=60),
)
def test_gate_verdict_accepted_is_the_chi_square_rule_with_floor_and_ceiling(items) -> None:
    rule = GateRule(limit=3.0, floor=0.1, ceiling=0.5, reopen_count=3, reopen_span_s=1.0, agreement=1.0)
    gate = Gate()
    for t_ns, nu, sigma in sorted(items):
        verdict, gate = judge(gate, rule, t_ns, nu, sigma)
        assert (verdict == "accepted") == (abs(nu) <= 3.0 * min(max(sigma, 0.1), 0.5))


@settings(max_examples=40, deadline=None)
@given(st.floats(2, 28), st.floats(2, 28), st.integers(0, 2**32 - 1), st.booleans())
def test_fix_equals_scipys_robust_least_squares(north: float, east: float, seed: int, spike: bool) -> None:
    rng = np.random.default_rng(seed)
    z = np.sqrt((north - ANCHORS[:, 0]) ** 2 + (east - ANCHORS[:, 1]) ** 2 + (-0.4 - ANCHORS[:, 2]) ** 2)
    z += rng.normal(0, 0.05, 4)
    if spike:
        z[rng.integers(4)] += 15.0

    def residual(p: np.ndarray) -> np.ndarray:
        return z - np.sqrt(((p - ANCHORS[:, :2]) ** 2).sum(axis=1) + (-0.4 - ANCHORS[:, 2]) ** 2)

    oracle = least_squares(residual, [north, east], loss="cauchy", f_scale=0.3).x
    # a spike may by chance fit a second place with two good ranges: then both are candidates
    fix = min(
        multilaterate(ANCHORS, z, -0.4, 0.6), key=lambda f: math.hypot(f.north_m - oracle[0], f.east_m - oracle[1])
    )
    np.testing.assert_allclose([fix.north_m, fix.east_m], oracle, atol=2e-2)
    assert fix.inliers.sum() == (3 if spike else 4)


def test_anchors_in_a_line_leave_two_places() -> None:
    line = np.array([[0.0, 0.0, -2.0], [0.0, 10.0, -2.0], [0.0, 20.0, -2.0]])
    z = np.sqrt(((np.array([7.0, 12.0, 0.0]) - line) ** 2).sum(axis=1))
    fixes = multilaterate(line, z, 0.0, 0.6)
    assert sorted(round(f.north_m, 3) for f in fixes if f.cost < 0.01) == [-7.0, 7.0]


def test_fewer_than_two_anchors_give_no_place() -> None:
    assert multilaterate(ANCHORS[:1], np.array([5.0]), 0.0, 0.6) == []


def test_position_sigma_is_the_largest_semi_axis() -> None:
    A = np.random.default_rng(3).normal(size=(2, 2))
    P = np.eye(B_RANGE)
    P[:2, :2] = A @ A.T
    assert position_sigma_m(LAYOUT, P) == pytest.approx(np.sqrt(np.linalg.eigvalsh(A @ A.T).max()))


def test_bad_ranges_are_taken_out_one_by_one() -> None:
    ranges = tuple(AnchorRange(anchor=str(i), range_m=z) for i, z in enumerate((3.0, math.nan, -1.0, 4.0)))
    good, problem = screen(UwbRanges(t_ns=0, t_rx_ns=0, tag="t", ranges=ranges))
    assert isinstance(good, UwbRanges)
    assert [r.anchor for r in good.ranges] == ["0", "3"]
    assert "range" in problem


@pytest.mark.parametrize("scale", [0.0, 0.05, -0.2])
def test_range_jacobian_equals_finite_differences(scale: float) -> None:
    told = replace(boat("aritra").sensors.uwb, scale=scale)
    uwb = UwbFusion(basin(), told, EstimatorTuning(), KalmanEquations(B_RANGE + 4))
    rng, arm = np.random.default_rng(7), (-0.2, 0.15, -0.4)
    for anchor in range(4):
        x = rng.normal(0, 1, B_RANGE + 4) + np.r_[15.0, 12.0, np.zeros(B_RANGE + 2)]
        numeric = approx_fprime(x, lambda x, a=anchor: uwb.range_model(arm, a, x).h, 1e-6)
        np.testing.assert_allclose(uwb.range_model(arm, anchor, x).row, numeric, atol=1e-6)


@pytest.mark.parametrize("m", [1, 2, 3])
def test_update_equals_the_information_form(m: int) -> None:
    rng = np.random.default_rng(m)
    A, H = rng.normal(size=(5, 5)), rng.normal(size=(m, 5))
    x, P, R, nu = rng.normal(size=5), A @ A.T + np.eye(5), np.diag(rng.uniform(0.1, 1, m)), rng.normal(size=m)
    x_before, P_before = x.copy(), P.copy()
    x_after, P_after = KalmanEquations(5).update(x, P, nu, H, R)
    information = np.linalg.inv(P) + H.T @ np.linalg.inv(R) @ H
    np.testing.assert_allclose(P_after, np.linalg.inv(information), atol=1e-9)
    np.testing.assert_allclose(x_after, x + np.linalg.solve(information, H.T @ np.linalg.solve(R, nu)), atol=1e-9)
    np.testing.assert_array_equal(x, x_before)
    np.testing.assert_array_equal(P, P_before)
