"""Sticks: the dead man's grip in time, in hands and in numbers; forces by the thrusters' own reach."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.core.control.allocation import allocate
from companion.core.messages import ManualInput
from companion.core.model.thrusters import configuration_matrix
from companion.core.pilot.manual_control import (
    AHEAD_NS,
    AT_REST,
    NOBODY,
    StickForce,
    StickMonitor,
    locked,
    rejection,
    silent,
)
from tests.support.drive_fixture import setup

MS = 1_000_000
VESSEL = setup().pilot.vessel


def stick(t_ms, surge=0.0, sway=0.0, yaw=0.0, source="pad"):
    return ManualInput(t_ns=t_ms * MS, surge=surge, sway=sway, yaw=yaw, source=source)


def hear(sticks, message, t_ns, timeout_s):
    sticks, report = StickMonitor(timeout_s).on_message(sticks, message, t_ns)
    assert not report.events and not report.alerts
    return sticks


def after(*inputs, start=NOBODY):
    """Each input heard at its own instant, timeout 0.5 s."""
    sticks = start
    for message in inputs:
        sticks = hear(sticks, message, message.t_ns, 0.5)
    return sticks


def test_a_stick_that_is_held_from_the_beginning_does_nothing():
    sticks = after(*(stick(k * 100, 0.6) for k in range(20)))
    assert "have not been at rest" in (rejection(sticks, 1900 * MS, 0.5) or "")


@pytest.mark.parametrize(("share", "free"), [(AT_REST, False), (-AT_REST, False), (0.0499, True), (-0.0499, True)])
@pytest.mark.parametrize("axis", ["surge", "sway", "yaw"])
def test_rest_is_all_three_below_a_twentieth(axis, share, free):
    assert AT_REST == 0.05
    sticks = after(stick(0, **{axis: share}), stick(100, 0.6))
    assert (rejection(sticks, 100 * MS, 0.5) is None) == free


def test_half_a_second_of_silence_locks_until_the_next_rest():
    sticks = after(stick(0), stick(100, 0.6))
    assert rejection(sticks, 600 * MS, 0.5) is None
    assert "nothing from the sticks (pad) for 0.6 s" in (rejection(sticks, 701 * MS, 0.5) or "")
    back = after(stick(702, 0.6), stick(800, 0.6), start=sticks)
    assert silent(back, 800 * MS, 0.5) is None and rejection(back, 800 * MS, 0.5) is not None
    assert rejection(after(stick(900), stick(1000, 0.9), start=back), 1000 * MS, 0.5) is None


def test_another_hand_must_have_been_at_rest_too():
    sticks = after(stick(0), stick(100, 0.6), stick(150, 0.5, source="keyboard"))
    assert "keyboard" in (rejection(sticks, 150 * MS, 0.5) or "")
    assert rejection(after(stick(200, source="keyboard"), start=sticks), 200 * MS, 0.5) is None


@pytest.mark.parametrize(
    "bad",
    [stick(200, math.nan), stick(200, yaw=math.inf), stick(200, 1.01), stick(200, sway=-1.5), stick(50, 0.9)],
    ids=["nan", "inf", "beyond", "beyond back", "out of order"],
)
def test_what_cannot_be_is_silence(bad):
    sticks = after(stick(0), stick(100, 0.6))
    assert hear(sticks, bad, 200 * MS, 0.5) == sticks


def test_a_stamp_from_the_future_is_silence():
    sticks = after(stick(0), stick(100, 0.6))
    assert hear(sticks, stick(200 + AHEAD_NS // MS + 1, 0.9), 200 * MS, 0.5) == sticks
    assert hear(sticks, stick(200 + AHEAD_NS // MS, 0.9), 200 * MS, 0.5) != sticks


def test_locked_sticks_must_come_to_rest_again():
    sticks = locked(after(stick(0), stick(100, 0.6)))
    assert rejection(sticks, 100 * MS, 0.5) is not None
    assert rejection(after(stick(150, 0.6), start=sticks), 150 * MS, 0.5) is not None
    assert rejection(after(stick(150, 0.01), start=sticks), 150 * MS, 0.5) is None


shares = st.floats(-1, 1)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(shares, shares, shares)
def test_force_has_the_signs_of_the_sticks_and_one_axis_alone_is_reached(surge, sway, yaw):
    force = StickForce(VESSEL)
    tau = force.tau(after(stick(0, surge, sway, yaw)))
    assert all(t * s >= 0 for t, s in zip(tau, (surge, sway, yaw), strict=True))
    B = configuration_matrix(VESSEL)
    for k, (axis, share) in enumerate((("surge", surge), ("sway", sway), ("yaw", yaw))):
        alone = force.tau(after(stick(0, **{axis: share})))
        given = B @ allocate(alone, VESSEL)
        assert given == pytest.approx(alone, abs=0.05), "what one stick asks for, the thrusters give"
        assert alone[k] == tau[k]


def test_full_stick_is_all_there_is():
    """Four thrusters at 45 degrees, 38 N ahead, 30 N astern each: 4 x 38 / sqrt 2 ahead."""
    tau = StickForce(VESSEL).tau(after(stick(0, 1.0)))
    assert tau == pytest.approx([4 * 38 / np.sqrt(2), 0, 0], rel=1e-3)
    assert StickForce(VESSEL).tau(after(stick(0, -1.0)))[0] == pytest.approx(-4 * 30 / np.sqrt(2), rel=1e-3)
    assert (StickForce(VESSEL).tau(NOBODY) == 0).all()
