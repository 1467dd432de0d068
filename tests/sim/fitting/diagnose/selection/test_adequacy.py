"""Causes that a group of the residual basis outdoes, or that the logs do not ask for, are withdrawn."""

from __future__ import annotations

import shlex

import numpy as np
import polars as pl
import pytest
from msgspec.structs import replace

from companion.__main__ import main
from companion.core.configuration.vessel_file import VesselFile
from companion.core.model.manoeuvring import mass_matrix
from companion.logs.readers.table import write_run
from companion.logs.runs.run import Run
from sim.fitting.diagnose.catalogue import catalogue, without_effects
from sim.fitting.diagnose.catalogue.effect import Effect
from sim.fitting.diagnose.posterior.fit import PosteriorFit
from sim.fitting.diagnose.residual_basis import FunctionGroup
from sim.fitting.diagnose.selection.adequacy import (
    GroupEvidence,
    adequacy,
    depends_on,
    group_evidence,
)
from sim.fitting.diagnose.selection.candidate_score import Candidate
from sim.fitting.diagnose.selection.greedy_selection import Selection, Selector
from sim.fitting.diagnose.selection.model import CandidateModel
from sim.fitting.engine.noise import L
from tests.sim.fitting.diagnose.adequacy_fixture import (
    UNIT,
    VESSEL,
    bench,
    clean,
    compass_off_by_place,
    drive,
    faulty,
    other,
)
from tests.support.vessel_fixtures import BOATS


@pytest.mark.long
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


def named(group_name: str, word: str) -> FunctionGroup:
    return FunctionGroup((word,), Effect(group_name, "generic", "", "", UNIT, {}), np.zeros((2, L, 1)))


def test_what_is_left_over_without_what_the_best_masks():
    a, b, c, d = (named(n, w) for n, w in (("a", "heading"), ("b", "time"), ("c", "speed"), ("d", "load")))
    found = GroupEvidence(((a, 100.0), (b, 30.0), (c, 19.0), (d, -2.0)), 0.0, {"tether": frozenset("b")}, {})
    assert found.significant == (a, b)
    assert found.is_akin("tether", found.significant) and not found.is_akin("lag", found.significant)
    assert not GroupEvidence(((a, 11.0), (b, 3.0)), 0.0, {}, {}).significant


def test_what_explains_more_of_the_base_comes_first():
    a, b, c = (named(n, w) for n, w in (("a", "heading"), ("b", "thruster:x"), ("c", "time")))
    after = GroupEvidence(((a, 50.0), (b, 40.0), (c, 3.0)), 0.0, {}, {})
    before = GroupEvidence(((c, 900.0), (b, 800.0), (a, 100.0)), 0.0, {}, {})
    assert depends_on(after, before) == ("thruster:x", "heading")
    assert depends_on(after, after) == ("heading", "thruster:x")


def selected(model: CandidateModel, after: CandidateModel, *ids: str) -> Selection:
    causes = [Candidate(i, 100.0, 100.0, np.ones(1), np.eye(1), 3.0, 2.0) for i in ids]
    return Selection(model, after, causes, [])


@pytest.mark.long
def test_a_cause_that_the_logs_do_not_ask_for_is_withdrawn():
    fit, model = clean()
    found = adequacy(fit, selected(model, model, "gyro_scale"), None)
    assert found.withdrawn == {"gyro_scale"} and not found.outdone and found.adequacy.passed


@pytest.mark.long
def test_a_cause_that_is_there_stands():
    table = drive().table
    run = Run(table.with_columns(r_rad_s=pl.col("r_rad_s") * 1.08), drive().meta)
    fit, base = bench(run)
    selector = Selector(fit)
    final = selector.refit(base, frozenset({"gyro_scale"}), {"gyro_scale": np.array([0.08])})
    found = adequacy(fit, selected(base, final, "gyro_scale"), None)
    assert not found.withdrawn and not found.doubtful and found.adequacy.passed


@pytest.mark.long
def test_causes_that_one_group_outdoes_stand_in_for_it():
    """What the compass does in one half of the basin, said to be an offset of the heading everywhere."""
    fit, base = faulty(compass_off_by_place)
    final = Selector(fit).refit(base, frozenset({"heading_offset"}), {"heading_offset": np.array([3.0])})
    found = adequacy(fit, selected(base, final, "heading_offset"), None)
    assert found.withdrawn == {"heading_offset"} and not found.adequacy.passed
    assert found.adequacy.depends_on[0] == "position"


def test_a_cause_is_akin_to_the_group_that_can_stand_in_for_it():
    fit, model = clean()
    name = "thruster_gain:front_port"
    at = next(i for i, e in enumerate(model.free) if e.id == name)
    start = sum(len(e.parameters) for e in model.free[:at])
    theta = {**model.point.theta, name: np.array([0.05])}
    assert model.own.theta0[start] == model.point.theta[name][0]
    moved = CandidateModel(
        model.active, _at_theta(fit, model, theta), model.noise, model.free, model.own, model.evidence
    )
    akin = group_evidence(fit, moved, [name]).akin[name]
    assert "generic:thrust, front_port" in akin
    assert not {i for i in akin if "error" in i or "rear" in i.partition(",")[2]}


def _at_theta(fit: PosteriorFit, model: CandidateModel, theta):
    return fit.point(theta, model.point.z, model.free)


def test_an_entry_can_be_left_out_by_name_or_head():
    entries = catalogue(VESSEL, [drive()])
    gone = without_effects(entries, ["thruster_gain:front_port", "tether"])
    assert {e.name for e in entries} - {e.name for e in gone} == {"thruster_gain:front_port", "tether"}
    heads = {e.name for e in without_effects(entries, ["thruster_gain"])}
    assert not any(n.startswith("thruster_gain") for n in heads) and "thruster_fouling:front_port" in heads
    with pytest.raises(ValueError, match=r"without 'teather': no such effect; there are .*tether"):
        without_effects(entries, ["teather"])
    with pytest.raises(ValueError, match="base:M11_kg"):
        without_effects(entries, ["base:M11_kg"])


def test_what_logs_without_roll_and_pitch_cannot_show_may_be_left_out_of_them_all_the_same():
    unlevelled = drive()
    table = unlevelled.table.drop("phi_rad", "theta_rad", strict=False)
    entries = catalogue(VESSEL, [Run(table, unlevelled.meta)])
    assert "imu_lever_arm" not in {e.name for e in entries}
    gone = without_effects(entries, ["imu_lever_arm", "tether"])
    assert {e.name for e in entries} - {e.name for e in gone} == {"tether"}


def test_the_command_says_which_name_it_does_not_know(tmp_path, capsys):
    table = drive().table.select(c for c in drive().table.columns if not c.startswith("true_"))
    write_run(Run(table, drive().meta), tmp_path / "drive.csv")
    words = f"diagnose {tmp_path}/drive.csv --vessel {BOATS}/aritra.toml --without teather --out {tmp_path}/out"
    assert main(shlex.split(words)) == 2
    assert "without 'teather': no such effect; there are " in capsys.readouterr().err
