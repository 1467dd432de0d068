"""Parts of the structured fit against oracles of another kind: dense algebra, finite differences, the plant itself."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from msgspec.structs import replace

from companion.core.configuration.vessel_file import Wash
from companion.core.model.integrate import FORCES
from companion.core.model.manoeuvring import linear_damping, mass_matrix
from sim.fitting.engine.block_tridiagonal import Chain, Ties
from sim.fitting.engine.free_parameters import unit_of
from sim.fitting.engine.initial_guess import local_line_fits
from sim.fitting.engine.model import compile_model
from sim.fitting.engine.motion import WindowIntegrator
from sim.fitting.engine.noise import STATE, L, noise_of, whiten
from sim.fitting.engine.parameters import Parameters, file_values
from sim.fitting.engine.thrust.battery import commands_of, pulses_of
from sim.fitting.engine.thrust.history import ThrustCommands, ThrustHistory
from sim.fitting.engine.windows import StructuredFitError, cut_windows
from sim.fitting.identify.structured_fit import UNMEASURED, FitSettings, StructuredFit
from sim.studies.boats.draw import draw_boat
from sim.world.environment import Environment, Weather
from sim.world.plant import Plant
from sim.world.teleop_log import teleop_run
from tests.support.vessel_fixtures import boat

P = Parameters(boat("aritra"))


def test_file_values_come_back_through_the_free_parameters() -> None:
    q = file_values(boat("aritra"))
    np.testing.assert_allclose(P.file_units(P.unconstrained(q)), q, rtol=1e-12)
    np.testing.assert_allclose(P.file_units(P.prior[0]), q, rtol=1e-12)


@given(arrays(float, len(P.names), elements=st.floats(-3, 3)))
@settings(max_examples=60, deadline=None)
def test_whatever_the_free_parameters_inertia_and_damping_are_positive(w: np.ndarray) -> None:
    q = dict(zip(P.names, P.file_units(w), strict=True))
    M = np.array([[q["M22_kg"], q["M23_kg_m"]], [q["M23_kg_m"], q["M33_kg_m2"]]])
    D = -np.array([[q["Y_v_N_s_m"], q["Y_r_N_s"]], [q["N_v_N_s"], q["N_r_N_m_s"]]])
    assert q["M11_kg"] > 0 and np.linalg.eigvalsh(M).min() > 0
    assert np.linalg.eigvalsh(D + D.T).min() > 0
    assert max(q[k] for k in ("X_u_N_s_m", "X_uu_N_s2_m2", "Y_vv_N_s2_m2", "N_rr_N_m_s2")) < 0


def test_jacobian_of_the_parameters_is_their_derivative() -> None:
    w = P.prior[0] + 0.1 * np.sin(np.arange(len(P.names)))
    h = 1e-6
    numeric = np.column_stack([(P.file_units(w + h * e) - P.file_units(w - h * e)) / (2 * h) for e in np.eye(len(w))])
    np.testing.assert_allclose(P.jacobian(w), numeric, rtol=1e-6, atol=1e-7)


def test_no_damping_in_the_file_is_a_start_nevertheless() -> None:
    vessel = boat("aritra")
    bare = replace(vessel, damping=replace(vessel.damping, X_uu_N_s2_m2=0.0, Y_v_N_s_m=0.0, N_v_N_s=0.0, Y_r_N_s=0.0))
    assert np.isfinite(Parameters(bare).prior[0]).all()


def test_units_follow_from_names() -> None:
    assert [unit_of(n) for n in ("M33_kg_m2", "X_u_N_s_m", "Y_r_N_s", "N_r_N_m_s", "lag_s", "tag_x_m", "gain_bow")] == [
        "kg m2", "N s/m", "N s", "N m s", "s", "m", "1",
    ]  # fmt: skip


def test_thrust_history_is_the_plants_force_and_knows_its_derivatives() -> None:
    boat_ = draw_boat(boat("aritra"), np.random.default_rng(3))
    run = teleop_run(boat_, 3, 30.0)
    gains = np.array([t.gain for t in boat_.thrusters])
    t_s, force = _plant_forces(boat_, run, 30.0)
    propulsion = boat_.propulsion
    commands = commands_of(pulses_of(run, boat_), boat_)
    history = ThrustHistory(commands, propulsion.dead_time_s, propulsion.lag_s)
    late = t_s > 1.0  # the first command is taken to have held before the run
    error = history.at(t_s)[0] * gains - force
    assert np.sqrt((error[late] ** 2).mean()) < 0.002 * np.sqrt((force**2).mean())
    _, d_dead, d_lag = history.at(t_s)
    h = 1e-5
    for column, derivative in ((0, d_dead), (1, d_lag)):
        up, down = ([propulsion.dead_time_s, propulsion.lag_s] for _ in range(2))
        up[column] += h
        down[column] -= h
        numeric = (ThrustHistory(commands, *up).at(t_s)[0] - ThrustHistory(commands, *down).at(t_s)[0]) / (2 * h)
        smooth = np.abs(t_s[:, None] - (commands.t_s + propulsion.dead_time_s)).min(axis=1) > 2 * h
        np.testing.assert_allclose(derivative[smooth], numeric[smooth], rtol=1e-3, atol=1e-2)


def _plant_forces(vessel, run, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Forces of the plant that gets the same pulse widths at the same times."""
    plant = Plant(vessel, np.zeros(6), step_ns=10_000_000, voltage_v=15.6)
    air = Environment(Weather(), np.random.default_rng(0))
    t_c, pwm = run.commands()
    due, t_s, force = 0, [], []
    for k in range(round(seconds * 100)):
        while due < len(t_c) and t_c[due] <= k * 0.01 + 1e-9:
            plant.command(round(t_c[due] * 1e9), tuple(pwm[due]))
            due += 1
        motion = plant.step(air.step(k * 0.01, 0.01))
        t_s.append(motion.t_ns * 1e-9)
        force.append(motion.x[FORCES].copy())
    return np.array(t_s), np.array(force)


