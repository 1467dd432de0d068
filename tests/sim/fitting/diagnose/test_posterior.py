"""The engine of diagnosis: columns against finite differences, evidence against closed forms, causes found in logs.

Logs are simulated (`teleop_run`, seeds stated); boats differ from the believed file by one effect.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import msgspec
import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from companion.logs.runs.run import Run
from companion.logs.runs.splits import parts
from sim.fitting.diagnose.catalogue import catalogue
from sim.fitting.diagnose.catalogue.effect import ABSENT, TOLERANCE, Effect, EffectParameter, Scene, slices
from sim.fitting.diagnose.posterior.converged_rollout import settled
from sim.fitting.diagnose.posterior.evidence import Prior, Reduced
from sim.fitting.diagnose.posterior.fit import PosteriorFit
from sim.fitting.diagnose.posterior.noise import stated_noise
from sim.fitting.diagnose.posterior.physics import EffectPhysics
from sim.fitting.diagnose.selection.candidate_score import Candidate
from sim.fitting.diagnose.selection.model import CandidateModel
from sim.fitting.diagnose.selection.search import search
from sim.fitting.diagnose.selection.select import Selection, Selector, makes_room
from sim.fitting.engine.initial_guess import initial_nodes
from sim.fitting.engine.jacobian_rows import AccelerationPartials, sensitivities
from sim.studies.boats.draw import in_still_air
from sim.world.environment import Weather
from sim.world.teleop_log import teleop_run
from tests.support.vessel_fixtures import boat

VESSEL = in_still_air(boat("aritra"))


@cache
def short(seed: int = 21, seconds: float = 40.0):
    return teleop_run(boat("aritra"), seed, seconds, uwb_hz=5.0, sigma_m=0.07)


@cache
def bench() -> tuple[PosteriorFit, dict[str, Effect]]:
    fit = PosteriorFit(EffectPhysics([short()], VESSEL, 1.0), catalogue(VESSEL, [short()]), stated_noise(VESSEL))
    return fit, {e.id: e for e in fit.effects}


SMOOTH = ["base:M11_kg", "base:N_v_N_s", "hull_fouling", "payload", "cg_shift", "yaw_inertia", "cross_flow", "current",
          "thruster_gain:front_port", "advance_loss", "wash", "munk_moment", "tether@-0.6", "wind"]  # fmt: skip


BY_WATER = {"munk_moment": 60.0, "cross_flow": 0.3, "advance_loss": 0.3}
DEAD = "thruster_gain:front_port"
BESIDE = BY_WATER | {DEAD: -1.0, "common_loss": 0.4}
BY_THRUST = [("common_loss", DEAD), ("wash", DEAD), ("lag", DEAD), (DEAD, "common_loss"), ("dead_time", "advance_loss")]


@pytest.mark.parametrize(
    ("name", "beside"), [*((name, "") for name in SMOOTH), *(("current", beside) for beside in BY_WATER), *BY_THRUST]
)
def test_columns_are_the_derivatives_of_the_motion(name, beside):
    """Oracle: central differences of the integrated windows themselves. `beside`: what is there with it."""
    fit, by_id = bench()
    effect, physics = by_id[name], fit.physics
    there = {"current": np.array([0.02, -0.03])} | ({beside: np.array([BESIDE[beside]])} if beside else {})
    if name == "wind":
        there[name] = np.array([5.0, -3.0])  # beside this the boat's own way is small: linear in the pressure
    state = physics.move(fit.effects, there, fit.z0, None)
    columns = physics.accelerations(fit.effects, there, state, [effect])
    S = sensitivities(state.A, AccelerationPartials.of(columns.nodes, columns.bump), physics.windows.h_s)
    now = there.get(name, np.zeros(len(effect.parameters)))
    for j, parameter in enumerate(effect.parameters):
        step = np.zeros(len(effect.parameters))
        step[j] = parameter.step
        ahead = physics.move(fit.effects, {**there, name: now + step}, fit.z0, None)
        behind = physics.move(fit.effects, {**there, name: now - step}, fit.z0, None)
        expected = (ahead.x[:, -1] - behind.x[:, -1]) / (2 * parameter.step)
        off = np.abs(S[:, -1, :, 9 + j] - expected).max(axis=0)
        assert (off[3:] <= 0.12 * np.abs(expected).max(axis=0)[3:] + 1e-9).all()


def test_a_shallow_zone_that_is_everywhere_is_a_fouled_hull_also_in_an_open_loop():
    """Oracle: the model integrated with twice its damping. Three passes would be metres off."""
    fit, _ = bench()
    physics = EffectPhysics([short()], VESSEL, 15.0)
    z = initial_nodes(physics.windows, physics.parameters)
    everywhere = {"shallow_zone@4": np.array([1.0, 0.0, 0.0, 1e3])}
    expected = physics.move(fit.effects, {"hull_fouling": np.array([1.0])}, z, None).x
    assert np.abs(settled(physics, fit.effects, everywhere, z).x - expected).max() < 0.01
    assert np.abs(physics.move(fit.effects, everywhere, z, None).x - expected)[..., :2].max() > 1.0


@pytest.mark.parametrize(
    "theta",
    [
        {"tether@+0.0": [5.0, 3.0, -2.0, 0.0]},
        {"advance_loss": [1.2]},
        {DEAD: [-2.0], "cross_flow": [0.5], "current": [0.1, -0.2], "shallow_zone@4": [1.5, 0.0, 0.0, 0.0]},
        {"advance_loss": [0.02], "current": [0.01, 0.0]},
    ],
)
def test_an_open_loop_goes_on_until_forces_are_those_along_its_own_motion(theta):
    fit, _ = bench()
    physics = EffectPhysics([short()], VESSEL, 15.0)
    theta = {name: np.array(values) for name, values in theta.items()}
    state = settled(physics, fit.effects, theta, initial_nodes(physics.windows, physics.parameters))
    scene = physics.scene(state)
    more, water = physics.extra(fit.effects, theta, scene, state.forces.f)
    np.testing.assert_allclose(state.tau, state.forces.f @ physics.B.T + more, atol=0.05)
    np.testing.assert_allclose(state.water, water, atol=1e-3)


@pytest.mark.parametrize("trim_us", [0.0, 3.0])
def test_pulses_that_changed_places_are_in_place_when_other_changes_of_thrust_are_taken(trim_us):
    fit, by_id = bench()
    swap, trim = by_id["swapped_pair:front_port+rear_port"], by_id["base:trim:rear_port"]
    theta, step = {swap.id: np.array([1.0]), trim.id: np.array([trim_us])}, np.array([2.0])
    thrusters = fit.physics.thrusters
    found = thrusters.change(fit.effects, theta, trim, step)
    there = {**theta, trim.id: theta[trim.id] + step}
    expected = thrusters.forces(fit.effects, there).less(thrusters.forces(fit.effects, theta))
    np.testing.assert_allclose(found.f, expected.f, atol=1e-9)
    assert np.abs(found.f - thrusters.change(fit.effects, {trim.id: theta[trim.id]}, trim, step).f).max() > 1e-3


@given(north=st.floats(-0.2, 0.2), east=st.floats(-0.2, 0.2))
def test_a_light_wind_from_behind_is_the_opposite_of_one_from_ahead(north, east):
    """Else a share of one is none of the other, and a strong wind could come out with the wrong sign."""
    fit, by_id = bench()
    scene = fit.physics.scene(fit.physics.move(fit.effects, {}, fit.z0, None))
    force = by_id["wind"].hooks["force"]
    one, other = (force({"north_Pa": s * north, "east_Pa": s * east}, scene) for s in (1.0, -1.0))
    np.testing.assert_allclose(one, -other, atol=1e-12)


@pytest.mark.parametrize("name", ["munk_moment", "cross_flow", "advance_loss", "shallow_zone@0"])
@given(psi=st.floats(-3.1, 3.1), north=st.floats(-0.3, 0.3), east=st.floats(-0.3, 0.3))
def test_a_boat_that_drifts_with_the_water_feels_none_of_it(name, psi, north, east):
    """What hull and propellers feel goes by the motion through the water."""
    effect, t = bench()[1][name], np.zeros((1, 1))
    c, s = np.cos(psi), np.sin(psi)
    x = np.array([[[0.0, 0.0, psi, c * north + s * east, c * east - s * north, 0.0]]])
    scene = Scene(t, t, x, np.zeros((1, 1, 3)), np.zeros(1), np.zeros(2), 0.0, np.array([[[north, east]]]))
    p = {q.name: 0.3 for q in effect.parameters}
    if "force" in effect.hooks:
        assert np.abs(effect.hooks["force"](p, scene)).max() < 1e-12
    else:
        f = np.full((1, 1, 4), 7.0)
        np.testing.assert_allclose(effect.hooks["thrust"](p, scene, f), f, atol=1e-12)


def test_a_tether_counts_by_its_pull_as_well_as_by_its_stiffness():
    tether = next(e for e in bench()[1].values() if e.name == "tether")
    assert tether.size(np.array([0.01, 1.5, 0.0, 0.0])) >= 2.0
    assert tether.size(np.array([0.15, 0.0, 0.0, 0.3])) == pytest.approx(3.0)


def test_every_entry_changes_something():
    """An entry whose hook does nothing on a log that excites everything would never be found."""
    fit, _ = bench()
    state = fit.physics.move(fit.effects, {}, fit.z0, None)
    columns = fit.lineariser.columns(fit.effects, {}, state, fit.effects)
    silent = set()
    for effect, at in zip(fit.effects, slices(fit.effects).values(), strict=True):
        first = at.start
        moved = max(np.abs(part[..., first]).max() for part in (columns.a.nodes, columns.imu, columns.tag))
        if moved == 0:
            silent.add(effect.name)
    assert silent <= {"rate_limit"}  # a log of gentle commands does not meet the limit


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), count=st.integers(1, 5))
def test_evidence_is_that_of_a_linear_gaussian_model(seed, count):
    """Oracle: scipy's density of y = J theta + e with theta and e normal."""
    rng = np.random.default_rng(seed)
    J, y = rng.normal(size=(8, count)), rng.normal(size=8)
    sigma, mean, theta0 = rng.uniform(0.2, 3.0, count), rng.normal(size=count), rng.normal(size=count)
    prior = Prior(sigma, mean)
    residual = J @ theta0 - y
    constant = -0.5 * float(residual @ residual) - 4 * np.log(2 * np.pi)
    reduced = Reduced(J.T @ J, -J.T @ residual, theta0, constant)
    expected = multivariate_normal(J @ mean, J @ np.diag(sigma**2) @ J.T + np.eye(8)).logpdf(y)
    assert reduced.evidence(prior) == pytest.approx(expected, abs=1e-6)
    gone = slice(0, 1)
    other = J[:, 1:]
    rest = multivariate_normal(other @ mean[1:], other @ np.diag(sigma[1:] ** 2) @ other.T + np.eye(8)).logpdf(y)
    if count > 1:
        posterior = reduced.posterior(prior)
        assert expected + posterior.absent(gone) == pytest.approx(rest, abs=1e-6)
        wider = Prior(np.append(3 * sigma[0], sigma[1:]), np.append(mean[0] - 1, mean[1:]))
        gain, values, covariance = posterior.instead(gone, wider.part(gone))
        assert expected + gain == pytest.approx(reduced.evidence(wider), abs=1e-6)
        again = reduced.posterior(wider)
        assert values == pytest.approx(again.values[gone]) and covariance == pytest.approx(again.covariance[gone, gone])


