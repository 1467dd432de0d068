"""What is left over: window columns against the engine's own, faults put into logs found by what they depend on.

Logs are simulated (`teleop_run`, seeds stated).
"""

from __future__ import annotations

import dataclasses
import shlex
from collections.abc import Callable, Sequence
from functools import cache

import numpy as np
import polars as pl
import pytest
from msgspec.structs import replace

from companion.__main__ import main
from companion.core.configuration.vessel_file import VesselFile
from companion.core.model.manoeuvring import mass_matrix
from companion.logs.readers.table import write_run
from companion.logs.runs.run import Run
from sim.fitting.diagnose.catalogue import catalogue, unaware
from sim.fitting.diagnose.catalogue.effect import Effect, EffectParameter
from sim.fitting.diagnose.posterior.fit import PosteriorFit
from sim.fitting.diagnose.posterior.noise import stated_noise
from sim.fitting.diagnose.posterior.physics import EffectPhysics
from sim.fitting.diagnose.report.sentences import WORDS
from sim.fitting.diagnose.residual_basis import Group, groups_at, widened
from sim.fitting.diagnose.selection.adequacy import (
    FAR_OUT,
    OFTEN,
    UnexplainedForce,
    adequacy,
    depends_on,
    far_out,
    left_over,
)
from sim.fitting.diagnose.selection.candidate_score import Candidate
from sim.fitting.diagnose.selection.masking import Echoes
from sim.fitting.diagnose.selection.model import CandidateModel
from sim.fitting.diagnose.selection.select import Selection, Selector
from sim.fitting.engine.noise import BIAS_AX, LATENT, OFFSET, L
from sim.studies.boats.draw import in_still_air
from sim.world.teleop_log import teleop_run
from tests.support.vessel_fixtures import BOATS, boat

VESSEL = in_still_air(boat("aritra"))
UNIT = (EffectParameter("a", "", 1.0, 1.0, 0.01),)


@cache
def drive(seed: int = 21, seconds: float = 100.0) -> Run:
    return teleop_run(boat("aritra"), seed, seconds, uwb_hz=5.0, sigma_m=0.07)


def bench(run: Run, without: Sequence[str] = ()) -> tuple[PosteriorFit, CandidateModel]:
    fit = PosteriorFit(
        EffectPhysics([run], VESSEL, 1.0), unaware(catalogue(VESSEL, [run]), without), stated_noise(VESSEL)
    )
    return fit, Selector(fit).base()


@cache
def clean() -> tuple[PosteriorFit, CandidateModel]:
    return bench(drive())


@cache
def faulty(fault) -> tuple[PosteriorFit, CandidateModel]:
    return bench(fault(drive()))


def shifted(effect_nodes: np.ndarray) -> Group:
    return Group(("time",), Effect("one", "generic", "one", "", UNIT, {}), effect_nodes[:, :, None])


def _heading(p, scene, y):
    out = y.copy()
    out[..., 0] += p["a"]
    return out


def _surge(p, scene, y):
    out = y.copy()
    out[..., 2] += p["a"]
    return out


def _push(p, scene):
    return p["a"] * np.ones((*scene.t_s.shape, 1)) * (mass_matrix(VESSEL) @ np.array([0.3, -0.2, 0.5]))


def _east(p, sight, place):
    return place + p["a"] * np.array([0.0, 1.0])


@pytest.mark.parametrize(
    ("hooks", "entry", "value"),
    [
        ({"imu": _heading}, OFFSET, 1.0),
        ({"imu": _surge}, BIAS_AX, 1.0),
        ({"force": _push}, LATENT, np.array([0.3, -0.2, 0.5])),
        ({"tag": _east}, 1, 1.0),
    ],
)
def test_what_moves_a_node_is_what_the_engine_would_have_made_of_it(hooks, entry, value):
    """Oracle: the engine's own column of an effect that does the same."""
    fit, model = clean()
    effect = Effect("same", "test", "", "", UNIT, hooks)
    wanted = fit.lineariser.point(
        fit.effects, model.point.theta, model.point.z, model.noise, [effect], model.point.state
    )
    nodes = np.zeros((len(model.point.z), L))
    nodes[:, entry] = value
    found = widened(model.point, (shifted(nodes),))
    whole = np.zeros_like(found.chain.B[:, :, -1]) + wanted.chain.B[:, :, 0]
    scale = np.abs(whole).max(axis=0) + 1e-9
    assert (np.abs(found.chain.B[:, :, -1] - whole) <= 0.03 * scale).all()
    assert found.chain.D[-1, -1] == pytest.approx(wanted.chain.D[0, 0], rel=0.03)
    assert found.chain.d[-1] == pytest.approx(wanted.chain.d[0], rel=0.05, abs=0.05 * np.sqrt(wanted.chain.D[0, 0]))
    off = np.abs(found.ties.G[:, :, -1] - wanted.ties.G[:, :, 0]).max(axis=0)
    assert (off <= 0.03 * np.abs(wanted.ties.G[:, :, 0]).max() + 1e-9).all()