def test_a_step_of_command_gives_a_late_exponential() -> None:
    history = ThrustHistory(ThrustCommands(np.array([0.0, 1.0]), np.array([[0.0], [10.0]])), 0.2, 0.1)
    t = np.array([1.19, 1.2, 1.3, 1.5])
    np.testing.assert_allclose(history.at(t)[0][:, 0], [0, 0, 10 * (1 - np.exp(-1)), 10 * (1 - np.exp(-3))], atol=1e-9)


def test_whitening_equals_that_by_the_covariance() -> None:
    rng = np.random.default_rng(0)
    noise = noise_of(boat("aritra"))
    h = rng.uniform(0.02, 0.04, (1, 12))
    known = np.ones((1, 12), dtype=bool)
    known[0, 4] = False
    t = np.concatenate([[0.0], np.cumsum(h[0])[:-1]])
    decay = lambda dt: np.exp(-np.abs(dt) / noise.wander_time_s)  # noqa: E731
    both = noise.wander_rad**2 * (decay(t[:, None] - t) - decay(t[:, None]) * decay(t))  # wander is known at the node
    C = (both + noise.white[0] ** 2 * np.eye(12))[np.ix_(known[0], known[0])]
    e = rng.normal(size=12)
    white = whiten(e[None, :, None], known, h, noise)[0, :, 0]
    assert white[4] == 0
    np.testing.assert_allclose(white[known[0]], np.linalg.solve(np.linalg.cholesky(C), e[known[0]]), rtol=1e-9)