def test_tolerance_is_half_a_size_and_nothing_for_places():
    by_id = bench()[1]
    assert by_id["lag"].tolerance() == pytest.approx([TOLERANCE * by_id["lag"].parameters[0].smallest])
    onset = next(e for e in by_id.values() if e.id.startswith("thruster_fouling"))
    assert onset.tolerance()[0] == pytest.approx(ABSENT * onset.parameters[0].smallest)


def test_a_special_case_makes_room_only_for_what_explains_more():
    def model(evidence, *believed):
        return CandidateModel(frozenset(believed), None, None, (), None, evidence)

    steady = model(0.0, "current")
    assert not makes_room(steady, model(11.0, "turning_current@1"))
    assert makes_room(steady, model(13.0, "turning_current@1"))
    assert makes_room(steady, model(1.0, "current", "lag")), "judged by its own nats"


def searching(before: CandidateModel, gains: dict[str, float], refused: tuple[str, ...] = ()) -> Selector:
    """A search whose refits end with the evidence `gains` (by id), of which all but `refused` are acceptable."""
    selector = Selector(bench()[0])
    selector.refit = lambda _start, believed, values: replace(
        before, believed=believed, evidence=gains[next(iter(values))]
    )
    selector._start = lambda _model, _candidate: np.zeros(1)
    selector._judged = lambda _model, id_: hopeful(id_, 0.5 if id_ in refused else 8.0)
    return selector


