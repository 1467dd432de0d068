"""Verdicts from what was found, and files named by a user."""

import pytest
from boats import boat

from companion.core.config import ConfigError
from sim.diagnose.findings import Adequacy, verdict_of
from sim.diagnose.user import user_effects

GOOD, BAD = Adequacy(passed=True), Adequacy(passed=False, depends_on=("heading",))


@pytest.mark.parametrize(
    ("names", "rivals", "adequacy", "wanted"),
    [
        ([], {}, None, ("none", (), ())),
        ([], {}, GOOD, ("none", (), ())),
        ([], {}, BAD, ("unknown", (), ())),
        (["lag"], {}, GOOD, ("named", ("lag",), ())),
        (["lag"], {}, BAD, ("partial", ("lag",), ())),
        (["lag"], {"lag": [("dead_time", 5.9)]}, GOOD, ("ambiguous", ("lag",), ("dead_time",))),
        (["lag"], {"lag": [("dead_time", 6.1)]}, GOOD, ("named", ("lag",), ())),
        (["lag"], {"lag": [("dead_time", -2.0)]}, None, ("ambiguous", ("lag",), ("dead_time",))),
        (["lag", "dead_time"], {"lag": [("dead_time", 1.0)]}, GOOD, ("named", ("lag", "dead_time"), ())),
        (["lag", "wash"], {"lag": [("dead_time", 1.0)]}, BAD, ("partial", ("wash",), ("dead_time",))),
        (["lag"], {"lag": [("dead_time", 1.0)]}, BAD, ("unknown", (), ("dead_time",))),
        (["accel_bias"], {"accel_bias": [("tilt", 0.0)]}, GOOD, ("named", ("accel_bias",), ())),
    ],
)
def test_the_verdict(names, rivals, adequacy, wanted):
    assert verdict_of(names, rivals, {"accel_bias": ("tilt",)}, adequacy) == wanted


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("def effects(vessel:", "SyntaxError"),
        ("import nothing_of_that_name", "ModuleNotFoundError"),
        ("effects = 3", r"defines no function effects\(vessel\)"),
        ("def effects(vessel): return vessel.nothing", "effects: AttributeError"),
        ("def effects(vessel): return ['a current']", "expected Effect, found str"),
    ],
)
def test_what_is_wrong_with_a_users_file_is_said(tmp_path, text, words):
    path = tmp_path / "mine.py"
    path.write_text(text)
    with pytest.raises(ConfigError, match=rf"mine\.py: .*{words}|mine\.py: {words}"):
        user_effects(path)(boat("aritra"))
