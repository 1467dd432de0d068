"""The excitation file: what is written reads back the same, what is wrong is named by file and key."""

import pytest
from hypothesis import given

from companion.boat.load_run import EXAMPLES
from companion.core.configuration.tables import ConfigError
from companion.core.excitation.file import Pulses, excitation_toml, load_excitation
from tests.support.excitation_fixture import LIBRARY, excitations

GOOD = """
format = 1
name = "x"
[[segments]]
kind = "steps"
name = "ahead"
X = 0.2
hold_s = 5.0
[[segments]]
kind = "multisine"
name = "all"
X = 0.1
Y = 0.1
N = 0.1
period_s = 10.0
f_max_Hz = 0.5
"""


@given(excitations)
def test_what_is_written_reads_back_the_same(excitation):
    assert load_excitation(excitation_toml(excitation, "made\nby a test"), name="x") == excitation


def test_the_library_reads_back_and_names_each_segment_once_with_a_reason():
    assert load_excitation(excitation_toml(LIBRARY), name="x") == LIBRARY
    names = [s.name for s in LIBRARY.segments]
    assert len(set(names)) == len(names) and all(s.why for s in LIBRARY.segments)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("format = 1", "format = 2", "format"),
        ("hold_s = 5.0", "hold_ss = 5.0", "segments[0].hold_ss: unknown key"),
        ("hold_s = 5.0", "", "segments[0].hold_s: missing key"),
        ("hold_s = 5.0", "hold_s = 0.0", "segments[0].hold_s"),
        ("hold_s = 5.0", "hold_s = inf", "segments[0].hold_s: expected a finite number"),
        ("X = 0.2", "X = 1.2", "segments[0].X"),
        ("X = 0.2", "X = 0.0", "segments[0].X: expected a share other than 0"),
        (
            'kind = "steps"',
            'kind = "jumps"',
            "segments[0].kind: expected steps, zigzag, multisine, pulses, opposed, idle, found 'jumps'",
        ),
        ("f_max_Hz = 0.5", "f_max_Hz = 0.2", "segments[1].f_max_Hz: expected at least 3 / period_s"),
        ("f_max_Hz = 0.5", "f_max_Hz = 5.0", "segments[1].f_max_Hz"),
        ("[[segments]]", "[[segment]]", "segment"),
        ("= 1", "== 1", "not valid TOML"),
    ],
)
def test_what_is_wrong_is_named_by_file_and_key(old, new, told):
    assert old in GOOD and load_excitation(GOOD, name="good.toml")
    with pytest.raises(ConfigError) as error:
        load_excitation(GOOD.replace(old, new, 1), name="my/plan.toml")
    assert str(error.value).startswith("my/plan.toml: ") and told in str(error.value)


def test_the_pulses_for_the_day_of_the_screwdriver_push_each_thruster_alone_and_never_drive_back():
    pulses = load_excitation((EXAMPLES / "excitations" / "pulses.toml").read_text(), name="pulses.toml")
    assert not pulses.homing
    assert all(isinstance(s, Pulses) and not s.thrusters and s.on_s < 2 for s in pulses.segments)
