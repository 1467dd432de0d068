"""What is kept of a campaign: the journal, resuming, retrying, failures, tables and report. No boat drives here."""

import contextlib
import json
import os
import re
from types import SimpleNamespace

import polars as pl
import pytest

from companion.core.configuration.tables import ConfigError
from sim.campaign import campaign, report
from sim.campaign.inputs import read_campaign
from sim.campaign.journal import NAME, Journal
from sim.campaign.runners.job import CaseOutcome
from tests.support.campaign_fixture import PROGRAM, SHORT, campaign_file, figures, pretend


def journal(folder, kind="missions", program=PROGRAM):
    folder.mkdir(exist_ok=True)
    return Journal(folder, kind, program)


def call(folder, path, runner, retry=False):
    """One call of the command, as it is put together there; what came of it."""
    inputs, cases = read_campaign(path)
    said = []
    with journal(folder) as kept:
        left = campaign.to_do(cases, kept, retry)
        with contextlib.suppress(KeyboardInterrupt):
            campaign.run(inputs, left, kept, runner, said.append)
        files = campaign.write(folder, inputs, cases, kept, PROGRAM)
    assert sorted(files) == ["failed.json", "results.parquet", "summary.html", "timings.parquet"]
    return SimpleNamespace(
        cases=cases,
        said=said,
        results=pl.read_parquet(folder / "results.parquet"),
        failed=json.loads((folder / "failed.json").read_text()),
        page=(folder / "summary.html").read_text(),
    )


def test_results_hold_a_row_for_each_case_with_what_tells_it_apart(tmp_path):
    done = call(tmp_path / "out", campaign_file(tmp_path), pretend())
    assert done.results.columns == ["case", "seed", "weather.V_c_m_s", "world.north_m", "finished", "waypoints_missed",
                                    "nees", "mode"]  # fmt: skip
    inputs, cases = read_campaign(tmp_path / "short.toml")
    wanted = [{"case": c.id, "seed": c.seed, **c.shown, **figures(inputs.work(c))} for c in cases]
    assert done.results.to_dicts() == wanted and len(done.said) == 8 and done.failed == []


def test_a_second_call_runs_what_is_left_and_ends_in_the_same_bytes(tmp_path):
    path = campaign_file(tmp_path)
    whole, first, second, third = pretend(), pretend(stop_after=3), pretend(), pretend()
    call(tmp_path / "whole", path, whole)
    some = call(tmp_path / "parts", path, first)
    assert some.results.height == 3 and "3 done, 0 failed, 5 not run yet" in some.page
    call(tmp_path / "parts", path, second)
    call(tmp_path / "parts", path, third)
    assert len(second.ran) == 5 and third.ran == []
    assert sorted(first.ran + second.ran) == sorted(whole.ran)
    same = [(tmp_path / name / "results.parquet").read_bytes() for name in ("whole", "parts")]
    assert same[0] == same[1]


def test_more_seeds_later_run_the_new_cases_alone(tmp_path):
    path = campaign_file(tmp_path)
    call(tmp_path / "out", path, pretend())
    path.write_text(SHORT.replace("count = 4", "count = 5"))
    more = pretend()
    done = call(tmp_path / "out", path, more)
    assert len(more.ran) == 2 and done.results.height == 10
    path.write_text(SHORT.replace("count = 4", "count = 1"))
    fewer = pretend()
    assert call(tmp_path / "out", path, fewer).results.height == 2 and fewer.ran == []


def test_a_failed_case_is_listed_the_others_are_kept_and_only_retry_runs_it_again(tmp_path):
    path = campaign_file(tmp_path)
    done = call(tmp_path / "out", path, pretend(fails=lambda work: work.seed == 2))
    assert done.results.height == 6 and 2 not in done.results["seed"]
    assert [(f["seed"], f["error"]) for f in done.failed] == [(2, "ValueError: for the test")] * 2
    assert {"case", "weather.V_c_m_s", "trace"} <= set(done.failed[0])
    assert "6 done, 2 failed, 0 not run yet" in done.page and "ValueError: for the test" in done.page
    plain, again = pretend(), pretend()
    call(tmp_path / "out", path, plain)
    assert plain.ran == []
    mended = call(tmp_path / "out", path, again, retry=True)
    assert sorted(again.ran) == sorted(f["case"] for f in done.failed)
    assert mended.results.height == 8 and mended.failed == [] and "Cases that failed" not in mended.page