def test_groups_have_known_words_and_do_something():
    fit, model = clean()
    groups = groups_at(fit.physics, model.point)
    assert len({g.effect.id for g in groups}) == len(groups)
    for group in groups:
        assert {w.partition(":")[0] for w in group.words} <= set(WORDS)
        assert (group.nodes is None) == bool(group.effect.hooks)
        nodes = group.of_means(fit.physics, model.point, fit.effects).nodes
        assert nodes is not None and nodes.shape == (*model.point.z.shape, len(group.effect.parameters))
        assert (np.abs(nodes).max(axis=(0, 1)) > 0).all() and np.isfinite(nodes).all()


def test_shares_of_the_hull_are_of_the_hull_as_it_is_found():
    """A hull with half as much drag again: a share of it is half as much again."""
    fit, model = clean()
    (drag,) = (g for g in groups_at(fit.physics, model.point) if g.effect.equation == "damping")
    fouled = {**model.point.theta, "hull_fouling": np.array([0.5])}
    state = fit.physics.move(fit.effects, fouled, model.point.z, model.point.state)
    point = dataclasses.replace(model.point, theta=fouled, state=dataclasses.replace(state, x=model.point.state.x))
    before, after = (drag.of_means(fit.physics, p, fit.effects).nodes for p in (model.point, point))
    more = 1.5 / (1 + model.point.theta["hull_fouling"][0])
    np.testing.assert_allclose(after, more * before, atol=0.02 * np.abs(before).max())


def test_a_force_that_does_not_vary_within_windows_is_its_mean():
    fit, model = clean()
    pushed = Group(("speed",), Effect("one", "generic", "one", "", UNIT, {"force": _push}))
    nodes = pushed.of_means(fit.physics, model.point, fit.effects).nodes
    assert nodes is not None
    np.testing.assert_allclose(nodes[:, LATENT, 0], np.tile([0.3, -0.2, 0.5], (len(nodes), 1)), rtol=0.02)
    assert not np.delete(nodes, LATENT, axis=1).any()


def test_nothing_is_left_over_of_a_boat_that_is_as_believed():
    fit, model = clean()
    found = adequacy(fit, Selection(model, model, [], []), None)
    report = found.adequacy
    assert report.passed and not report.depends_on and not found.doubtful and not found.withdrawn
    assert any(c.decides for c in report.checks) and any(not c.decides for c in report.checks)


def _magnet(run: Run) -> Run:
    """The compass is 6 degrees off in one half of the basin."""
    table = run.table.with_columns(pl.col("north_m", "east_m").interpolate().forward_fill().backward_fill())
    off = np.radians(6.0) * np.tanh(table["north_m"].to_numpy() - float(table["north_m"].mean()))  # type: ignore[arg-type]  # a float column
    wrong = run.table["psi_rad"].to_numpy() + off
    wrapped = pl.Series(np.arctan2(np.sin(wrong), np.cos(wrong))).fill_nan(None)
    return Run(run.table.with_columns(psi_rad=wrapped), run.meta)


def _ageing(run: Run) -> Run:
    """The accelerometer warms up: a_x gains 0.3 m/s^2 in the middle of the log."""
    t = run.table["t_s"].to_numpy()
    bump = 0.3 * np.exp(-(((t - t.mean()) / 15.0) ** 2))
    return Run(run.table.with_columns(ax_m_s2=pl.col("ax_m_s2") + pl.Series(bump)), run.meta)


def _leaning(run: Run) -> Run:
    """The tag's place is wrong by 0.3 m to the side that the boat turns to."""
    table = run.table.with_columns(pl.col("psi_rad", "r_rad_s").interpolate().forward_fill().backward_fill())
    side = 0.6 * table["r_rad_s"].to_numpy()
    psi = table["psi_rad"].to_numpy()
    return Run(run.table.with_columns(
        north_m=pl.col("north_m") - pl.Series(side * np.sin(psi)),
        east_m=pl.col("east_m") + pl.Series(side * np.cos(psi))), run.meta)  # fmt: skip