def hopeful(id_: str, lower: float = 8.0, size: float = 9.0) -> Candidate:
    return Candidate(id_, 500.0, 500.0, np.ones(len(bench()[0].effects)), np.eye(1), size, lower)


def before(*believed: str) -> CandidateModel:
    return CandidateModel(frozenset(believed), SimpleNamespace(cost=100.0), None, (), None, 0.0)


def turning() -> str:
    return next(e.id for e in bench()[0].effects if e.name == "turning_current")


def test_a_special_case_that_stays_does_not_end_the_search():
    """A turning current gains 10 nats over the steady one, in whose place it would come; a lag 9 beside it."""
    steady = before("current")
    selector = searching(steady, {turning(): 10.0, "lag": 9.0})
    best, behind = selector._best(steady, [hopeful(turning()), hopeful("lag")])
    assert best is not None and best.believed == {"current", "lag"} and not behind


def test_what_explains_more_than_the_special_case_that_is_taken_is_told_if_it_could_be_named():
    """A turning current is too small, the steady one is taken in its place: a lag explains more than that."""
    nothing, gains = before(), {turning(): 30.0, "lag": 25.0, "current": 20.0}
    ranking = [hopeful(id_) for id_ in gains]
    best, behind = searching(nothing, gains, (turning(),))._best(nothing, ranking)
    assert best is not None and best.believed == {"current"} and behind == [("lag", 0.0)]
    best, behind = searching(nothing, gains, (turning(), "lag"))._best(nothing, ranking)
    assert best is not None and best.believed == {"current"} and not behind


