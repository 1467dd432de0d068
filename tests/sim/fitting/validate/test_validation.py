"""Models side by side over what is held out of a log, and the report of it."""

import base64
import re

import numpy as np
import polars as pl
import pytest

from companion.logs.runs.run import Run, RunMeta
from sim.fitting.engine.smoothing import smooth
from sim.fitting.engine.split import JobError, NamedLog, split
from sim.fitting.identify.verdict import DOUBTFUL
from sim.fitting.taylor.pipeline import held_commands, paper_motion, paper_samples
from sim.fitting.validate.divergence import divergence_study
from sim.fitting.validate.figures import divergence, training_log
from sim.fitting.validate.models import VesselSimulator
from sim.fitting.validate.protocol import CHANNELS, STEP_S
from sim.fitting.validate.report import Section, report
from sim.fitting.validate.study import NOT_JUDGED, HeldOut, judgeable, validate
from sim.fitting.validate.table import sentences, table
from sim.fitting.validate.windows import concatenated, cut_held_out, reference_motion
from sim.world.teleop_log import teleop_run
from tests.sim.fitting.validate.example_vessel import NOISE, VESSEL
from tests.support.vessel_fixtures import boat


def test_windows_stay_within_what_is_held_out(run):
    ref = reference_motion(run, NOISE)
    found = cut_held_out(run, ref, 15.0, horizon_s=20.0, stride_s=5.0, inside=[(10.0, 40.0), (60.0, 72.0)])
    assert list(found.start_s.round(6)) == [10, 15, 20, 25, 30, 60], "each has at least 10 s to run"
    lasts = np.isfinite(found.truth[..., 0]).sum(axis=1) - 1
    ends = found.start_s + lasts / 10
    assert (ends <= np.where(found.start_s < 50, 40.0, 72.0) + 1e-6).all()
    assert np.array_equal(found.truth[:, 0], found.x0)
    pwm, _ = held_commands(run, found.start_s[1] + STEP_S * (np.arange(400) + 0.5))
    assert np.array_equal(found.commands.pwm_us[1], pwm)
    earlier, _ = held_commands(run, found.start_s[1] - STEP_S * (np.arange(40) + 0.5))
    assert np.array_equal(found.commands.before_us[1], earlier[::-1])
    assert len(concatenated([found, found]).x0) == 12


def test_too_short_a_run_is_refused(run):
    with pytest.raises(ValueError, match=r"seed 4: no window of 10 s"):
        cut_held_out(run, reference_motion(run, NOISE), 15.0, inside=[(3.0, 9.0)])


def test_without_truth_the_smoother_is_the_reference_and_gaps_are_unknown(run):
    plain = run.table.drop([c for c in run.table.columns if c.startswith("true_")])
    hole = (pl.col("t_s") > 30.0) & (pl.col("t_s") < 50.0)
    plain = plain.with_columns(pl.when(hole).then(None).otherwise(pl.col(c)).alias(c) for c in ("north_m", "east_m"))
    found = reference_motion(Run(plain, run.meta), NOISE)
    assert found.source == "the smoothed measurements"
    truth = reference_motion(run, NOISE)
    k = min(len(found.x), len(truth.x))
    known = np.isfinite(found.x[:k]).all(axis=1)
    assert not known[330:470].any() and known[:280].all()
    assert np.abs(found.x[:k] - truth.x[:k])[known, 3:].max() < 0.1
    with pytest.raises(ValueError, match="no window"):
        cut_held_out(Run(plain, run.meta), found, 15.0, inside=[(32.0, 48.0)])


def test_what_cannot_be_judged_is_told_before_any_fit_and_left_out_where_other_logs_remain(run):
    """Held out: positions 3 s apart; a log without any in its last half; both beside a sound log."""
    plain = run.table.drop([c for c in run.table.columns if c.startswith("true_")])
    number = plain["north_m"].is_not_null().cast(pl.Int64).cum_sum()
    every_s = run.rates_hz()["north_m"]
    kept = {"slow": number % round(3 * every_s) == 0, "lost": pl.col("t_s") < 45.0}

    def thinned(name: str) -> NamedLog:
        places = [pl.when(kept[name]).then(pl.col(c)).otherwise(None).alias(c) for c in ("north_m", "east_m")]
        return NamedLog(name, Run(plain.with_columns(places), run.meta))

    other = teleop_run(VESSEL, 6, 90.0)
    sound, more = NamedLog("sound", other), NamedLog("more", teleop_run(VESSEL, 5, 40.0))
    with pytest.raises(JobError, match=r"slow: no window of 10 s .* are 3 s apart, 2\.5 s at most .*--held-out"):
        judgeable(split([sound], [thinned("slow")], VESSEL), VESSEL)
    with pytest.raises(JobError, match=r"lost: no window .*silent for more than 2\.5 s in every 10 s of it"):
        judgeable(split([thinned("lost")], [], VESSEL), VESSEL)
    found = judgeable(split([sound], [thinned("slow"), more], VESSEL), VESSEL)
    assert [out.run.meta.source for out in found.held_out] == ["more"]
    _, slow, used = found.used
    assert used.held_out_s and not slow.held_out_s
    (note,) = slow.log.run.meta.notes
    assert note.kind == NOT_JUDGED and note.kind in DOUBTFUL and note.text.endswith("at most are needed; left out")