@pytest.mark.parametrize(
    ("fault", "word", "kind"),
    [
        (_magnet, "position", "heading error over position"),
        (_ageing, "time", "a_x error over time"),
        (_leaning, "speed", "place error over speed"),
    ],
)
def test_what_no_entry_explains_is_found_by_what_it_depends_on(fault, word, kind):
    fit, model = faulty(fault)
    report = adequacy(fit, Selection(model, model, [], []), None).adequacy
    assert not report.passed and report.depends_on[0] == word
    worst = max((c for c in report.checks if c.decides), key=lambda c: c.value)
    assert worst.name == f"{kind} [nats]"


@cache
def other(changed: Callable[[VesselFile], VesselFile], *without: str) -> tuple[PosteriorFit, CandidateModel]:
    """Logs of a boat that is not as the file has it, and a catalogue that lacks some entries."""
    vessel = boat("aritra")
    return bench(teleop_run(changed(vessel), 21, 100.0, uwb_hz=5.0, sigma_m=0.07, believed=vessel), without)


def propelled(**more: float) -> Callable[[VesselFile], VesselFile]:
    return lambda vessel: replace(vessel, propulsion=replace(
        vessel.propulsion, **{k: (getattr(vessel.propulsion, k) or 0.0) + v for k, v in more.items()}))  # fmt: skip


@pytest.mark.parametrize("more", [{"lag_s": 0.12}, {"dead_time_s": 0.12}, {"slew_N_s": 15.0}])
def test_thrust_that_comes_later_is_told_from_drag(more):
    fit, model = other(propelled(**more), "lag", "dead_time", "rate_limit")
    report = adequacy(fit, Selection(model, model, [], []), None).adequacy
    assert not report.passed and report.depends_on[0] == "thruster"
    worst = max((c for c in report.checks if c.decides), key=lambda c: c.value)
    assert worst.name in ("past thrust, all [nats]", "thrust after changes, all [nats]")


def _obstructed(run: Run) -> Run:
    """One fix in fifteen is 1 m too far north. Seed 5."""
    off = np.random.default_rng(5).uniform(size=run.table.height) < 1 / 15
    return Run(run.table.with_columns(north_m=pl.col("north_m") + pl.Series(1.0 * off)), run.meta)


def test_fixes_far_out_are_something_left_over_unless_a_cause_explains_them():
    fit, model = faulty(_obstructed)
    selection = Selection(model, model, [], [])
    share = far_out(model.point)
    assert 0.04 < share.value < 0.09 and share.limit == OFTEN and f"{FAR_OUT:g}" in share.name
    report = adequacy(fit, selection, None).adequacy
    assert not report.passed and report.depends_on == ("position",)
    assert share.name not in {c.name for c in adequacy(fit, selection, None, Echoes(far_out=True)).adequacy.checks}
    assert far_out(clean()[1].point).passed


def test_three_names_for_one_thing_are_withdrawn():
    """All thrusters give a quarter less, said to be more drag of a heavier boat."""
    fit, base = other(_weaker)
    mass = VESSEL.inertia.mass_kg
    said = {"hull_fouling": 0.33, "payload": 0.33 * mass, "yaw_inertia": 0.33 * mass_matrix(VESSEL)[2, 2]}
    final = Selector(fit).refit(base, frozenset(said), {k: np.array([v]) for k, v in said.items()})
    found = adequacy(fit, selected(base, final, *said), None)
    assert found.withdrawn == found.outdone == set(said) and not found.adequacy.passed
    assert found.adequacy.depends_on[0] == "thruster"
    known = adequacy(fit, selected(base, final, *said), None, known=True)
    assert not known.withdrawn and known.adequacy.checks != found.adequacy.checks, "of what stands beside the causes"


def _weaker(vessel: VesselFile) -> VesselFile:
    return replace(vessel, thrusters=tuple(replace(t, gain=0.75 * t.gain) for t in vessel.thrusters))


def named(group_name: str, word: str) -> Group:
    return Group((word,), Effect(group_name, "generic", "", "", UNIT, {}), np.zeros((2, L, 1)))


def test_what_is_left_over_without_the_echoes_of_the_best():
    a, b, c, d = (named(n, w) for n, w in (("a", "heading"), ("b", "time"), ("c", "speed"), ("d", "load")))
    found = UnexplainedForce(((a, 100.0), (b, 30.0), (c, 19.0), (d, -2.0)), 0.0, {"tether": frozenset("b")}, {})
    assert found.counted == (a, b)
    assert found.is_akin("tether", found.counted) and not found.is_akin("lag", found.counted)
    assert not UnexplainedForce(((a, 11.0), (b, 3.0)), 0.0, {}, {}).counted


