"""Roll and pitch level accelerometers, unless positions say that they follow the boat's own acceleration."""

from functools import cache

import numpy as np
import polars as pl
import pytest

from companion.core.geometry.frames import rotate
from companion.logs.runs.problems import BIASING
from companion.logs.runs.run import Run, RunMeta
from sim.fitting.diagnose.job import data_of
from sim.fitting.engine.split import NamedLog
from sim.fitting.identify.result import fit_structured
from sim.fitting.identify.structured_fit import FitSettings
from sim.fitting.wiring.accelerations import explained, second_differences, twice
from sim.fitting.wiring.correction import IMU
from sim.fitting.wiring.levelling import (
    LEFT_OUT,
    NEEDED,
    TILT,
    TIMES,
    UNIT,
    explained_levelled,
    levelled,
    split_levelled,
    tilt_is_false,
    tilt_unit_fault,
    unlevelled,
    without_tilt,
)
from sim.fitting.wiring.record import SURE_NATS
from tests.hidden import draw
from tests.hidden.write import log_table, record
from tests.sim.fitting.diagnose.posterior_fixture import VESSEL, short
from tests.sim.fitting.tilt_fixture import G, following_acceleration


@cache
def sound() -> Run:
    """120 s with a true attitude; seed 21."""
    return short(seconds=120.0)


@cache
def followed() -> Run:
    """The same, of an AHRS without GPS."""
    return following_acceleration(sound())


def levelling_nats(run: Run) -> float:
    sides = second_differences(run)
    return 0.0 if sides is None else sides.against_levelling_nats


def other() -> Run:
    """Another log of the same boat."""
    elsewhere = {c: pl.col(c) + 100.0 for c in ("north_m", "east_m")}
    return Run(followed().table.filter(pl.col("t_s") > 30.0).with_columns(**elsewhere), followed().meta)


def rolling(run: Run, degrees: float) -> Run:
    """The run of a hull that rolls and pitches with a period of 7 s, and says so: g sin(tilt) is felt, and told."""
    t = pl.col("t_s") * (2 * np.pi / 7.0)
    phi, theta = (np.radians(degrees) * f for f in (t.sin(), t.cos()))
    felt = {"ax_m_s2": pl.col("ax_m_s2") + G * theta.sin(), "ay_m_s2": pl.col("ay_m_s2") - G * phi.sin()}
    told = {"phi_rad": pl.col("phi_rad") + phi, "theta_rad": pl.col("theta_rad") + theta}
    return Run(run.table.with_columns(**felt, **told), run.meta)


def in_degrees(run: Run) -> Run:
    return Run(run.table.with_columns(pl.col(TILT) * (180.0 / np.pi)), run.meta)


@pytest.mark.parametrize("log", [sound, lambda: rolling(sound(), 1.0)])
def test_roll_and_pitch_in_degrees_are_asked_for_and_left_out(log):
    """Calm water: all of them are within pi, and pass for radians."""
    wrong = tilt_unit_fault(in_degrees(log()))
    assert wrong is not None and wrong.kind == UNIT and "phi_rad, theta_rad" in wrong.text and "degrees" in wrong.text
    logs = [NamedLog("degrees", in_degrees(log())), NamedLog("radians", other())]
    degrees, radians = levelled(logs)
    assert not set(TILT) & set(degrees.run.table.columns) and wrong in degrees.run.meta.notes
    assert unlevelled(degrees.run) == [] and wrong not in radians.run.meta.notes
    (used,) = split_levelled(logs[:1], [], VESSEL).used
    assert wrong in used.log.run.meta.notes and wrong.kind in BIASING


def test_radians_are_not_whether_noisy_false_or_of_a_hull_that_rolls():
    rng = np.random.default_rng(6)
    noise = {c: pl.col(c) + pl.Series(rng.normal(0.0, 0.02, len(sound().table))) for c in TILT}
    noisy = Run(sound().table.with_columns(**noise), sound().meta)
    for run in (sound(), followed(), rolling(sound(), 1.0), rolling(sound(), 6.0), noisy):
        assert tilt_unit_fault(run) is None


def test_a_hull_that_follows_the_surface_of_waves_leans_and_feels_nothing():
    """What it is accelerated by is what gravity pulls it down the slope: 6 degrees, 7 s."""
    run, level = sound(), rolling(sound(), 6.0)
    tilt = {c: level.table[c] for c in TILT}
    psi, t = run.table["psi_rad"].interpolate().fill_null(strategy="backward").to_numpy(), run.table["t_s"].to_numpy()
    way = rotate(psi, *(-np.sin(np.radians(6.0)) * G * f(t * 2 * np.pi / 7.0) for f in (np.cos, lambda x: -np.sin(x))))
    places = {c: run.table[c] + pl.Series(twice(t, np.column_stack(way))[:, i]) for i, c in enumerate(NEEDED[-2:])}
    surfing = Run(run.table.with_columns(**tilt, **places), run.meta)
    gravity = G * np.sin(surfing.samples(*TILT)[1]).std(axis=0)
    assert np.hypot(*gravity) > TIMES * np.hypot(*surfing.samples("ax_m_s2", "ay_m_s2")[1].std(axis=0))
    assert tilt_unit_fault(surfing) is None


def test_a_true_attitude_is_kept_one_that_follows_the_acceleration_is_not():
    assert not tilt_is_false([sound()])
    assert levelling_nats(followed()) > SURE_NATS and tilt_is_false([followed()])