def test_where_the_truth_is_blank_nothing_is_judged(run):
    """20 s without truth: no straight line through them."""
    hole = pl.col("t_s").is_between(30.0, 50.0)
    columns = [c for c in run.table.columns if c.startswith("true_")]
    blank = run.table.with_columns(pl.when(hole).then(None).otherwise(pl.col(c)).alias(c) for c in columns)
    found, whole = reference_motion(Run(blank, run.meta), NOISE), reference_motion(run, NOISE)
    known = np.isfinite(found.x[:, 0])
    assert not known[313:487].any() and known[:310].all() and known[490:].all()
    assert np.array_equal(found.x[:300], whole.x[:300])


def test_held_before_anything_was_sent():
    table = pl.DataFrame({"t_s": [0.0, 1.0], "pwm_a": [None, 1600.0], "battery_v": [None, None], "psi_rad": [0.0, 0.0],
                          "r_rad_s": [0.0, 0.0], "ax_m_s2": [0.0, 0.0], "ay_m_s2": [0.0, 0.0],
                          "north_m": [0.0, 0.0], "east_m": [0.0, 0.0]}).cast(pl.Float64)  # fmt: skip
    pwm, volts = held_commands(Run(table, RunMeta()), np.array([-1.0, 0.5, 1.0]))
    assert list(pwm[:, 0]) == [1500.0, 1500.0, 1600.0]
    assert np.isnan(volts).all()


@pytest.mark.long
def test_side_by_side(found):
    head = table(found).head
    assert head == ("figure", "true", "Taylor", "printed", "velocity stays", "velocity is zero")
    rows = {row[0]: row[1:] for row in table(found).rows}
    for channel in CHANNELS:
        row = next(v for k, v in rows.items() if k.startswith(f"{channel}, rms error after 10 s"))
        assert row[0].startswith("**")
    assert rows["no thrust: runs that come to rest"][0] == "100 %"
    assert rows["no thrust: runs that come to rest"][2] == "0 %"
    assert table(found).markdown().count("\n") == len(rows) + 1


def test_sentences_say_who_wins_and_who_runs_away(found):
    text = sentences(found)
    assert "nearest model is true" in text[1]
    assert "true beats both baselines in every channel at 10 and 20 s." in text
    assert any(line.startswith("printed:") and "diverge" in line for line in text)
    assert not any(line.startswith("true:") for line in text)


@pytest.mark.long
def test_the_report_stands_alone_and_begins_with_sentences(found, run):
    figure = training_log(run, paper_motion(run, NOISE), smooth(run, NOISE))
    departures = divergence_study([VesselSimulator("true", VESSEL)], found.windows, found.box)
    page = report(
        found,
        VESSEL,
        title="Boat <1>",
        before=[Section("Fitted", ("On one log.",), "a < b")],
        after=[Section("More", figures=((figure, "5 and 6"), (divergence(departures), "how many are left")))],
    )
    assert "Boat &lt;1&gt;" in page and "a &lt; b" in page
    assert not re.search(r"https?:|<script|<link|src=\"(?!data:)", page)
    images = re.findall(r"data:image/png;base64,([^\"]+)", page)
    assert len(images) == 4
    assert all(base64.b64decode(i)[:8] == b"\x89PNG\r\n\x1a\n" for i in images)
    assert page.index("<li>") < page.index("<table>") < page.index("<img")


def test_models_need_names_of_their_own(run):
    twice = [VesselSimulator("a", VESSEL), VesselSimulator("a", VESSEL)]
    with pytest.raises(ValueError, match="name of its own"):
        validate(twice, [HeldOut(run)], VESSEL, NOISE)


def test_another_boats_run_is_refused(run):
    with pytest.raises(ValueError, match=r"thrusters .*front_port.* but twin has"):
        paper_samples(run, boat("twin"), NOISE)