def test_what_explains_more_of_the_base_comes_first():
    a, b, c = (named(n, w) for n, w in (("a", "heading"), ("b", "thruster:x"), ("c", "time")))
    after = UnexplainedForce(((a, 50.0), (b, 40.0), (c, 3.0)), 0.0, {}, {})
    before = UnexplainedForce(((c, 900.0), (b, 800.0), (a, 100.0)), 0.0, {}, {})
    assert depends_on(after, before) == ("thruster:x", "heading")
    assert depends_on(after, after) == ("heading", "thruster:x")


def selected(model: CandidateModel, after: CandidateModel, *ids: str) -> Selection:
    causes = [Candidate(i, 100.0, 100.0, np.ones(1), np.eye(1), 3.0, 2.0) for i in ids]
    return Selection(model, after, causes, [])


def test_a_cause_that_the_logs_do_not_ask_for_is_withdrawn():
    fit, model = clean()
    found = adequacy(fit, selected(model, model, "gyro_scale"), None)
    assert found.withdrawn == {"gyro_scale"} and not found.outdone and found.adequacy.passed


def test_a_cause_that_is_there_stands():
    table = drive().table
    run = Run(table.with_columns(r_rad_s=pl.col("r_rad_s") * 1.08), drive().meta)
    fit, base = bench(run)
    selector = Selector(fit)
    final = selector.refit(base, frozenset({"gyro_scale"}), {"gyro_scale": np.array([0.08])})
    found = adequacy(fit, selected(base, final, "gyro_scale"), None)
    assert not found.withdrawn and not found.doubtful and found.adequacy.passed


def test_causes_that_one_group_outdoes_stand_in_for_it():
    """What the compass does in one half of the basin, said to be an offset of the heading everywhere."""
    fit, base = faulty(_magnet)
    final = Selector(fit).refit(base, frozenset({"heading_offset"}), {"heading_offset": np.array([3.0])})
    found = adequacy(fit, selected(base, final, "heading_offset"), None)
    assert found.withdrawn == {"heading_offset"} and not found.adequacy.passed
    assert found.adequacy.depends_on[0] == "position"


def test_a_cause_is_akin_to_the_group_that_can_stand_in_for_it():
    fit, model = clean()
    name = "thruster_gain:front_port"
    at = next(i for i, e in enumerate(model.chosen) if e.id == name)
    start = sum(len(e.parameters) for e in model.chosen[:at])
    theta = {**model.point.theta, name: np.array([0.05])}
    assert model.own.theta0[start] == model.point.theta[name][0]
    moved = CandidateModel(
        model.believed, _at_theta(fit, model, theta), model.noise, model.chosen, model.own, model.evidence
    )
    akin = left_over(fit, moved, [name]).akin[name]
    assert "generic:thrust, front_port" in akin
    assert not {i for i in akin if "error" in i or "rear" in i.partition(",")[2]}


def _at_theta(fit: PosteriorFit, model: CandidateModel, theta):
    return fit.point(theta, model.point.z, model.chosen)


def test_an_entry_can_be_left_out_by_name_or_head():
    entries = catalogue(VESSEL, [drive()])
    gone = unaware(entries, ["thruster_gain:front_port", "tether"])
    assert {e.name for e in entries} - {e.name for e in gone} == {"thruster_gain:front_port", "tether"}
    heads = {e.name for e in unaware(entries, ["thruster_gain"])}
    assert not any(n.startswith("thruster_gain") for n in heads) and "thruster_fouling:front_port" in heads
    with pytest.raises(ValueError, match=r"without 'teather': no such effect; there are .*tether"):
        unaware(entries, ["teather"])
    with pytest.raises(ValueError, match="base:M11_kg"):
        unaware(entries, ["base:M11_kg"])


def test_the_command_says_which_name_it_does_not_know(tmp_path, capsys):
    table = drive().table.select(c for c in drive().table.columns if not c.startswith("true_"))
    write_run(Run(table, drive().meta), tmp_path / "drive.csv")
    words = f"diagnose {tmp_path}/drive.csv --vessel {BOATS}/aritra.toml --without teather --out {tmp_path}/out"
    assert main(shlex.split(words)) == 2
    assert "without 'teather': no such effect; there are " in capsys.readouterr().err