def test_a_torn_last_line_is_dropped_and_its_case_run_again(tmp_path):
    path, out = campaign_file(tmp_path), tmp_path / "out"
    call(out, path, pretend())
    whole = (out / NAME).read_bytes()
    (out / NAME).write_bytes(whole[:-20])
    again = pretend()
    call(out, path, again)
    assert len(again.ran) == 1 and (out / NAME).read_bytes() == whole


def test_ctrl_c_while_a_line_is_put_on_disk_leaves_no_case_out_of_the_tables(tmp_path, monkeypatch):
    put, calls = os.fsync, []

    def interrupted(file) -> None:
        calls.append(file)
        if len(calls) == 4:  # the head, and three cases
            raise KeyboardInterrupt
        put(file)

    monkeypatch.setattr(os, "fsync", interrupted)
    done = call(tmp_path / "out", campaign_file(tmp_path), pretend())
    monkeypatch.undo()
    with journal(tmp_path / "out") as kept:
        assert len(calls) >= 4 and set(done.results["case"]) == set(kept.outcomes) and len(kept.outcomes) == 3


def test_a_report_that_cannot_be_made_costs_no_table(tmp_path, monkeypatch):
    def broken(*args) -> str:
        raise ValueError("of a picture")

    monkeypatch.setattr(campaign, "summary", broken)
    with pytest.raises(ValueError, match="of a picture"):
        call(tmp_path / "out", campaign_file(tmp_path), pretend())
    assert pl.read_parquet(tmp_path / "out" / "results.parquet").height == 8


