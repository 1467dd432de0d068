"""What a log tells apart, against evidences written out; straight lines against all axes; the manoeuvre planned.

Logs are flights of the vessel file's own boat (`fly_nominal`) where only the Hessian matters; seeds stated elsewhere.
"""

from __future__ import annotations

import shlex
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from companion.__main__ import main
from companion.boat.load_run import EXAMPLES
from companion.core.configuration.site_file import load_site
from companion.core.configuration.vessel_file import VesselFile
from companion.core.excitation.file import Excitation, load_excitation
from companion.logs.runs.run import Run
from sim.fitting.diagnose.catalogue import catalogue
from sim.fitting.diagnose.catalogue.effect import TOLERANCE, Effect, EffectParameter, parameter_slices
from sim.fitting.diagnose.posterior.evidence import Prior, ReducedNormalEquations
from sim.fitting.diagnose.posterior.fit import PosteriorFit
from sim.fitting.diagnose.posterior.noise import stated_noise
from sim.fitting.diagnose.posterior.physics import EffectPhysics
from sim.fitting.diagnose.report.confusion_picture import confusion
from sim.fitting.diagnose.selection.candidate_score import DECISIVE_NATS, LEAST_EVIDENCE_NATS
from sim.fitting.diagnose.selection.distinguishability import Distinguishability, distinguishability, manoeuvre_sentence
from sim.fitting.diagnose.selection.identifiability import MEDIUM, PairwiseEvidence, pairwise_evidence
from sim.fitting.diagnose.selection.manoeuvre import NOTHING, ManoeuvrePlan, ManoeuvrePlanner, at_rates
from sim.fitting.engine.noise import STATE, L
from sim.fitting.excite.information import true_nodes
from sim.fitting.excite.nominal import fly_nominal
from sim.fitting.identify.structured_fit import with_latent
from sim.studies.boats.draw import in_still_air
from sim.world.teleop_log import teleop_run
from tests.support.vessel_fixtures import boat

VESSEL = in_still_air(boat("aritra"))
SITE = load_site((EXAMPLES / "sites" / "basin.toml").read_text(), name="basin")
LIBRARY = load_excitation((EXAMPLES / "excitations" / "library.toml").read_text(), name="library")
NOISE = with_latent(stated_noise(VESSEL), np.full(3, 1e-3))
STRAIGHT = ("surge steps", "stop and reverse", "coast down")
RICH = ("surge steps", "strafe", "spin both ways", "multisine", "pulses")
FEW = ("surge steps", "spin both ways", "opposed thrusters")
ARM = "uwb_lever_arm"
PORT, STARBOARD = "thruster_gain:front_port", "thruster_gain:front_starboard"


def effect(
    id: str, *smallest: float, vector: bool = False, nonlinear: bool = False, same_as: tuple[str, ...] = ()
) -> Effect:
    numbers = tuple(EffectParameter(f"p{i}", "1", 10 * abs(s), s, 0.3 * s) for i, s in enumerate(smallest))
    return Effect(id, "hull", "", "", numbers, {}, vector=vector, nonlinear=nonlinear, same_as=same_as)


def catalogued(*effects: Effect) -> Any:
    """As much of a Fit as is asked for."""
    fit: Any = SimpleNamespace(effects=effects)
    fit.prior = lambda free, active: PosteriorFit.prior(fit, free, active)
    return fit


def plan_of(names: tuple[str, ...], times: int = 1) -> Excitation:
    return replace(LIBRARY, segments=tuple(s for s in LIBRARY.segments if s.name in names) * times)


def flown(excitation: Excitation, vessel: VesselFile = VESSEL) -> Run:
    run = fly_nominal(excitation, vessel, SITE, step_ns=50_000_000).run
    return Run(run.table.drop_nulls([f"pwm_{n}" for n in run.thrusters]), run.meta)


@cache
def judged(names: tuple[str, ...], times: int = 1) -> tuple[PosteriorFit, np.ndarray]:
    """A log and its Hessian: no variants of place and time, they only take time."""
    run = flown(plan_of(names, times))
    effects = [e for e in catalogue(VESSEL, [run]) if e.always_free]
    fit = PosteriorFit(EffectPhysics([run], VESSEL, 1.0), effects, NOISE)
    z = np.zeros((fit.physics.windows.size[0], L))
    z[:, STATE] = true_nodes(fit.physics.windows, run)
    return fit, fit.reduced(fit.point({}, z, effects), effects).H


