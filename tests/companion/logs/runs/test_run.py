"""What a run promises, and what it refuses."""

import re
from pathlib import Path

import msgspec
import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.logs.runs.columns import OPTIONAL, REQUIRED
from companion.logs.runs.run import Run, RunError, RunMeta
from tests.companion.logs.readers.run_logs import clean_run


def changed(**columns) -> Run:
    run = clean_run(10.0)
    return Run(run.table.with_columns(**{k: pl.Series(v, dtype=pl.Float64) for k, v in columns.items()}), run.meta)


def with_value(column: str, row: int, value: float | None) -> Run:
    values = clean_run(10.0).table[column].to_list()
    values[row] = value
    return changed(**{column: values})


@pytest.mark.parametrize(
    ("column", "value", "told"),
    [
        ("pwm_left", 12.4, r"row 7: pwm_left: 12\.4; expected 800 to 2200: pulse width"),
        ("battery_v", 15600.0, "row 7: battery_v"),
        ("psi_rad", 213.9, r"row 7: psi_rad: 213\.9; .* wrapped"),
        ("r_rad_s", 40.0, "row 7: r_rad_s"),
        ("t_s", 0.12, r"row 7: t_s: 0\.12 follows 0\.12; time must increase"),
        ("t_s", None, "row 7: t_s: every row needs a time"),
        ("north_m", 3.0, "row 7: north_m, east_m: one is there without the other"),
        ("ax_m_s2", float("nan"), "row 7: ax_m_s2: nan"),
    ],
)
def test_a_value_that_cannot_be_of_its_column_is_named(column, value, told):
    with pytest.raises(RunError, match=told):
        with_value(column, 7, value)


@pytest.mark.parametrize(
    ("rename", "told"),
    [
        ({"ax_m_s2": "ax_ms2"}, r"column ax_m_s2: missing; is it 'ax_ms2'\?"),
        ({"pwm_left": "left", "pwm_right": "right"}, "pwm_<thruster>: missing"),
        ({"battery_v": "extra_volts"}, "column battery_v: missing"),
    ],
)
def test_a_missing_column_is_named(rename, told):
    with pytest.raises(RunError, match=told):
        Run(clean_run(2.0).table.rename(rename))


def test_an_unknown_column_is_refused_and_extra_ones_are_kept():
    table = clean_run(2.0).table
    with pytest.raises(RunError, match=r"column 'phi_deg': unknown; is it phi_rad\?"):
        Run(table.with_columns(phi_deg=pl.lit(0.0)))
    assert "extra_draft_m" in Run(table.with_columns(extra_draft_m=pl.lit(0.1))).table.columns
    with pytest.raises(RunError, match="column battery_v: expected numbers, found String"):
        Run(table.with_columns(battery_v=pl.lit("full")))


@pytest.mark.parametrize(
    ("column", "written", "message"),
    [
        ("psi_rad", pl.col("psi_rad").degrees(), "psi_rad: .* is it in degrees.*degrees . pi / 180"),
        ("psi_rad", pl.col("psi_rad").degrees() % 360, "psi_rad: .* is it in degrees.*degrees . pi / 180"),
        ("pwm_left", (pl.col("pwm_left") - 1500) / 400, r"pwm_left: .* is it a share .* pulses in us: 1500 \+ 400 x"),
        ("pwm_left", (pl.col("pwm_left") - 1500) / 4, r"pwm_left: .* percent.* pulses in us: 1500 \+ 400 x"),
        ("pwm_left", (pl.col("pwm_left") - 1300) / 4, r"pwm_left: .* percent.* pulses in us: 1500 \+ 400 x"),
    ],
)
def test_another_unit_is_refused_with_the_remedy(column, written, message):
    with pytest.raises(RunError, match=message):
        Run(clean_run(10.0).table.with_columns(written.alias(column)))


@pytest.mark.parametrize("names", [("lat", "lon"), ("latitude", "longitude"), ("gps_lat_deg", "gps_lng_deg")])
def test_latitudes_in_the_place_of_positions_are_named_with_what_is_needed(names):
    table = clean_run(2.0).table.rename(dict(zip(("north_m", "east_m"), names, strict=True)))
    message = (
        rf"column north_m, east_m: missing; {', '.join(names)}: metres north and east of an origin .*\.bin is read"
    )
    with pytest.raises(RunError, match=message):
        Run(table)


def test_samples_stand_only_in_their_own_rows():
    run = clean_run(10.0)
    t_s, places = run.samples("north_m", "east_m")
    assert places.shape == (50, 2)
    np.testing.assert_allclose(np.diff(t_s), 0.2)
    assert run.rates_hz()["north_m"] == pytest.approx(5.0)
    assert run.rates_hz()["r_rad_s"] == pytest.approx(50.0)
    assert "battery_v" not in run.rates_hz()


@given(st.lists(st.tuples(st.floats(0.001, 0.5), st.integers(1100, 1900)), min_size=1, max_size=40))
@pytest.mark.long
def test_commands_held_again_are_the_columns(steps):
    """`commands` says when something changed; holding that gives back every row."""
    t_s = np.cumsum([dt for dt, _ in steps])
    pwm = np.array([float(p) for _, p in steps])
    blank = pl.lit(None, pl.Float64)
    names = ("battery_v", "psi_rad", "r_rad_s", "ax_m_s2", "ay_m_s2", "north_m", "east_m")
    run = Run(pl.DataFrame({"t_s": t_s, "pwm_a": pwm, "pwm_b": 3000 - pwm}).with_columns(blank.alias(n) for n in names))
    when, what = run.commands()
    held = what[np.searchsorted(when, t_s, side="right") - 1]
    np.testing.assert_array_equal(held, np.column_stack([pwm, 3000 - pwm]))
    assert (np.diff(what, axis=0) != 0).any(axis=1).all()


def test_the_hash_is_of_the_data_alone():
    run = clean_run(5.0)
    same = Run(run.table.select(reversed(run.table.columns)), RunMeta(vessel="other"))
    assert same.data_hash == run.data_hash
    for column in ("battery_v", "ay_m_s2"):
        values = run.table[column].to_list()
        values[3] = np.nextafter(values[3], 99.0)
        other = Run(run.table.with_columns(pl.Series(column, values)))
        assert other.data_hash != run.data_hash
    values = run.table["ay_m_s2"].to_list()
    assert (
        Run(run.table.with_columns(ay_m_s2=pl.Series([0.0, *values[1:]]))).data_hash
        != Run(run.table.with_columns(ay_m_s2=pl.Series([None, *values[1:]], dtype=pl.Float64))).data_hash
    )  # blank is not zero


def test_the_reference_names_every_column_key_and_problem():
    """docs/run-format.md keeps up with the code."""
    root = Path(__file__).resolve().parents[4]
    page = (root / "docs" / "run-format.md").read_text()
    words = set(re.findall(r"(?<!`)`([^`\n]+)`(?!`)", page))
    wanted = {*REQUIRED, *OPTIONAL, *(f.name for f in msgspec.structs.fields(RunMeta))}
    sources = [root / "companion/logs/runs/problems.py", *(root / "companion/logs/readers").glob("*.py")]
    for source in sources:
        wanted |= set(re.findall(r'Problem\(kind="([^"]+)"', source.read_text()))
        wanted |= set(re.findall(r'\bnote\("([^"]+)"', source.read_text()))
    assert {"clock jump", "saturated", "psi_rad", "zero_ns"} <= wanted
    assert wanted - words == set()
