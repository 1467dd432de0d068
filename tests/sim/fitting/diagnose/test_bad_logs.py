"""Logs that are not as they should be: a clear refusal or the right cause, never another name nor a traceback.

The cases are those of tests/evidence/diagnose/survive.py (teleoperation of 100 s, seeds stated there); what must be
refused is refused in a moment, what is diagnosed takes seconds each.
"""

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from companion.logs.runs.run import Run
from companion.logs.runs.splits import part, parts
from sim.fitting.diagnose import job
from sim.fitting.diagnose.catalogue import catalogue
from sim.fitting.diagnose.catalogue.effect import Effect, EffectParameter, TagKinematics
from sim.fitting.diagnose.posterior.clock import LogClock
from sim.fitting.diagnose.posterior.fit import PosteriorFit
from sim.fitting.diagnose.posterior.noise import stated_noise
from sim.fitting.diagnose.posterior.physics import EffectPhysics
from sim.fitting.diagnose.posterior.readings import Readings
from sim.fitting.diagnose.posterior.state import WindowTrajectories
from sim.fitting.diagnose.preparation import subsampling
from sim.fitting.diagnose.preparation.swapped_columns import SLIPS, reject_swapped_columns
from sim.fitting.diagnose.selection import held_out, smoothed_logs
from sim.fitting.engine.split import JobError, split_at_pauses
from tests.evidence.diagnose import survive
from tests.support.vessel_fixtures import boat

QUICK = ("first rows before the first command",)
REFUSED = [case for case in survive.CASES if case.words]
DIAGNOSED = [case for case in survive.CASES if not case.words]


def good(uwb_hz: float = 5.0, spins: bool = False, name: str = "aritra") -> Run:
    return survive.log(name, "", survive.SEED, survive.SECONDS, uwb_hz, spins)


def other_good() -> Run:
    return survive.log("aritra", "", survive.SEED + 1, survive.SECONDS, 5.0, False)


@pytest.mark.parametrize("case", REFUSED, ids=lambda case: case.what)
@pytest.mark.long
def test_what_cannot_be_used_is_refused_by_file_and_column(case):
    found = survive.outcome(case)
    assert survive.holds(case, found), found.text


@pytest.mark.long
@pytest.mark.parametrize("case", [c for c in DIAGNOSED if c.what in QUICK], ids=lambda case: case.what)
def test_the_cause_is_found_all_the_same(case):
    found = survive.outcome(case)
    assert survive.holds(case, found), found.text


@pytest.mark.long
@pytest.mark.parametrize("case", [c for c in DIAGNOSED if c.what not in QUICK], ids=lambda case: case.what)
def test_the_cause_is_found_in_every_other_case(case):
    found = survive.outcome(case)
    assert survive.holds(case, found), found.text


@pytest.mark.matrix
@pytest.mark.long
def test_an_hours_log_takes_ten_minutes_at_most():
    found = survive.outcome(survive.HOUR)
    assert survive.holds(survive.HOUR, found), found.text
    assert found.cpu_s <= 60 * survive.MINUTES


@pytest.mark.parametrize("uwb_hz", [1.0, pytest.param(5.0, marks=pytest.mark.long)])
@pytest.mark.parametrize("spins", [False, pytest.param(True, marks=pytest.mark.long)])
@pytest.mark.parametrize("name", ["aritra", "twin"])
def test_good_columns_are_not_taken_for_others(uwb_hz, spins, name):
    reject_swapped_columns(good(uwb_hz, spins, name))


@pytest.mark.parametrize("slip", SLIPS)
def test_every_slip_is_told_by_its_columns(slip):
    places, forces = (np.linalg.inv(m) for m in SLIPS[slip])
    run = good()
    columns = [("north_m", "east_m"), ("ax_m_s2", "ay_m_s2")]
    new = {}
    for (one, other), m in zip(columns, (places, forces), strict=True):
        new[one] = m[0, 0] * pl.col(one) + m[0, 1] * pl.col(other)
        new[other] = m[1, 0] * pl.col(one) + m[1, 1] * pl.col(other)
    with pytest.raises(JobError) as refused:
        reject_swapped_columns(Run(run.table.with_columns(**new), run.meta))
    assert slip.partition(":")[0] in str(refused.value) and run.meta.source in str(refused.value)