def test_the_more_a_hull_really_rolls_the_more_its_roll_is_worth():
    nats = [levelling_nats(rolling(sound(), degrees)) for degrees in (0.0, 1.0, 3.0)]
    assert nats[0] > nats[1] > nats[2] and nats[2] < -SURE_NATS


def test_a_pause_of_an_hour_is_no_evidence():
    """Neither for nor against: an attitude that is merely noisy stays, however long nothing was logged."""
    table, rng = sound().table, np.random.default_rng(5)
    noisy = table.with_columns(
        **{c: pl.col(c) + pl.Series(rng.normal(0.0, 0.005, len(table))) for c in TILT},
        t_s=pl.col("t_s") + pl.when(pl.col("t_s") > 60.0).then(3600.0).otherwise(0.0),
    )
    run = Run(noisy, sound().meta)
    assert not tilt_is_false([run]) and abs(levelling_nats(run)) < 40.0


def test_noise_of_an_attitude_follows_nothing_however_long_the_log():
    """White noise of 0.02 rad, far more than an autopilot's: it harms, and many logs of it say so; seed 6."""
    rng = np.random.default_rng(6)
    noise = {c: pl.col(c) + pl.Series(rng.normal(0.0, 0.02, len(sound().table))) for c in TILT}
    noisy = Run(sound().table.with_columns(**noise), sound().meta)
    assert not tilt_is_false([noisy] * 30)


@pytest.mark.parametrize(("index", "seconds"), [(1, 200.0), (4, 200.0), (1, 60.0), (4, 60.0)])
@pytest.mark.long
def test_on_a_boat_of_another_hand(index, seconds):
    """A hull that rolls and pitches, its AHRS without GPS, and the same hull with its true attitude."""
    case = draw.draw("levelling-tests", index, foreign=True, train_s=seconds)
    case.world.sense.tilt_told = True
    track, said = record(case.world, case, 0, seconds, 0.0, case.open_rng())

    def log() -> Run:
        return Run(log_table(case.base.thruster_names, track, said), RunMeta(source="log"))

    told = log()
    said.imu[:, 5:7] = track.tilt
    assert tilt_is_false([told]) and not tilt_is_false([log()])


@pytest.mark.parametrize("log", [sound, followed])
@pytest.mark.parametrize("turn", IMU)
def test_every_turn_of_the_imu_is_judged_by_the_better_of_levelled_and_bare(log, turn):
    """Roll and pitch follow a mirrored axis by chance: judged bare, it beat the true one, that was judged levelled."""
    turned = turn.apply(log())
    either = [explained(run) for run in (turned, without_tilt(turned))]
    assert explained_levelled(turned) == pytest.approx(max(one for one in either if one is not None))


@pytest.mark.parametrize("gone", [TILT, ("ax_m_s2",), ("north_m", "east_m")])
def test_without_what_it_takes_nothing_is_said(gone):
    blank = Run(followed().table.with_columns(**dict.fromkeys(gone, pl.lit(None, pl.Float64))), followed().meta)
    assert levelling_nats(blank) == 0.0 and not tilt_is_false([blank])
    assert levelling_nats(Run(followed().table.head(40), followed().meta)) == 0.0


def test_where_nothing_moves_or_accelerometers_tell_zeros_only_nothing_is_said():
    zeros = {c: pl.when(pl.col(c).is_not_null()).then(0.0) for c in ("ax_m_s2", "ay_m_s2")}
    dead = Run(sound().table.with_columns(**zeros), sound().meta)
    still = {c: pl.when(pl.col(c).is_not_null()).then(5.0) for c in ("north_m", "east_m")}
    level = {c: pl.when(pl.col(c).is_not_null()).then(0.0) for c in TILT}
    at_rest = Run(dead.table.with_columns(**still, **level), sound().meta)
    assert not tilt_is_false([dead]) and not tilt_is_false([at_rest])
    assert explained_levelled(at_rest) is None


def test_all_logs_of_a_boat_are_asked_together_and_told_alike():
    """A log that is too short to tell goes as the others; what was left out stands in each."""
    brief = Run(followed().table.head(200), followed().meta)
    logs = levelled([NamedLog("long", followed()), NamedLog("brief", brief)])
    for log in logs:
        assert not set(TILT) & set(log.run.table.columns) and LEFT_OUT in log.run.meta.notes
    assert levelled([NamedLog("sound", sound())])[0].run is sound()


def test_both_fits_take_the_logs_so():
    division = split_levelled([NamedLog("log", followed())], [], VESSEL)
    runs = [*division.fitted, *(out.run for out in division.held_out), *data_of([followed()], [], VESSEL, None).fitted]
    known = split_levelled(levelled([NamedLog("log", followed())]), [NamedLog("proof", other())], VESSEL)
    runs += [out.run for out in known.held_out]
    assert len(runs) >= 3 and not any(set(TILT) & set(run.table.columns) for run in runs)


@pytest.mark.long
def test_accelerometers_have_the_noise_that_they_have():
    (bare,) = levelled([NamedLog("log", followed())])
    noise = {
        run is bare.run: {c.name: c.sigma for c in fit_structured([run], VESSEL, FitSettings(horizon_s=0.0)).channels}
        for run in (followed(), bare.run)
    }
    assert noise[True]["ay"] < 0.05 < noise[False]["ay"]
