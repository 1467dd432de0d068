"""Parameters that are watched: what is broadcast counts at once, what is not is asked for in turn."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise

from companion.core.messages import ParamValue
from drivers.mavlink.encode import MavlinkEncoder
from drivers.mavlink.parameter_watch import ASK_NS, ParameterChange, ParameterWatch
from tests.drivers.mavlink.mavlink_autopilot import read_one

S = 1_000_000_000
VALUES = {f"SERVO{n}_FUNCTION": 93.0 + n for n in range(1, 17)} | {f"P{n}": float(n) for n in range(130)}


def watch(relevant=()):
    return ParameterWatch(MavlinkEncoder(1, 191, 1, 1), VALUES, relevant)


def told(name, value):
    return ParamValue(t_ns=0, name=name, value=value, index=None, count=1000)


def asked(at, seconds):
    """Names asked for, with the instants [s]."""
    found = []
    for k in range(round(seconds * 20)):
        found += [(k / 20, read_one(frame).param_id) for frame in at.step((), k * S // 20)]
    return found


def test_everything_is_asked_for_in_turn_and_the_functions_most_often():
    found = asked(watch(), 140.0)
    assert len(found) <= 140.0 / (ASK_NS / S)
    count = Counter(name for _, name in found)
    assert set(count) == set(VALUES)
    for name in VALUES:
        when = [0.0, *(t_s for t_s, asked_for in found if asked_for == name)]
        limit_s = 8.5 if name.endswith("_FUNCTION") else 70.0
        assert max(b - a for a, b in pairwise(when)) <= limit_s


def test_a_change_is_told_once_and_the_same_value_is_none():
    at = watch()
    at.step([told("P5", 5.0), told("SERVO1_FUNCTION", 59.0), told("SERVO1_FUNCTION", 59.0)], 0)
    assert at.take_changes() == [ParameterChange("SERVO1_FUNCTION", 94.0, 59.0)]
    assert at.take_changes() == [] and at.values["SERVO1_FUNCTION"] == 59.0


def test_a_parameter_that_nobody_asked_for_counts_only_where_it_is_relevant():
    at = watch(relevant=["SCR_ENABLE"])
    at.step([told("SCR_ENABLE", 0.0), told("CRUISE_SPEED", 3.0)], 0)
    (change,) = at.take_changes()
    assert str(change) == "SCR_ENABLE is 0 now (not told before)" and "CRUISE_SPEED" not in at.values


def test_nothing_known_nothing_asked():
    assert ParameterWatch(MavlinkEncoder(1, 191, 1, 1), {}, ()).step((), S) == []