def test_large_faults_of_sensors_are_not_taken_for_slips():
    """Heading 20 deg off, accelerometers biased by 0.2 m/s^2, positions 0.3 s late: not refused."""
    run = good()
    psi = pl.col("psi_rad") + np.radians(20.0)
    late = run.table.select(pl.col("t_s") + 0.3, "north_m", "east_m").drop_nulls()
    table = run.table.drop("north_m", "east_m").with_columns(
        psi_rad=pl.arctan2(psi.sin(), psi.cos()), ax_m_s2=pl.col("ax_m_s2") + 0.2, ay_m_s2=pl.col("ay_m_s2") - 0.2
    )
    table = table.join(late, on="t_s", how="full", coalesce=True).sort("t_s")
    held = [c for c in table.columns if c.startswith(("pwm_", "battery_v"))]
    reject_swapped_columns(Run(table.with_columns(pl.col(held).forward_fill()), run.meta))


@settings(max_examples=20, deadline=None)
@given(begin=st.floats(15.0, 60.0), length=st.floats(2.5, 20.0))
def test_a_pause_parts_a_log_and_no_measurement_is_lost(begin, length):
    run = good()
    paused = Run(survive.without_rows(begin, begin + length)(run.table), run.meta)
    pieces = split_at_pauses(paused)
    assert len(pieces) == 2
    for column in ("psi_rad", "north_m"):
        together = np.concatenate([piece.samples(column)[1] for piece in pieces])
        assert together == pytest.approx(paused.samples(column)[1])
    assert pieces[1].commands()[0][0] > begin, "what was commanded before the pause is not known to last"


def test_a_log_without_pause_stays_as_it_is():
    run = good()
    assert split_at_pauses(run) == [run]
    inside = part(run, 40.0, 80.0)  # with the commands of two seconds before, of which only changes are rows
    assert split_at_pauses(inside) == [inside]


def test_nothing_but_pauses_is_refused():
    run = good()
    rows = [run.table.filter(pl.col("t_s").is_between(a, a + 6.0)) for a in (0.0, 10.0, 20.0)]
    with pytest.raises(JobError, match="2 pauses and resets, the first at 6"):
        split_at_pauses(Run(pl.concat(rows), run.meta))


def again(run: Run, moved_s: float = 0.0, zero_s: int = 0) -> Run:
    """The same log as another, its t_s moved and its stamp set."""
    return Run(run.table.with_columns(pl.col("t_s") + moved_s), replace(run.meta, zero_ns=zero_s * 10**9))


def test_parts_of_one_log_keep_its_clock_and_logs_without_stamps_follow_one_another():
    run = good()
    pieces = [part(run, 0.0, 30.0), part(run, 70.0, 90.0, 0.0)]
    assert LogClock.of(pieces).start_s(pieces[1]) == pytest.approx(70.0, abs=0.1)
    since_1970 = again(run, 1.79e9)
    assert LogClock.of([since_1970]).start_s(since_1970) == 0.0
    halves = [run, part(again(run, zero_s=500), 50.0, 99.0, 0.0)]
    assert LogClock.of(halves).start_s(halves[1]) == pytest.approx(550.0, abs=0.1)
    other = again(run)
    assert LogClock.of([run, other]).start_s(other) == pytest.approx(run.duration_s)


@pytest.mark.parametrize("moved_s", [0.0, 1.79e9])
def test_nought_is_the_first_row_of_the_log_although_its_beginning_is_not_fitted(moved_s):
    """Onsets and directions that turn are told from there."""
    run, vessel = again(good(), moved_s), boat("aritra")
    late = part(run, moved_s + 40.0, moved_s + 99.0)
    physics = EffectPhysics([late], vessel, 1.0)
    assert physics.clock_s.min() == pytest.approx(40.0, abs=0.2)
    onsets = [e.origin["onset_s"] for e in catalogue(vessel, [late]) if e.name == "thruster_fouling:rear_port"]
    assert onsets and min(onsets) > 40.0
    first, second = again(run), again(run)
    both = [part(first, moved_s + 70.0, moved_s + 90.0, 0.0), part(second, moved_s + 20.0, moved_s + 60.0, 0.0)]
    starts = [LogClock.of(both).start_s(piece) for piece in both]
    assert starts == pytest.approx([70.0, run.duration_s + 20.0], abs=0.1), (
        "what is not fitted takes its time all the same"
    )