def test_what_lies_between_the_places_that_are_tried_seems_small_and_is_refitted_if_nothing_else_stands():
    zone = next(e.id for e in bench()[0].effects if e.name == "shallow_zone")
    nothing, gains = before(), {"lag": 20.0, zone: 30.0}
    small = [hopeful(zone, size=0.5), hopeful("lag")]
    best, _ = searching(nothing, gains, ("lag",))._best(nothing, small)
    assert best is not None and best.believed == {zone}
    best, behind = searching(nothing, gains)._best(nothing, small)
    assert best is not None and best.believed == {"lag"} and not behind
    assert searching(nothing, gains)._best(nothing, [hopeful("lag", size=0.5)]) == (None, [])


def test_an_impossible_value_at_one_of_many_places_hides_no_cause_that_explains_nearly_as_much():
    """A shallow that would weaken the damping, 3 nats before a scale of the gyro, which could be named."""
    zone = next(e.id for e in bench()[0].effects if e.name == "shallow_zone")
    nothing, ranking = before(), [hopeful(zone), hopeful("gyro_scale")]

    def best(scale: float, lower: float) -> frozenset[str]:
        selector = searching(nothing, {zone: 42.0, "gyro_scale": scale})
        selector._judged = lambda _model, id_: hopeful(id_, lower if id_ == zone else 8.0)
        found, _ = selector._best(nothing, ranking)
        return found.believed if found else frozenset()

    assert best(39.0, -np.inf) == {"gyro_scale"}
    assert best(29.0, -np.inf) == frozenset(), "12 nats and more are no chance: there is something"
    assert best(39.0, 0.5) == frozenset(), "possible, but perhaps too small: nothing else may stand in for it"


def weighing(evidence: dict[frozenset[str], float]) -> Selector:
    """A search in which believing in a set is worth what `evidence` says, for all who stand a test."""
    selector = Selector(bench()[0])
    selector.refit = lambda _start, believed, _values: replace(before(*believed), evidence=evidence[believed])
    selector.screen = lambda _model: [hopeful("payload"), hopeful("dead_time")]
    selector.complete = lambda _model: None
    selector._start = lambda _model, _candidate: np.zeros(1)
    selector._judged = lambda _model, id_: hopeful(id_)
    return selector