@pytest.mark.parametrize("keep", range(1, 120, 7))
def test_a_journal_cut_anywhere_goes_on(tmp_path, keep):
    path, out = campaign_file(tmp_path), tmp_path / "out"
    out.mkdir()
    inputs, cases = read_campaign(path)
    with journal(out) as kept:
        campaign.run(inputs, cases[:2], kept, pretend(), lambda outcome: None)
    data = (out / NAME).read_bytes()
    (out / NAME).write_bytes(data[: len(data) * keep // 120])
    with journal(out) as kept:
        assert set(kept.outcomes) <= {c.id for c in cases[:2]}
        campaign.run(inputs, campaign.to_do(cases[:2], kept, False), kept, pretend(), lambda outcome: None)
    with journal(out) as kept:
        assert set(kept.outcomes) == {c.id for c in cases[:2]}


def test_a_damaged_line_is_named(tmp_path):
    path, out = campaign_file(tmp_path), tmp_path / "out"
    call(out, path, pretend())
    lines = (out / NAME).read_bytes().splitlines()
    (out / NAME).write_bytes(b"\n".join([*lines[:3], b"{", *lines[4:]]) + b"\n")
    with pytest.raises(ConfigError, match=r"journal\.jsonl: line 4: damaged"):
        journal(out)


def test_two_campaigns_do_not_write_one_journal(tmp_path):
    with journal(tmp_path), pytest.raises(ConfigError, match="another campaign is writing it"):
        journal(tmp_path)
    with journal(tmp_path):
        pass


def test_results_of_other_versions_and_kinds_are_not_mixed(tmp_path):
    with journal(tmp_path):
        pass
    with pytest.raises(ConfigError, match=r"was computed with aritra for tests, here 2; .*choose another folder"):
        journal(tmp_path, program={"aritra": "2"})
    with pytest.raises(ConfigError, match="holds a campaign of kind missions"):
        journal(tmp_path, kind="identify")
    with (
        journal(tmp_path) as kept,
        pytest.raises(ConfigError, match="worker far:1: was computed with aritra 3, here for"),
    ):
        kept.add(CaseOutcome(id="a", program={"aritra": "3"}, worker="far:1"))
    assert len((tmp_path / NAME).read_bytes().splitlines()) == 1


def test_the_page_stands_alone_and_says_what_it_rests_on(tmp_path):
    path = campaign_file(tmp_path, old="count = 4", new="count = 12")
    page = call(tmp_path / "out", path, pretend()).page
    assert not re.search(r"https?://|<script|<link|@import", page)
    assert page.count("data:image/png;base64,") == 1
    for words in ("24 of 24 missions ended in time", "V_c_m_s 0.0", "V_c_m_s 0.1", "leg.toml", "[draw]", "for tests"):
        assert words in page


def test_columns_that_some_cases_do_not_have_are_blank(tmp_path):
    """A diagnosis names other causes in other cases; whole numbers among fractions are fractions."""
    path = campaign_file(tmp_path, old="weather.V_c_m_s = [0.0, 0.1]", new="weather.V_c_m_s = [0.0]")

    def run(works):
        for work in works:
            sizes = {f"cause_{work.seed}": 1 if work.seed == 1 else 0.5, "shared": work.seed if work.seed < 3 else 2.5}
            yield CaseOutcome(id=work.id, figures={"finished": True, "waypoints_missed": 0, **sizes}, program=PROGRAM)

    table = call(tmp_path / "out", path, run).results
    assert table["shared"].dtype == pl.Float64 and sorted(table["shared"]) == [1.0, 2.0, 2.5, 2.5]
    assert table["cause_1"].null_count() == 3


@pytest.mark.parametrize(
    ("values", "beside"), [([0.0], 0), ([0.0, 0.1, 0.2], 3), ([0.1 + k / 3e9 for k in range(4)], 0)]
)
def test_in_a_terminal_points_of_a_grid_stand_beside_each_other_where_they_fit(values, beside, tmp_path):
    path = campaign_file(tmp_path)
    text = path.read_text()
    assert "V_c_m_s = [0.0, 0.1]" in text
    path.write_text(text.replace("V_c_m_s = [0.0, 0.1]", f"V_c_m_s = {values}"))
    found = report.narrow(read_campaign(path)[0].campaign, call(tmp_path / "out", path, pretend()).results)
    heads = [f"V_c_m_s {v}" for v in values] if beside else list(report.NARROW[1:])
    counted = ["finished", "waypoint missed"] if beside else []
    assert list(found.head[1:]) == heads and [row[0] for row in found.rows] == [*counted, "nees"]
    assert {len(row) for row in found.rows} == {len(found.head)}


@pytest.mark.parametrize(
    ("keys", "names"),
    [
        (["weather.V_c_m_s", "world.mismatch"], ["V_c_m_s", "mismatch"]),
        (["vessel.thrusters.port.gain", "vessel.thrusters.bow.gain"], ["port.gain", "bow.gain"]),
        (["truth.hull.length_m", "vessel.hull.length_m"], ["truth.hull.length_m", "vessel.hull.length_m"]),
        (["a.b", "x.a.b"], ["a.b", "x.a.b"]),
    ],
)
def test_points_of_a_grid_are_told_by_names_that_tell_them_apart(keys, names):
    assert report.short_names(keys) == names


def test_figures_of_some_cases_alone_are_told_as_such(tmp_path):
    """In the current one of four missions finishes: its error is not the error of that point."""

    def run(works):
        for work in works:
            done = work.values["weather.V_c_m_s"] == 0.0 or work.seed == 1
            told = {"finished": done, "waypoints_missed": 0 if done else 2, "station_error_m": 0.1 if done else None}
            yield CaseOutcome(id=work.id, figures=told, program=PROGRAM)

    path = campaign_file(tmp_path)
    done = call(tmp_path / "out", path, run)
    found = report.narrow(read_campaign(path)[0].campaign, done.results)
    assert found.rows == (
        ("finished", "4 of 4", "1 of 4"),
        ("waypoint missed", "0 of 4", "3 of 4"),
        ("station_error_m", "0.1 (0.1)", "0.1 (0.1) n=1"),
    )
    assert report.ended(done.results) == "5 of 8 missions ended in time; in 3 a waypoint was missed."
    for words in ("0.1 (0.1) n=1", "1 of 4", "5 of 8 missions ended in time"):
        assert words in done.page