@pytest.mark.parametrize("block_s", [None, 25.0])
def test_what_is_held_out_of_a_fitted_log_is_on_its_clock(block_s):
    """Two logs without stamps: in turn, and pieces of each where they are in it."""
    data = job.data_of([again(good()), other_good()], (), boat("aritra"), block_s)
    second = good().duration_s
    for piece in (*data.fitted, *data.held_out):
        ahead = 0.0 if piece.whole is data.split.used[0].log.run else second
        assert data.clock.ahead_s(piece) == pytest.approx(ahead)
    assert {id(piece.whole) for piece in data.held_out} == {id(used.log.run) for used in data.split.used}


def test_nought_is_the_first_log_although_nothing_of_it_is_fitted(monkeypatch):
    """Of many long logs a short one may get no piece."""
    monkeypatch.setattr(subsampling, "LONGEST_S", 100.0)
    monkeypatch.setattr(subsampling, "PIECE_S", 75.0)
    data = job.data_of([again(good()), other_good()], (), boat("aritra"), None)
    (piece,) = data.fitted
    assert data.clock.start_s(piece) == pytest.approx(good().duration_s)


def test_logs_that_are_held_out_follow_where_no_stamps_place_them():
    logs, out = [good(), other_good()], [again(good()), again(good())]
    starts = [LogClock.of(logs, out).start_s(run) for run in out]
    assert starts == pytest.approx([s + sum(run.duration_s for run in logs) for s in (0.0, good().duration_s)])
    early = again(good(), zero_s=-500)
    assert LogClock.of([again(good(), zero_s=100)], [early]).start_s(early) == pytest.approx(-600.0)


def test_stamps_that_overlap_tell_nothing():
    """Logs of 100 s since two boots, or by two clocks, follow one another; parts that a user cut keep their clock."""
    run = good()
    one, two = again(run, zero_s=30), again(run, zero_s=90)
    assert LogClock.of([one, two]).begins_s == pytest.approx((0.0, run.duration_s))
    assert LogClock.of([one], [two]).begins_s == pytest.approx((0.0, run.duration_s))
    later = again(run, zero_s=230)
    assert LogClock.of([two, later], [one]).begins_s == pytest.approx((0.0, 140.0, 140.0 + run.duration_s))
    unix = Run(run.table, replace(run.meta, zero_ns=10**18, clock="another"))
    assert LogClock.of([one, unix]).begins_s == pytest.approx((0.0, run.duration_s))
    halves = [
        Run(half.table, half.meta)
        for half in parts(again(run, 1.79e9), [(1.79e9, 1.79e9 + 50), (1.79e9 + 50, 1.79e9 + 99)])
    ]
    assert LogClock.of(halves).start_s(halves[1]) == pytest.approx(48.0, abs=0.1), (
        "with the commands of two seconds before"
    )


def test_held_out_readings_are_judged_on_the_clock_of_the_fitted_logs():
    vessel, run = boat("aritra"), good()
    clock = LogClock.of([run])
    training = EffectPhysics([part(run, 0.0, 60.0)], vessel, 1.0, clock)
    seen = []

    def kept(p, scene):
        seen.append(float(scene.clock_s.min()))
        return np.zeros((*scene.t_s.shape, 3))

    mine = Effect("mine", "hull", "", "", (EffectParameter("p", "1", 1.0, 1.0, 1.0),), {"force": kept})
    believed = smoothed_logs.ModelUnderTest({"mine": np.ones(1)}, stated_noise(vessel))
    held_out.score([part(run, 60.0, 99.0)], vessel, [mine], dict.fromkeys(held_out.MODELS, believed), training, 0)
    assert seen and min(seen) == pytest.approx(60.0, abs=0.2)