def test_the_chain_solves_as_the_dense_normal_equations_do() -> None:
    rng = np.random.default_rng(1)
    W, size, P_ = 5, 3, 4
    J = rng.normal(size=(W, 9, size + P_))
    r = rng.normal(size=(W, 9, 1))
    chain = Chain.nothing(W, size, P_)
    chain.add(slice(0, 3), J[:3], r[:3, :, 0])
    chain.add_samples(np.repeat([3, 4], 3), J[3:].reshape(6, 3, -1), r[3:].reshape(6, 3))
    ties = Ties(
        rng.normal(size=(4, size)),
        rng.normal(size=(4, size, size)),
        rng.normal(size=(4, size - 1, P_)),
        np.arange(4),
        np.ones(4),
    )
    sigma = rng.uniform(0.5, 2, (4, size))
    chain.add_ties(ties, sigma)
    rows, right = [], []
    for w in range(W):
        full = np.zeros((9, W * size + P_))
        full[:, w * size : (w + 1) * size], full[:, W * size :] = J[w, :, :size], J[w, :, size:]
        rows.append(full)
        right.append(r[w, :, 0])
    for k in range(4):
        full = np.zeros((size, W * size + P_))
        full[:, k * size : (k + 1) * size], full[:, (k + 1) * size : (k + 2) * size] = -ties.F[k], np.eye(size)
        full[: size - 1, W * size :] = -ties.G[k]
        rows.append(full / sigma[k][:, None])
        right.append(ties.rho[k] / sigma[k])
    A, b = np.vstack(rows), np.concatenate(right)
    dz, dw, D, log_det = chain.solve()
    np.testing.assert_allclose(np.append(dz, dw), -np.linalg.lstsq(A, b, rcond=None)[0], rtol=1e-8)
    H = A.T @ A
    np.testing.assert_allclose(np.linalg.inv(D), np.linalg.inv(H)[-P_:, -P_:], rtol=1e-7)
    assert log_det == pytest.approx(np.linalg.slogdet(H[:-P_, :-P_])[1])


def test_windows_without_samples_add_nothing() -> None:
    chain = Chain.nothing(4, 3, 2)
    chain.add(slice(2, 2), np.empty((0, 9, 5)), np.empty((0, 9)))
    chain.add_samples(np.empty(0, dtype=int), np.empty((0, 2, 5)), np.empty((0, 2)))
    assert not any(block.any() for block in (chain.A, chain.B, chain.D, chain.g, chain.d))


@pytest.fixture(scope="module", params=[FitSettings(), UNMEASURED], ids=["measured", "unmeasured"])
def small_fit(request: pytest.FixtureRequest) -> StructuredFit:
    run = teleop_run(draw_boat(boat("aritra"), np.random.default_rng(5)), 5, 40.0, uwb_hz=2.0)
    return StructuredFit([run], boat("aritra"), request.param)


def test_gradient_is_the_derivative_of_the_cost(small_fit: StructuredFit) -> None:
    """Every column of the Jacobian at once: along random directions, against central differences."""
    rng = np.random.default_rng(7)
    fit, start = small_fit, small_fit.begin()
    start.w[fit.parameters.imu] += np.array([0.1, -0.1, 0.2, 0.1])[: len(start.w[fit.parameters.imu])]
    z = start.z + 0.01 * rng.normal(size=start.z.shape)
    z[:, STATE.stop :] = 0.002 * rng.normal(size=(len(z), L - STATE.stop))
    here = fit.point(start.w, z)
    chain, _, _ = fit.assemble(here, fit.noise)
    _, spread = fit.parameters.prior
    blocks = {"nodes": (np.ones(L), 0.0)} | {n: (np.zeros(L), i) for i, n in enumerate(fit.parameters.names)}
    for name, (share, i) in blocks.items():
        dz = 1e-3 * share * rng.normal(size=z.shape)
        dw = np.zeros(len(start.w)) if name == "nodes" else 0.01 * spread * (np.arange(len(spread)) == i)
        h = 1e-2
        costs = [fit.assemble(fit.point(start.w + s * h * dw, z + s * h * dz), fit.noise)[1] for s in (1, -1)]
        numeric = (costs[0] - costs[1]) / (2 * h)
        exact = float((chain.g * dz).sum() + chain.d @ dw)
        size = float(np.sqrt(dw @ chain.D @ dw)) + np.abs(exact)
        assert numeric == pytest.approx(exact, rel=0.02, abs=0.05 * size), name


