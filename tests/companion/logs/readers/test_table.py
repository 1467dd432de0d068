"""Runs as files: round trips bit for bit, errors with line and column."""

import gzip
import string

import msgspec
import numpy as np
import polars as pl
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from companion.logs.readers.read_run import ReadOptions, read_run
from companion.logs.readers.table import read_csv, write_run
from companion.logs.runs.run import LogProblem, Run, RunError, RunMeta
from tests.companion.logs.readers.run_logs import clean_run

TEXT = st.text(st.characters(codec="utf-8", exclude_categories=["Cs"]), max_size=12)
NAME = st.text(string.ascii_lowercase + string.digits + "_", min_size=1, max_size=8)


@st.composite
def runs(draw) -> Run:
    """Any run: 1 to 3 thrusters, columns with blanks, the whole range of every column, metadata of any text."""
    n = draw(st.integers(1, 12))
    steps = draw(st.lists(st.floats(1e-9, 1e3), min_size=n, max_size=n))
    t_s = np.cumsum(steps) + draw(st.floats(-1e3, 1e3))
    if (np.diff(t_s) <= 0).any():
        t_s = np.arange(n) / 7.0

    def column(low: float, high: float) -> pl.Series:
        values = draw(st.lists(st.none() | st.floats(low, high), min_size=n, max_size=n))
        return pl.Series(values, dtype=pl.Float64)

    table = {"t_s": pl.Series(t_s)}
    table |= {f"pwm_{name}": column(800, 2200) for name in draw(st.lists(NAME, min_size=1, max_size=3, unique=True))}
    table |= {"battery_v": column(0, 60), "psi_rad": column(-3.14, 3.14), "r_rad_s": column(-5, 5)}
    table |= {"ax_m_s2": column(-9, 9), "ay_m_s2": column(-9, 9), "extra_x": column(-1e300, 1e300)}
    north = column(-1e4, 1e4)
    east = pl.Series([None if v is None else -v / 3 for v in north], dtype=pl.Float64)
    table |= {"north_m": north, "east_m": east}
    note = LogProblem(kind=draw(TEXT), text=draw(TEXT), t_s=draw(st.none() | st.floats(0, 9)))
    meta = RunMeta(
        vessel=draw(TEXT), source=draw(TEXT), zero_ns=draw(st.integers(0, 2**62)), notes=(note,),
        latency_s=draw(st.none() | st.floats(0, 1)), anchors_m={draw(TEXT): (1.0, 0.1, -2.5)},
        pwm_limits_us={"a": (1100.0, 1900.0)}, columns={draw(TEXT): draw(TEXT)},
    )  # fmt: skip
    return Run(pl.DataFrame(table), meta)


@pytest.mark.parametrize("ending", ["csv", "csv.gz", "parquet"])
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(run=runs())
@pytest.mark.long
def test_written_and_read_is_the_same_bit_for_bit(run: Run, ending: str, tmp_path):
    path = tmp_path / f"run.{ending}"
    write_run(run, path)
    back = read_run(path)
    assert back.meta == run.meta
    assert back.table.columns == run.table.columns
    for name in run.table.columns:
        a, b = run.table[name], back.table[name]
        assert a.is_null().equals(b.is_null())
        assert a.drop_nulls().to_numpy().tobytes() == b.drop_nulls().to_numpy().tobytes(), name
    assert back.data_hash == run.data_hash


@pytest.fixture
def lines(tmp_path) -> tuple:
    """Path and lines of a small CSV; the header's index."""
    path = tmp_path / "run.csv"
    write_run(clean_run(2.0), path)
    text = path.read_text().splitlines()
    return path, text, next(i for i, line in enumerate(text) if not line.startswith("#"))


def put(path, lines) -> None:
    path.write_text("\n".join(lines) + "\n")


def test_errors_name_file_line_and_column(lines):
    path, text, head = lines
    columns = text[head].split(",")

    def spoilt(row: int, column: str, value: str, rows: int = 1) -> str:
        """`value` in so many rows that it cannot be a slip."""
        spoiled = list(text)
        for at in range(head + row, head + row + rows):
            fields = text[at].split(",")
            fields[columns.index(column)] = value
            spoiled[at] = ",".join(fields)
        put(path, spoiled)
        with pytest.raises(RunError) as caught:
            read_csv(path)
        return str(caught.value)

    line = head + 4 + 1  # 1-based
    assert spoilt(4, "battery_v", "15,6", 60).startswith(f"{path}: line {line}: 11 fields; the header has 10")
    assert spoilt(4, "battery_v", "full", 60) == f"{path}: line {line}: battery_v: 'full' is not a number"
    assert f"line {line}: pwm_left: 15.6; expected 800" in spoilt(4, "pwm_left", "15.6", 60)
    assert f"line {line}: t_s: 0.0 follows 0.04; time must increase" in spoilt(4, "t_s", "0.0", 60)
    assert f"line {line}: t_s: every row needs a time" in spoilt(4, "t_s", "", 60)
    assert f"line {line}: psi_rad: 181" in spoilt(4, "psi_rad", "181.0", 60)
    assert spoilt(4, "t_s", "", 60) != spoilt(5, "t_s", "", 60)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda h: h.replace("psi_rad", "psi_deg"), r"line \d+: column psi_rad: missing; is it 'psi_deg'\?"),
        (lambda h: h.replace("r_rad_s", "ax_m_s2", 1), r"line \d+: column ax_m_s2: is there twice"),
        (lambda h: h.replace(",", ";"), r"line \d+: 1 fields; the header has 10, with semicolons between"),
        (lambda h: "", r"line \d+: no header"),
    ],
)
def test_a_wrong_header_is_told(lines, change, told):
    path, text, head = lines
    put(path, [*text[:head], change(text[head]), *text[head + 1 :]])
    with pytest.raises(RunError, match=told):
        read_csv(path)