def test_rivals_are_judged_beside_what_was_found_later():
    """Dead time was 1 nat behind a lag when that was taken; beside the wash it is 30 behind."""
    selector = weighing({frozenset({"wash"}): 20.0, frozenset({"dead_time", "wash"}): 70.0})
    final = replace(before("lag", "wash"), evidence=100.0)
    rivals = {"lag": [("dead_time", 1.0), ("payload", 8.0)]}
    assert selector._in_place(final, rivals) == {"lag": [("dead_time", 30.0), ("payload", 8.0)]}


def test_a_rival_without_which_the_boat_is_thrown_out_of_bounds_is_none():
    selector = weighing({})

    def thrown(_start: CandidateModel, _believed: frozenset[str], _values: dict[str, np.ndarray]) -> CandidateModel:
        raise np.linalg.LinAlgError

    selector.refit = thrown
    assert selector._in_place(before("lag", "wash"), {"lag": [("dead_time", 1.0)]}) == {"lag": [("dead_time", np.inf)]}


def test_rivals_are_judged_without_what_was_taken_back():
    """Dead time was 5 nats behind a lag beside a wash that is gone; now it explains as much."""
    pairs = {("lag",): 60.0, ("dead_time",): 61.0, (): 0.0}
    selector = weighing({frozenset(k): v for k, v in pairs.items()})
    causes = [hopeful("lag"), hopeful("wash")]
    whole = Selection(before(), before("lag", "wash"), causes, [], {"lag": [("dead_time", 5.0)]})
    assert selector.without(whole, {"wash"}).rivals == {"lag": [("dead_time", 0.0)]}


def test_pieces_of_a_log_tell_no_more_of_a_bias_than_the_log():
    """What one log's accelerometers may have is no cause: its standard error is nearly that of a bias as drawn."""
    sigma, errors = VESSEL.sensors.imu.accel_bias_sigma_m_s2, []
    for runs in ([short()], parts(short(), [(10.0 * k, 10.0 * k + 8.0) for k in range(4)])):
        fit = PosteriorFit(EffectPhysics(runs, VESSEL, 1.0), catalogue(VESSEL, runs), stated_noise(VESSEL, runs))
        selector = Selector(fit)
        (bias,) = selector.of(selector.base(), ["accel_bias"]).causes
        errors.append(np.sqrt(np.diag(bias.covariance)))
    assert errors[1] == pytest.approx(errors[0], rel=0.03) and (errors[0] > 0.85 * sigma).all()


def test_what_does_not_stand_without_a_cause_that_is_taken_back_goes_too():
    """The lag is too small without the wash, and the refit that counts is the one without both."""
    selector = Selector(bench()[0])
    there = {"wash", "lag", "payload"}
    tried: list[frozenset[str]] = []
    selector.refit = lambda _start, believed, _values: tried.append(believed) or before(*believed)
    selector._judged = lambda _model, id_: hopeful(id_, 0.5 if id_ == "lag" else 8.0)
    selector.complete = lambda _model: None
    rivals = {"lag": [("dead_time", 1.0)], "payload": []}
    whole = Selection(before(), before(*there), [hopeful(id_) for id_ in sorted(there)], [], rivals)
    left = selector.without(whole, {"wash"})
    assert [c.id for c in left.causes] == ["payload"] and left.final.believed == {"payload"}
    assert tried == [{"lag", "payload"}, {"payload"}] and left.rivals == {"payload": []}


def test_two_causes_of_which_one_contains_the_other_are_not_believed_together():
    fit, _ = bench()
    with pytest.raises(ValueError, match="'turning_current' or 'current', not both"):
        search(fit, believed=("current", "turning_current"))


def test_causes_of_chance_that_are_there_for_sure_are_reported_however_small():
    """Of a calm log (seed 21), which shows none of them; a gusty wind stands for the wind."""
    fit = PosteriorFit(EffectPhysics([short()], VESSEL, 1.0), catalogue(VESSEL, [short()]), stated_noise(VESSEL))
    found = search(fit, believed=("waves", "gusty_wind", "nlos"))
    assert {c.effect.name for c in found.causes} == {"waves", "gusty_wind", "nlos"}
    for cause in found.causes:
        se = np.sqrt(np.diag(cause.candidate.covariance))
        assert 0 <= cause.candidate.lower < 1 and 0 < se[0] < 10 * cause.effect.parameters[0].smallest