def written_out(fit, H: np.ndarray, a: Effect, b: Effect | None, w: np.ndarray) -> float:
    """Evidence of "a, no b" less that of "b, no a" (None: of "no a"), at b = H w, by models that lack parameters."""
    values = []
    for there, gone in ((a, b), (b, a)):
        kept, sigma, at = [], [], 0
        for e in fit.effects:
            width = len(e.parameters)
            if e is not gone and (e.always_free or e is there):
                kept += range(at, at + width)
                sigma += [p.prior for p in e.parameters] if e is there else list(e.tolerance())
            at += width
        data = (H @ w)[kept]
        reduced = ReducedNormalEquations(H[np.ix_(kept, kept)], data, np.zeros(len(kept)), 0.0)
        values.append(reduced.evidence(Prior.zero_mean(np.array(sigma))))
    return values[0] - values[1]


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_nats_are_differences_of_evidence_at_the_worst_direction(seed):
    rng = np.random.default_rng(seed)
    fit = catalogued(effect("one", 0.3), effect("two", 0.5, 0.5, vector=True), effect("far", 0.4, nonlinear=True))
    J = rng.normal(size=(9, 4)) * 3
    H = J.T @ J
    found = pairwise_evidence(fit, H)
    one, two, far = fit.effects
    only = np.array([MEDIUM * 0.3, 0, 0, 0])
    assert found.nothing[0] == pytest.approx(written_out(fit, H, one, None, only), abs=1e-6)
    assert found.nats[0, 1] == pytest.approx(written_out(fit, H, one, two, only), abs=1e-6)
    assert found.nats[0, 2] == pytest.approx(written_out(fit, H, one, far, only), abs=1e-6)
    angles = np.linspace(0, np.pi, 121)
    around = MEDIUM * 0.5 * np.stack([0 * angles, np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    worst = min(written_out(fit, H, two, one, w) for w in around)
    assert found.nats[1, 0] <= worst + 1e-6
    assert found.nats[1, 0] == pytest.approx(worst, rel=5e-3, abs=5e-3)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_causes_with_the_same_columns_are_never_told_apart(seed):
    rng = np.random.default_rng(seed)
    column, other = rng.normal(size=(2, 30)) * 20
    J = np.stack([column, column, other], axis=1)
    found = pairwise_evidence(catalogued(effect("one", 0.3), effect("twin", 0.3), effect("other", 0.2)), J.T @ J)
    assert found.nats[0, 1] == pytest.approx(0.0, abs=1e-6) and found.nats[1, 0] == pytest.approx(0.0, abs=1e-6)
    assert found.nothing[0] < (MEDIUM / TOLERANCE) ** 2 / 2, "the twin may explain it, that far out of its band"


def test_what_could_have_been_named_is_not_said_to_be_hidden():
    """From 9 nats a cause is named; a pair takes 12, which a cause that gives less itself cannot reach."""
    nats = np.full((3, 3), 11.0)
    np.fill_diagonal(nats, np.nan)
    found = PairwiseEvidence(
        ("one", "two", "three"),
        nats,
        np.array([LEAST_EVIDENCE_NATS - 0.1, LEAST_EVIDENCE_NATS + 0.1, DECISIVE_NATS + 0.1]),
    )
    assert found.hidden == ["one"]
    assert {p[0] for p in found.confused} == {"three"}


def test_a_manoeuvre_shows_a_cause_from_where_it_would_be_named():
    ten = ((ARM, NOTHING, 3.0, 10.0), (PORT, STARBOARD, 3.0, 10.0))
    text = manoeuvre_sentence(ManoeuvrePlan(LIBRARY, 60.0, ten, (("wash", NOTHING, 0.0, 8.9),)))
    assert text.startswith(f"These logs cannot show {ARM} of medium size (3 nats); 60 s of ")
    assert f"would show wash of medium size nor tell {PORT} from {STARBOARD} (at most 10 nats)" in text


def test_one_class_is_no_pair():
    H = np.diag([1e3, 1e3, 1e3])
    found = pairwise_evidence(
        catalogued(effect("one", 0.3, same_as=("two",)), effect("two", 0.3), effect("three", 0.3)), H
    )
    assert np.isnan(found.nats[0, 1]) and np.isnan(found.nats[1, 0]) and np.isnan(np.diag(found.nats)).all()
    assert np.isfinite(found.nats[0, 2])


def test_a_cause_alone_has_no_rival():
    found = pairwise_evidence(catalogued(effect("one", 0.3)), np.diag([1e3]))
    assert np.isnan(found.nats).all() and not found.pairs() and found.nothing[0] > DECISIVE_NATS


@pytest.mark.parametrize("times", [2, 4])
def test_a_longer_log_tells_more(times):
    fit, H = judged(STRAIGHT)
    short, long = pairwise_evidence(fit, H), pairwise_evidence(fit, times * H)
    known = np.nan_to_num(short.nats) > 1
    assert known.sum() > 100
    assert (long.nats[known] > short.nats[known] - 2).all(), "no more than the price of knowing better"
    assert np.median(long.nats[known] / short.nats[known]) > 1.1
    assert set(long.hidden) <= set(short.hidden)


@pytest.mark.long
def test_straight_lines_confuse_and_hide_what_all_axes_tell():
    straight = pairwise_evidence(*judged(STRAIGHT, 2))
    rich = pairwise_evidence(*judged(RICH))
    both = {frozenset(p[:2]) for p in straight.confused}
    assert frozenset((PORT, STARBOARD)) in both
    assert len(rich.confused) <= 1, "five minutes tell latency from drift, three do not"
    hidden = {"cg_shift", "cross_flow", "yaw_inertia", "gyro_scale", "uwb_lever_arm"}
    assert hidden <= set(straight.hidden) and len(straight.hidden) > 2 * len(rich.hidden)
    below = [sum(p[2] < DECISIVE_NATS for p in found.pairs()) for found in (straight, rich)]
    assert below[0] > 2 * below[1]


@cache
def planned() -> tuple[ManoeuvrePlanner, ManoeuvrePlan, PairwiseEvidence]:
    fit, H = judged(STRAIGHT)
    found = pairwise_evidence(fit, H)
    planner = ManoeuvrePlanner(fit, H, frozenset(), NOISE, SITE)
    mine = [p for p in found.confused if {p[0], p[1]} == {PORT, STARBOARD}]
    lost = [(n, NOTHING, float(found.nothing[found.names.index(n)])) for n in (ARM, "accel_bias")]
    return planner, planner.plan(plan_of(FEW), [*mine, *lost]), found


def test_the_manoeuvre_is_the_one_that_helps():
    _, plan, _ = planned()
    assert plan.excitation is not None
    (a, b, before, after), (arm, nothing, _, shown) = plan.pairs
    assert {a, b} == {PORT, STARBOARD} and before < DECISIVE_NATS < after
    assert (arm, nothing) == (ARM, NOTHING) and shown > DECISIVE_NATS
    names = {s.name for s in plan.excitation.segments}
    assert "spin both ways" in names and "surge steps" not in names, "no more of the same"
    assert [p[0] for p in plan.unreachable] == ["accel_bias"], "no manoeuvre shows what each log may have of its own"
    text = manoeuvre_sentence(plan)
    assert text.startswith(f"These logs cannot tell {a} from {b} (") and "manoeuvre.toml" in text
    assert "No manoeuvre of the library would show accel_bias of medium size" in text


@pytest.mark.parametrize("later_s", [0.0, 0.12])
def test_the_manoeuvre_is_planned_at_the_rates_of_samples_not_of_steps_of_integration(later_s):
    """A log with heading four times a second, rate and force so much later (seed 21)."""
    run = teleop_run(VESSEL, 21, 30.0, uwb_hz=5.0)
    table, t = run.table, pl.col("t_s")
    for columns, begin_s in ((("psi_rad",), 0.0), (("r_rad_s", "ax_m_s2", "ay_m_s2"), later_s)):
        turn = ((t - begin_s) * 4).floor()
        table = table.with_columns(
            pl.when(pl.col(c).is_not_null() & (turn != turn.shift(1))).then(pl.col(c)).alias(c) for c in columns
        )
    fit: Any = SimpleNamespace(physics=EffectPhysics([Run(table, run.meta)], VESSEL, 1.0))
    sensors = at_rates(fit).sensors
    assert sensors.imu.rate_Hz == pytest.approx(4.0, rel=0.05)
    assert sensors.uwb.rate_Hz == pytest.approx(5.0, rel=0.05)


def test_the_excite_command_takes_the_manoeuvre(tmp_path, capsys):
    planner, plan, found = planned()
    final = SimpleNamespace(reduced=SimpleNamespace(H=judged(STRAIGHT)[1]), active=frozenset(), noise=NOISE)
    selection: Any = SimpleNamespace(final=final, causes=[], rivals={})
    told = distinguishability(planner.fit, selection)
    assert told.plan is None and told.file == "" and told.record.manoeuvre == ""
    assert {(p.a, p.b) for p in told.record.pairs} >= {(a, b) for a, b, _ in found.confused}
    assert told.record.nothing["yaw_inertia"] < DECISIVE_NATS < told.record.nothing["current"]
    whole = Distinguishability(told.pairwise, told.record, plan)
    (tmp_path / "manoeuvre.toml").write_text(whole.file)
    words = f"excite info {tmp_path}/manoeuvre.toml --config {EXAMPLES}/aritra.toml"
    assert main(shlex.split(words)) == 0
    assert f"{plan.duration_s:.0f} s"[:2] in capsys.readouterr().out


def noisy(run: Run, seed: int) -> Run:
    """With the noise of the vessel file's sensors, and nobody's truth."""
    rng, (heading, rate, x, y) = np.random.default_rng(seed), NOISE.white
    size = {"psi_rad": heading, "r_rad_s": rate, "ax_m_s2": x, "ay_m_s2": y}
    size |= {"north_m": NOISE.fix_m, "east_m": NOISE.fix_m}
    table = run.table.with_columns(
        **{k: pl.col(k) + pl.Series(rng.normal(size=len(run.table)) * s) for k, s in size.items()}
    )
    table = table.with_columns(psi_rad=(pl.col("psi_rad") + np.pi) % (2 * np.pi) - np.pi)
    return Run(table.select(c for c in table.columns if not c.startswith("true_")), run.meta)


@pytest.mark.long
def test_flown_by_a_boat_that_has_the_cause_the_manoeuvre_shows_it():
    """Oracle: the engine's own evidence in noisy logs (seeds 1, 2) of a boat whose tag sits 0.12 m further ahead."""
    _, plan, _ = planned()
    assert plan.excitation is not None
    uwb = VESSEL.sensors.uwb
    moved = replace(VESSEL, sensors=replace(VESSEL.sensors, uwb=replace(uwb, x_m=uwb.x_m + 0.12)))
    logs = [
        noisy(flown(excitation, moved), seed) for excitation, seed in ((plan_of(STRAIGHT), 1), (plan.excitation, 2))
    ]
    nats = []
    for runs in (logs[:1], logs):
        effects = [e for e in catalogue(VESSEL, runs) if e.always_free]
        fit, at = PosteriorFit(EffectPhysics(runs, VESSEL, 1.0), effects, NOISE), parameter_slices(effects)[ARM]
        point = fit.solve({}, fit.z0, effects, frozenset(), steps=3)
        posterior = fit.reduced(point, effects).posterior(fit.prior(effects, frozenset()))
        nats.append(posterior.under_prior(at, Prior.zero_mean(np.full(2, 0.15)))[0] - posterior.nats_if_absent(at))
    assert nats[0] < DECISIVE_NATS < nats[1]


def test_the_map_shows_what_is_confused():
    names = ("one", "two", "three")
    nats = np.array([[np.nan, 3.0, 80.0], [4.0, np.nan, 70.0], [90.0, 100.0, np.nan]])
    figure = confusion(PairwiseEvidence(names, nats, np.array([30.0, 40.0, 99.0])))
    assert figure is not None
    ax = figure.axes[0]
    assert [t.get_text() for t in ax.get_yticklabels()] == ["one", "two"]
    assert [t.get_text() for t in ax.get_xticklabels()] == ["nothing", "one", "two"]
    assert [t.get_text() for t in ax.texts] == ["30", "3", "40", "4"]
    assert confusion(PairwiseEvidence(names, np.where(np.isfinite(nats), 90.0, nats), np.full(3, 99.0))) is None