def test_a_table_in_utf_16_is_refused_with_the_remedy(tmp_path):
    path = tmp_path / "lab.csv"
    path.write_bytes(clean_run(2.0).table.write_csv().encode("utf-16"))
    with pytest.raises(RunError, match="is UTF-16 text: save it as UTF-8"):
        read_run(path)


def test_columns_in_another_order_are_the_same_run_but_swapped_names_are_found(lines):
    path, text, head = lines
    rows = [line.split(",") for line in text[head:]]
    put(path, [*text[:head], *(",".join(reversed(row)) for row in rows)])
    assert read_csv(path).data_hash == clean_run(2.0).data_hash
    swap = {"pwm_left": "battery_v", "battery_v": "pwm_left"}
    put(path, [*text[:head], ",".join(swap.get(c, c) for c in rows[0]), *text[head + 1 :]])
    with pytest.raises(RunError, match=rf"line {head + 2}: (pwm_left|battery_v): .*; expected"):
        read_csv(path)


def test_a_plain_table_without_metadata_is_a_run(lines):
    path, text, head = lines
    path.write_bytes(b"\xef\xbb\xbf" + "\r\n".join(text[head:]).encode())
    run = read_csv(path)
    assert run.table.equals(clean_run(2.0).table)
    assert run.meta == RunMeta(source=str(path))


def test_edited_data_and_what_is_no_number_are_told(lines):
    path, text, head = lines
    fields = text[head + 3].split(",")
    fields[6] = "NaN"  # r_rad_s? whichever sampled column stands there
    column = text[head].split(",")[6]
    put(path, [*text[: head + 3], ",".join(fields), *text[head + 4 :]])
    run = read_csv(path)
    assert run.table[column][2] is None
    assert [(p.kind, p.t_s) for p in run.meta.notes] == [("not a number", 0.04), ("edited", None)]
    assert column in run.meta.notes[0].text


@pytest.mark.parametrize("value", ["nan", "-inf"])
def test_half_a_position_that_is_no_number_leaves_the_other_half_blank_too(lines, value):
    path, text, head = lines
    columns, fields = text[head].split(","), text[head + 11].split(",")
    assert float(fields[columns.index("east_m")]), "a position stands there"
    fields[columns.index("north_m")] = value
    put(path, [*text[: head + 11], ",".join(fields), *text[head + 12 :]])
    run, whole = read_csv(path), clean_run(2.0)
    assert [(p.kind, p.t_s) for p in run.meta.notes] == [("not a number", 0.2), ("edited", None)]
    t_s, places = whole.samples("north_m", "east_m")
    assert run.samples("east_m")[0].tolist() == [t for t in t_s if t != 0.2]
    assert run.samples("north_m", "east_m")[1].tolist() == places[t_s != 0.2].tolist()


def test_other_files_are_refused_with_their_name(tmp_path):
    for name, data, told in (
        ("a.parquet", b"no", r"a\.parquet: not a Parquet file"),
        ("a.csv", b"", r"a\.csv: line 1: no header"),
        ("a.csv.gz", b"no", r"a\.csv\.gz: cannot be unpacked"),
        ("A.CSV.GZ", b"no", r"A\.CSV\.GZ: cannot be unpacked"),
        ("a.tlog.gz", b"\x1f\x8b", r"a\.tlog\.gz: is compressed, which only \.csv\.gz may be: unpack it"),
        ("a.csv", b"# aritra_run = 2\nt_s\n", r"a\.csv: line 2: column battery_v"),
        ("a.csv", b"# aritra_run = 1\n# vessel = oops\nt_s\n", r"a\.csv: line 2: vessel: "),
        ("a.txt", b"", r"a\.txt: expected \.mcap"),
    ):
        path = tmp_path / name
        path.write_bytes(data)
        with pytest.raises(RunError, match=told):
            read_run(path)
    with pytest.raises(RunError, match="written as"):
        write_run(clean_run(2.0), tmp_path / "a.xlsx")
    with pytest.raises(FileNotFoundError):
        read_run(tmp_path / "absent.csv")
    with pytest.raises(RunError, match="UWB log is joined"):
        read_run(path, ReadOptions(uwb=path))
    with pytest.raises(RunError, match="truth goes with"):
        read_run(path, ReadOptions(truth=path))


