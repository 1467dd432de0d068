"""CSV files as other people and spreadsheet programs save them: what is read, left out, and said of it."""

import csv
import io

import msgspec
import polars as pl
import pytest

from companion.logs.readers.read_run import read_run
from companion.logs.readers.table import write_run
from companion.logs.runs.run import Run, RunError
from tests.companion.logs.readers.run_logs import clean_run

ROWS = 500
FIELDS = 10


@pytest.fixture
def lab(tmp_path):
    """Reads a plain table whose lines were changed: `lab(change)`, header first."""

    def read(change) -> Run:
        path = tmp_path / "lab.csv"
        text = clean_run(ROWS / 50).table.write_csv()
        changed = change(text.splitlines())
        path.write_bytes(changed if isinstance(changed, bytes) else ("\n".join(changed) + "\n").encode())
        return read_run(path)

    return read


def with_field(line: str, at: int, value: str) -> str:
    fields = line.split(",")
    fields[at] = value
    return ",".join(fields)


def notes(run: Run) -> list[tuple[str, str]]:
    return [(p.kind, p.text) for p in run.meta.notes]


def test_a_last_line_that_was_cut_off_is_left_out(lab):
    run = lab(lambda lines: [*lines[:-1], lines[-1][:60]])
    assert run.table.equals(clean_run(ROWS / 50).table[:-1])
    (note,) = notes(run)
    assert note[0] == "garbage" and note[1].startswith(f"line {ROWS + 1}, the last: cut off (")


def test_a_last_line_that_was_cut_off_is_no_excuse_for_another(lab):
    """In a table of 20 rows one line is a slip; the last one does not count beside it, a third does."""
    run = lab(lambda lines: [*lines[:10], "1,2", *lines[11:20], "0.4,15"])
    assert run.table.height == 18
    assert [text for _, text in notes(run)] == [
        "line 21, the last: cut off (2 fields; the header has 10); left out",
        "line 11: 2 fields; the header has 10; 1 such lines are left out",
    ]
    with pytest.raises(RunError, match="line 11: 2 fields; the header has 10"):
        lab(lambda lines: [*lines[:10], "1,2", "1,2", *lines[12:20], "0.4,15"])


@pytest.mark.parametrize("bad", [b"1,2,3", b"x," * 12, b"\xff" + b"," * 9, b"\0" * 40])
def test_a_few_lines_that_are_no_rows_are_left_out_and_many_refuse_the_table(lab, bad):
    def spoilt(lines, count):
        return b"\n".join(
            [*(line.encode() for line in lines[:101]), *[bad] * count, *(x.encode() for x in lines[101:])]
        )

    run = lab(lambda lines: spoilt(lines, 2))
    assert run.table.equals(clean_run(ROWS / 50).table)
    (note,) = notes(run)
    assert note[0] == "garbage" and note[1].startswith("line 102: ") and "2 such lines are left out" in note[1]
    with pytest.raises(RunError, match=r"lab\.csv: line 102: "):
        lab(lambda lines: spoilt(lines, 20))


@pytest.mark.parametrize("blank", ["", "   ", "," * (FIELDS - 1), "\r"])
def test_blank_lines_are_ignored_wherever_they_stand(lab, blank):
    run = lab(lambda lines: [blank, lines[0], blank, *(x for line in lines[1:] for x in (line, blank))])
    assert run.table.equals(clean_run(ROWS / 50).table)
    assert notes(run) == []


def test_lines_are_counted_past_what_was_left_out(lab):
    with pytest.raises(RunError, match=r"line 5: psi_rad: 'west' is not a number"):
        lab(lambda lines: [lines[0], "", "# a", "1,2", *(with_field(line, 4, "west") for line in lines[5:])])


def test_a_word_in_a_column_of_numbers_is_left_blank(lab):
    run = lab(lambda lines: [*lines[:51], with_field(lines[51], 8, "lost"), *lines[52:]])
    whole = clean_run(ROWS / 50).table
    assert whole["east_m"][50] is not None and run.table["east_m"][50] is None, "the other of the pair, too"
    assert run.table.drop("north_m", "east_m").equals(whole.drop("north_m", "east_m"))
    assert notes(run) == [("not a number", "line 52: north_m: 'lost' is not a number; 1 such values, left blank")]


@pytest.mark.parametrize("end", ["\r", "\r\n", "\n"])
def test_any_line_ends_will_do(lab, end):
    run = lab(lambda lines: end.join(lines).encode())
    assert run.table.equals(clean_run(ROWS / 50).table)


@pytest.mark.parametrize("word", ["NA", "None", "null", "-", "N/A", " na "])
def test_words_for_a_blank_are_blank(lab, word):
    run = lab(lambda lines: [lines[0], *(",".join(f or word for f in line.split(",")) for line in lines[1:])])
    assert run.table.equals(clean_run(ROWS / 50).table)
    ((kind, text),) = notes(run)
    assert kind == "read as" and text == f"line 3: north_m: {word!r} is read as blank; 900 such fields"


@pytest.mark.parametrize("quoted", [False, True])
@pytest.mark.parametrize(("mark", "name"), [(";", "semicolons"), ("\t", "tabs")])
@pytest.mark.parametrize("comma", [False, True])
def test_semicolons_tabs_and_decimal_commas_are_read_and_stated(lab, mark, name, comma, quoted):
    def changed(lines):
        rows = [[f.replace(".", ",") if comma else f for f in line.split(",")] for line in lines]
        return [mark.join(f'"{f}"' if quoted and f else f for f in row) for row in rows]

    run = lab(changed)
    assert run.table.equals(clean_run(ROWS / 50).table)
    text = f"line 1: {name} between the columns" + (", decimal commas" if comma else "")
    assert notes(run) == [("read as", text)]


