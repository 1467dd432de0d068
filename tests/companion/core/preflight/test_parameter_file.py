import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.core.configuration.tables import ConfigError
from companion.core.preflight.parameter_file import parse_parameters

NAMES = st.from_regex(r"[A-Z][A-Z0-9_]{0,15}", fullmatch=True)
VALUES = st.floats(allow_nan=False, allow_infinity=False)


@given(st.dictionaries(NAMES, VALUES, min_size=1), st.sampled_from([",", " ", "\t", "=", " = ", ", "]))
def test_what_is_written_is_read(values, between):
    text = "# a file\n\n" + "".join(f"{name}{between}{value!r}  # why\r\n" for name, value in values.items())
    assert parse_parameters(text, name="x") == values


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("A,1\nB", "f: line 2: expected NAME,VALUE"),
        ("A,1,2", "f: line 1: A: '1,2' is not a finite number"),
        ("a,1", "f: line 1: expected NAME,VALUE"),
        ("SEVENTEEN_LETTERS,1", "f: line 1: expected NAME,VALUE"),
        ("A,nan", "f: line 1: A: 'nan' is not a finite number"),
        ("A,inf", "f: line 1: A: 'inf' is not a finite number"),
        ("A,1\n\nA,1", "f: line 3: A is there twice"),
        (
            "SYSID_MYGCS,1\nMAV_GCS_SYSID,2",
            "f: line 2: MAV_GCS_SYSID is another name of SYSID_MYGCS, which has another",
        ),
        ("MAV_GCS_SYSID,1\nMAV_GCS_SYSID,1", "f: line 2: MAV_GCS_SYSID is there twice"),
        ("# nothing\n", "f: no parameters in it"),
    ],
)
def test_errors_name_file_and_line(text, complaint):
    with pytest.raises(ConfigError) as error:
        parse_parameters(text, name="f")
    assert str(error.value).startswith(complaint)


@given(st.text())
def test_any_text_is_read_or_refused(text):
    try:
        parse_parameters(text, name="f")
    except ConfigError as error:
        assert str(error).startswith("f: ")


def test_both_names_of_one_parameter_are_one():
    assert parse_parameters("MAV_GCS_SYSID,1\nA,2\nSYSID_MYGCS,1", name="f") == {"SYSID_MYGCS": 1.0, "A": 2.0}