def test_another_version_and_bad_metadata_are_refused(lines):
    path, text, _ = lines
    put(path, ["# aritra_run = 2", *text[1:]])
    with pytest.raises(RunError, match="aritra_run = 2: this program reads 1"):
        read_csv(path)
    at = next(i for i, line in enumerate(text) if line.startswith("# latency_s"))
    put(path, [*text[:at], "# latency_s = true", *text[at + 1 :]])
    with pytest.raises(RunError, match=r"metadata: .*latency_s"):
        read_csv(path)
    put(path, [*text[:at], text[at], *text[at:]])
    with pytest.raises(RunError, match=rf"line {at + 2}: latency_s: is there twice"):
        read_csv(path)
    put(path, [*text[:at], "# latencey_s = 0.1", *text[at + 1 :]])
    with pytest.raises(RunError, match=r"metadata: .*latencey_s"):
        read_csv(path)


@pytest.mark.long
def test_an_hour_is_written_and_read(tmp_path):
    """180,000 rows: in CSV and in Parquet, no row is lost."""
    run = clean_run(3600.0)
    for ending in ("parquet", "csv"):
        path = tmp_path / f"hour.{ending}"
        write_run(run, path)
        assert read_run(path).data_hash == run.data_hash


def test_gzip_is_the_same_file_for_the_same_run(tmp_path):
    one, other = tmp_path / "a.csv.gz", tmp_path / "b.csv.gz"
    write_run(clean_run(2.0), one)
    write_run(clean_run(2.0), other)
    assert one.read_bytes() == other.read_bytes()
    assert gzip.decompress(one.read_bytes()).startswith(b"# aritra_run = 1\n# data_hash = ")
    assert msgspec.json.decode(pl.read_parquet_metadata(_parquet(tmp_path))["aritra_run"])["vessel"] == "synthetic"


def _parquet(folder):
    path = folder / "a.parquet"
    write_run(clean_run(2.0), path)
    return path


def test_a_blank_column_of_parquet_and_texts_in_it_are_read_as_those_of_csv(tmp_path):
    """A column that some programs write with type Null was refused, and so were numbers written as text."""
    path, table = tmp_path / "lab.parquet", clean_run(2.0).table
    texts = table["psi_rad"].cast(pl.String).to_list()
    texts[7] = "NA"
    table.with_columns(pl.Series("battery_v", [None] * 100, dtype=pl.Null), psi_rad=pl.Series(texts)).write_parquet(
        path
    )
    run = read_run(path)
    assert run.table["battery_v"].null_count() == 100
    assert run.table["psi_rad"].to_list() == [*table["psi_rad"][:7], None, *table["psi_rad"][8:]]
    assert [(p.kind, p.text) for p in run.meta.notes] == [
        ("read as", "row 7: psi_rad: 'NA' is read as blank; 1 such fields")
    ]
    table.with_columns(psi_rad=pl.lit("north")).write_parquet(path)
    with pytest.raises(RunError, match=r"lab\.parquet: row 0: psi_rad: 'north' is not a number"):
        read_run(path)


def test_a_repeated_row_of_parquet_is_left_out(tmp_path):
    path, table = tmp_path / "lab.parquet", clean_run(2.0).table
    pl.concat([table[:8], table[7:]]).write_parquet(path)
    run = read_run(path)
    assert run.table.equals(table)
    assert [(p.kind, p.t_s) for p in run.meta.notes] == [("duplicate", 0.14)]
    assert run.meta.notes[0].text.startswith("row 8: t_s: 0.14 is there twice")


@pytest.mark.parametrize(
    "stamp", ["2024-05-01T10:00:00.02Z", "2024-05-01 10:00:00", "01.05.2024 10:00", "10:00:00.02", "5/1/2024 10:00"]
)
def test_dates_are_refused_with_what_to_write(tmp_path, stamp):
    table = clean_run(2.0).table.with_columns(t_s=pl.lit(stamp))
    (tmp_path / "lab.csv").write_text(table.write_csv())
    with pytest.raises(RunError, match=r"line 2: t_s: .* is not a number: seconds are needed.*fromisoformat"):
        read_run(tmp_path / "lab.csv")


def test_dates_of_parquet_are_refused_with_what_to_write(tmp_path):
    stamps = pl.datetime_range(pl.datetime(2024, 5, 1), pl.datetime(2024, 5, 1, 0, 0, 49), "500ms", eager=True)
    table = clean_run(2.0).table[: len(stamps)].with_columns(t_s=stamps)
    table.write_parquet(tmp_path / "lab.parquet")
    with pytest.raises(RunError, match=r"column t_s: expected numbers, found Datetime.*: seconds are needed"):
        read_run(tmp_path / "lab.parquet")