def test_causes_that_no_sensor_shows_are_refused():
    none = pl.lit(None, dtype=pl.Float64)
    deaf = Run(short().table.with_columns(ax_m_s2=none, ay_m_s2=none), short().meta)
    fit = PosteriorFit(EffectPhysics([deaf], VESSEL, 1.0), catalogue(VESSEL, [deaf]), stated_noise(VESSEL))
    with pytest.raises(ValueError, match="believe 'waves': accelerations alone show it, and these logs have none"):
        search(fit, believed=("lag", "waves"))


def test_an_unknown_hook_is_refused():
    with pytest.raises(ValueError, match="unknown hook 'drag'"):
        Effect("x", "hull", "", "", (EffectParameter("p", "1", 1, 1, 1),), {"drag": lambda p: p})


def test_two_entries_of_one_name_are_refused():
    mine = Effect("lag", "hull", "", "", (EffectParameter("p", "1", 1, 1, 1),), {"force": lambda p, scene: 0.0})
    with pytest.raises(ValueError, match="'lag' is in the catalogue twice"):
        catalogue(VESSEL, [short()], [mine])


def found_in(true, seconds: float = 120.0, weather: Weather | None = None) -> dict[str, np.ndarray]:
    runs = [teleop_run(true, seed, seconds, uwb_hz=5.0, sigma_m=0.07, weather=weather) for seed in (31, 32)]
    fit = PosteriorFit(EffectPhysics(runs, VESSEL, 1.0), catalogue(VESSEL, runs), stated_noise(VESSEL))
    return {c.id: c.values for c in Selector(fit).run().causes}


@pytest.mark.long
def test_nothing_is_named_where_nothing_is_hidden():
    assert found_in(boat("aritra")) == {}


@pytest.mark.long
def test_a_weak_thruster_and_a_current_are_named_together_with_their_sizes():
    v = boat("aritra")
    weak = [msgspec.structs.replace(t, gain=0.75) if t.name == "rear_port" else t for t in v.thrusters]
    found = found_in(msgspec.structs.replace(v, thrusters=tuple(weak)), weather=Weather(V_c_m_s=0.08, beta_c_deg=60.0))
    assert set(found) == {"thruster_gain:rear_port", "current"}
    assert found["thruster_gain:rear_port"] == pytest.approx([-0.25], abs=0.03)
    assert found["current"] == pytest.approx([0.04, 0.0693], abs=0.004)


@pytest.mark.long
def test_late_positions_are_not_taken_for_lag():
    v = boat("aritra")
    uwb = msgspec.structs.replace(v.sensors.uwb, latency_s=v.sensors.uwb.latency_s + 0.15)
    found = found_in(msgspec.structs.replace(v, sensors=msgspec.structs.replace(v.sensors, uwb=uwb)))
    assert set(found) == {"uwb_latency"}
    assert found["uwb_latency"] == pytest.approx([0.15], abs=0.015)


def test_a_users_own_entry_acts_as_it_says():
    """From outside the package: a keel that pushes sideways in proportion to surge."""

    def keel(p, scene):
        out = np.zeros((*scene.t_s.shape, 3))
        out[..., 1] = p["k_N_s_m"] * scene.u_m_s
        return out

    mine = Effect(
        "keel", "hull", "Y += k u", "crabs", (EffectParameter("k_N_s_m", "N s/m", 20.0, 2.0, 0.6),), {"force": keel}
    )
    runs = [short()]
    own = PosteriorFit(EffectPhysics(runs, VESSEL, 1.0), catalogue(VESSEL, runs, [mine]), stated_noise(VESSEL))
    theta = {"keel": np.array([8.0])}
    state = own.physics.move(own.effects, theta, own.z0, None)
    plain = own.physics.move(own.effects, {}, own.z0, None)
    pushed = (state.tau - plain.tau)[..., 1]
    assert pushed == pytest.approx(8.0 * state.x[..., 3], abs=0.3)
    assert replace(mine, origin={"k_N_s_m": 1.0}).everyday is False