def test_commas_and_points_in_one_file_are_no_decimal_commas(lab):
    """1,234.5 with semicolons between: nobody knows which is which."""
    with pytest.raises(RunError, match=r"line 2: battery_v: '1,15' is not a number"):
        lab(lambda lines: [lines[0].replace(",", ";"), *(with_field(x, 3, "1!15").replace(",", ";").replace("!", ",")
                                                          for x in lines[1:])])  # fmt: skip


def test_quoted_numbers_are_numbers_and_quoted_decimal_commas_need_semicolons(lab):
    run = lab(lambda lines: [",".join(f'"{f}"' for f in line.split(",")) for line in lines])
    assert run.table.equals(clean_run(ROWS / 50).table) and notes(run) == []
    with pytest.raises(RunError, match="line 2: a quoted field with a separator in it: write decimal points, or semi"):
        lab(lambda lines: [lines[0], *(",".join(f'"{f.replace(".", ",")}"' for f in x.split(",")) for x in lines[1:])])


@pytest.mark.parametrize("mark", [",", ";"])
def test_the_line_in_which_excel_says_the_separator_is_taken(lab, mark):
    run = lab(lambda lines: [f"sep={mark}", *(line.replace(",", mark) for line in lines)])
    assert run.table.equals(clean_run(ROWS / 50).table)


def test_comments_of_other_programs_are_ignored_with_one_note(lab):
    run = lab(lambda lines: ["# rate = 50 Hz", "# boat = 3", "# made by me", *lines, "# end"])
    assert run.table.equals(clean_run(ROWS / 50).table)
    ((kind, text),) = notes(run)
    assert kind == "comments" and text.startswith(
        "line 1: 4 lines that begin with # are comments, ignored; they are meta"
    )


def test_a_comment_beside_our_metadata_is_ignored(tmp_path):
    write_run(clean_run(2.0), tmp_path / "run.csv")
    (tmp_path / "run.csv").write_text("# windy\n" + (tmp_path / "run.csv").read_text())
    run = read_run(tmp_path / "run.csv")
    assert run.meta.vessel == "synthetic"
    assert notes(run) == [("comments", "line 1: 1 lines that begin with # are comments, ignored")]


@pytest.fixture
def exported(tmp_path):
    """A run with all kinds of metadata, and its CSV."""
    plain = clean_run(2.0)
    meta = msgspec.structs.replace(
        plain.meta, late_s={"r_rad_s": 0.01, "ax_m_s2": 0.02}, tag_arm_m=(0.1, -0.25), site="basin, west",
        anchors_m={"A": (0.0, 1.5, -2.0), "B": (3.25, 0.0, -2.0)}, columns={"pwm": "leases, as sent", "psi_rad": "ATT"},
    )  # fmt: skip
    run = Run(plain.table, meta)
    write_run(run, tmp_path / "run.csv")
    return run, tmp_path / "run.csv"


def test_our_own_export_is_read_after_its_metadata_lines_were_padded(exported):
    run, path = exported
    lines = path.read_text().splitlines()
    path.write_text("\n".join(line + "," * 9 if line.startswith("#") else line for line in lines) + "\n")
    back = read_run(path)
    assert back.data_hash == run.data_hash and back.meta == run.meta


@pytest.mark.parametrize("mark", [",", ";"])
def test_our_own_export_is_read_after_a_spreadsheet_program_saved_it(exported, mark):
    """It divides lines at commas, quotes what has quotes inside, and pads all lines to the same length."""
    run, path = exported
    rows = list(csv.reader(path.read_text().splitlines()))
    width, out = max(map(len, rows)), io.StringIO()
    csv.writer(out, delimiter=mark, lineterminator="\r\n").writerows(
        [*row, *[""] * (width - len(row))] if row[0].startswith("#") else row for row in rows
    )
    path.write_text(out.getvalue())
    back = read_run(path)
    assert back.data_hash == run.data_hash
    if mark == ",":
        assert back.meta == run.meta
    else:
        assert {p.kind for p in back.meta.notes} <= {"read as", "edited"}
        assert back.meta.vessel == "synthetic"


def test_metadata_that_a_spreadsheet_spoilt_is_left_out_with_a_note(exported):
    run, path = exported
    lines = ['"# late_s = {""psi_rad,,,,,' if x.startswith("# late_s") else x for x in path.read_text().splitlines()]
    path.write_text("\n".join(lines) + "\n")
    back = read_run(path)
    assert back.meta.late_s == {} and back.meta.anchors_m == run.meta.anchors_m
    ((kind, text),) = notes(back)
    assert kind == "edited" and "late_s: cannot be read as a spreadsheet program saved it; left out" in text


def test_the_head_of_a_table_with_latitudes_says_what_is_needed(lab):
    def changed(lines):
        return [lines[0].replace("north_m", "latitude").replace("east_m", "lon"), *lines[1:]]

    with pytest.raises(RunError, match=r"north_m, east_m: missing; latitude, lon: metres north and east of an origin"):
        lab(changed)


def test_polars_reads_the_same_numbers(lab):
    """An oracle that is not ours, over a table with quotes and blank lines."""
    run = lab(lambda lines: ["", *(",".join(f'"{f}"' if f else f for f in line.split(",")) for line in lines)])
    plain = pl.read_csv(io.StringIO(clean_run(ROWS / 50).table.write_csv()))
    assert run.table.equals(plain.cast(pl.Float64))
