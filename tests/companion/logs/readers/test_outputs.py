"""Which output drives which thruster: by the autopilot's functions, by a guess that nothing contradicts, or not."""

import re
from pathlib import Path

import pytest

from companion.logs.readers.outputs import GUESSED, output_stream
from companion.logs.runs.run import LogProblem, RunError
from tests.support.vessel_fixtures import boat

VESSEL = boat("aritra")
NAMES = [t.name for t in VESSEL.thrusters]
PORT = [t.name for t in VESSEL.thrusters if t.y_m < 0]
PATH = Path("a.BIN")


def pulses(**us: float) -> dict[int, list[tuple[float, ...]]]:
    """Fourteen outputs over 20 records, those of `us` with pulses: one widens each by 1 us a record."""
    return {1: [(k, *(us[f"o{n}"] + k if f"o{n}" in us else 0 for n in range(1, 15))) for k in range(20)]}


def functions(**of: int) -> dict[str, float]:
    return {f"SERVO{name[1:]}_FUNCTION": float(function) for name, function in of.items()}


def first_us(groups, parameters, vessel=VESSEL) -> tuple[dict[str, float], list[LogProblem]]:
    notes: list[LogProblem] = []
    stream, _ = output_stream(groups, vessel, parameters, notes, PATH)
    return {name.removeprefix("pwm_"): float(values[0]) for name, values in stream.columns.items()}, notes


def test_motors_are_the_thrusters_in_their_order_and_a_note_says_so():
    read, notes = first_us(pulses(o5=1510, o6=1520, o7=1530, o8=1540), functions(o7=33, o5=34, o8=35, o6=36))
    assert read == dict(zip(NAMES, (1530, 1510, 1540, 1520), strict=True))
    (note,) = notes
    assert note.kind == GUESSED and f"output 7 (function 33) {NAMES[0]}" in note.text


def test_throttles_left_and_right_drive_all_thrusters_of_their_side():
    wired = functions(o5=73, o6=74, o7=73, o8=74)
    read, notes = first_us(pulses(o5=1510, o6=1520, o7=1510, o8=1520), wired)
    assert read == {name: 1510 if name in PORT else 1520 for name in NAMES} and not notes


@pytest.mark.parametrize(
    ("wired", "seen"),
    [
        (functions(o5=73, o6=74, o7=73, o8=74), "output 5 (function 73), output 6 (function 74)"),  # differ on a side
        (functions(o5=33, o6=34, o7=35), "output 7 (function 35), output 8 (function not logged)"),
        (functions(o1=0, o5=26, o6=70), "output 5 (function 26), output 6 (function 70)"),
    ],
)
def test_functions_that_leave_thrusters_open_are_refused_not_guessed(wired, seen):
    with pytest.raises(RunError, match=r"^a.BIN: SERVOn_FUNCTION does not say which outputs drive") as refused:
        first_us(pulses(o5=1510, o6=1520, o7=1530, o8=1540), wired)
    assert seen in str(refused.value)
    assert re.search("Give each thruster .* `channel`.* or run `aritra log export", str(refused.value))


@pytest.mark.parametrize("wired", [{}, {"SERVO9_FUNCTION": 0.0, "RC1_MIN": 1100.0}])
def test_without_a_function_of_these_outputs_they_are_in_the_vessel_files_order(wired):
    read, notes = first_us(pulses(o1=1510, o2=1520, o3=1530, o4=1540), wired)
    assert read == dict(zip(NAMES, (1510, 1520, 1530, 1540), strict=True)) and not notes


def test_without_a_vessel_file_what_is_no_thruster_is_left_out():
    """A relay on output 13, and one slip of another output, which is left blank later on."""
    groups = pulses(o1=1500, o13=700)
    groups[1] = groups[1] * 10
    groups[1][3] = (3, 3000, *groups[1][3][2:])
    read, notes = first_us(groups, {}, None)
    assert list(read) == ["out1"]
    (note,) = notes
    assert note.text.startswith("output 13: 200 of 200 pulses are none of a thruster, 700 us")