def test_a_clock_drifts_from_the_first_position_of_its_log_in_findings_and_files():
    """Also in a part of a log whose time is counted from 1970, where t_s itself times the drift is weeks."""
    vessel, run = boat("aritra"), again(good(), 1.79e9)
    late, drift = part(run, 1.79e9 + 40.0, 1.79e9 + 99.0), 1e-5
    physics = EffectPhysics([late], vessel, 1.0)
    effect = next(e for e in catalogue(vessel, [late]) if e.name == "clock_drift")
    fit = PosteriorFit(physics, [effect], stated_noise(vessel))
    state, readings = physics.move([effect], {}, fit.z0, None), Readings(physics)
    plain, drifted = (readings.tag([effect], theta, state) for theta in ({}, {effect.id: np.array([drift])}))
    moved_m = np.linalg.norm(drifted - plain, axis=1)
    uwb = replace(vessel.sensors.uwb, clock_drift_s_s=drift)
    told = replace(vessel, sensors=replace(vessel.sensors, uwb=uwb))
    moved_s = physics.windows.fixes.t_s - EffectPhysics([late], told, 1.0).windows.fixes.t_s
    speed_m_s = np.linalg.norm(sight_of(readings, state).velocity_m_s, axis=1)
    assert moved_s.min() > 40.0 * 0.9 * drift
    assert moved_m == pytest.approx(speed_m_s * moved_s, abs=1e-6)


def sight_of(readings: Readings, state: WindowTrajectories) -> TagKinematics:
    """What hooks see of the tag."""
    seen = []
    look = Effect(
        "look", "sensors", "", "", (EffectParameter("p", "1", 1, 1, 1),), {"tag": lambda _p, s, _y: seen.append(s)}
    )
    readings.tag([look], {"look": np.ones(1)}, state)
    return seen[0]


def test_unknown_pulses_stay_unknown_when_an_effect_changes_pulses():
    run, believed = good(), boat("aritra")
    late = Run(survive.blank_between(0.0, 6.0, *survive.PULSES)(run.table), run.meta)
    fit = PosteriorFit(EffectPhysics([late], believed, 1.0), catalogue(believed, [late]), stated_noise(believed))
    swap = next(e for e in fit.effects if e.name == "swapped_pair:front_port+front_starboard")
    both = fit.physics.thrusters.forces([swap], {swap.id: np.array([1.0])}).f, fit.physics.thrusters.forces([], {}).f
    assert np.isfinite(both[0]).all() and both[0][..., [1, 0, 2, 3]] == pytest.approx(both[1])


def test_logs_of_two_days_get_no_more_entries_than_logs_of_one():
    run, vessel = good(), boat("aritra")
    one, two = (
        catalogue(vessel, [run]),
        catalogue(vessel, [run, Run(run.table, replace(run.meta, zero_ns=86400 * 10**9))]),
    )
    assert len(two) < len(one) + 120
    onsets = [e.origin["onset_s"] for e in two if e.name == "thruster_fouling:rear_port"]
    assert onsets and all(t <= run.duration_s or 86400 <= t <= 86400 + run.duration_s for t in onsets)


def test_starts_of_an_onset_in_a_short_piece_are_entries_of_their_own():
    runs = [part(good(), 0.0, 60.0), part(Run(good().table, replace(good().meta, zero_ns=int(36e11))), 0.0, 10.5)]
    for entry in (e for e in catalogue(boat("aritra"), runs) if e.start_entries):
        starts = entry.start_entries()
        assert len({e.id for e in starts}) == len(starts)


@pytest.mark.parametrize(
    ("begins_s", "length_s"), [((0.0, 86400.0), 100.0), (tuple(180.0 * k for k in range(20)), 50.0)]
)
def test_an_onset_is_looked_for_everywhere_in_logs_that_lie_far_apart_and_not_between_them(begins_s, length_s):
    """Two days, and the pieces of an hour."""
    runs = [part(Run(good().table, replace(good().meta, zero_ns=int(b * 1e9))), 0.0, length_s) for b in begins_s]
    entries = [e for e in catalogue(boat("aritra"), runs) if e.name == "thruster_fouling:rear_port"]
    starts = np.array([start.origin["onset_s"] for e in entries for start in e.start_entries()])
    for log in runs:
        begin_s = LogClock.of(runs).start_s(log)
        t = np.linspace(begin_s, begin_s + log.duration_s, 50)
        assert np.abs(t[:, None] - starts).min(axis=1).max() < 5.0
        starts = starts[(starts < begin_s - 0.1) | (starts > begin_s + log.duration_s + 0.1)]
    assert not len(starts)