def test_a_run_without_positions_is_refused_by_name() -> None:
    run = teleop_run(boat("aritra"), 1, 10.0)
    blind = type(run)(
        run.table.with_columns(north_m=None, east_m=None).cast({"north_m": float, "east_m": float}), run.meta
    )
    with pytest.raises(StructuredFitError, match="teleop_run seed 1: the fit needs psi_rad and north_m, east_m"):
        cut_windows([blind], boat("aritra"), 2.0)
    with pytest.raises(StructuredFitError, match="too short"):
        cut_windows([teleop_run(boat("aritra"), 1, 4.0)], boat("aritra"), 2.0)


def test_windows_hold_each_sample_once() -> None:
    run = teleop_run(boat("aritra"), 2, 30.0)
    windows = cut_windows([run, run], boat("aritra"), 2.0)
    t, _ = run.samples("psi_rad")
    assert windows.samples() == 2 * int((t[:-1] >= t[0] + 1.0).sum())
    assert windows.first.sum() == 2
    np.testing.assert_allclose(windows.t_s[:-1, -1][~windows.first[1:]], windows.t_s[1:, 0][~windows.first[1:]])


def test_the_model_file_has_the_inertia_that_was_fitted() -> None:
    q = file_values(boat("aritra"))
    np.testing.assert_allclose(q[:4], mass_matrix(boat("aritra"))[[0, 1, 2, 1], [0, 1, 2, 2]])
    np.testing.assert_allclose(-q[4:7], np.diag(linear_damping(boat("aritra"))))


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10_000), count=st.integers(4, 40), reach=st.floats(0.1, 5.0))
def test_first_guesses_are_weighted_lines_through_near_fixes(seed: int, count: int, reach: float) -> None:
    """Oracle: numpy's least squares on all fixes within reach, or within 1.01 times the way to the fourth nearest."""
    rng = np.random.default_rng(seed)
    t, at = np.cumsum(rng.uniform(0.05, 1.5, count)), rng.uniform(-2, 1.2 * count, 6)
    place, track = rng.normal(size=(count, 2)), np.empty((6, 2, 2))
    local_line_fits(t, place, at, reach, track)
    for t0, found in zip(at, track, strict=True):
        far = max(reach, np.sort(np.abs(t - t0))[3] * 1.01)
        near = np.abs(t - t0) < far
        weight = np.sqrt(1 - np.abs(t[near] - t0) / far)[:, None]
        basis = np.stack([np.ones(near.sum()), t[near] - t0], axis=1)
        expected = np.linalg.lstsq(basis * weight, place[near] * weight, rcond=None)[0]
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("lossy", [False, True])
def test_parameters_of_the_thrusters_move_the_boat_as_differences_say(lossy: bool) -> None:
    """Exact slopes of the accelerations against central differences; a quarter less astern, boats under way, seed 3."""
    vessel = boat("aritra")
    maps = {name: replace(m, astern_share=0.8) for name, m in vessel.force_maps.items()}
    wash = (Wash(behind="rear_port", ahead="front_port", share=0.2),)
    losses = replace(vessel.propulsion, advance_loss_s_m=0.2, advance_loss_sqrt_N_s_m=0.1, wash=wash)
    own = replace(vessel, force_maps=maps, propulsion=losses if lossy else vessel.propulsion)
    parameters = Parameters(own)
    windows = cut_windows([teleop_run(vessel, 3, 30.0)], own, 2.0)
    W, K = windows.size
    move = WindowIntegrator(windows, parameters, compile_model(own, K, W))
    q, z = file_values(own), np.zeros((W, L))
    assert q[parameters.names.index("astern_t200")] == 0.8
    z[:, STATE] = np.random.default_rng(3).normal(0.0, 0.5, (W, 6))
    exact = move(q, z).pushes.nodes
    for name in ("gain_front_port", "lag_s", "astern_t200", *["advance_loss_s_m"] * lossy):
        at = parameters.names.index(name)
        ends = [move(q + sign * 1e-4 * np.eye(len(q))[at], z).nu_dot[:, 0] for sign in (1, -1)]
        found = exact[:, 0, :, list(parameters.moving).index(at)]
        np.testing.assert_allclose(found, (ends[0] - ends[1]) / 2e-4, atol=1e-6, err_msg=name)
        assert np.abs(found).max() > 0.1, name
