"""Faults of the stepped world: the boat notices, says what it is, and drives on where it can. Seeds stated."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.world.environment import Weather
from tests.fault_lab.draw import draw
from tests.fault_lab.fault import Fault, parse
from tests.fault_lab.trial import trial
from tests.fault_lab.weather import sound_in_weather
from tests.support.drive_fixture import setup

THRUSTERS = setup(None).pilot.vessel.thrusters
WAYPOINTS = len(setup(None).pilot.mission.path.points)


@given(seed=st.integers(0, 10**6))
def test_a_line_says_a_fault_and_a_fault_its_line(seed):
    fault = draw(seed)
    assert parse(str(fault)) == fault or str(parse(str(fault))) == str(fault)


@pytest.mark.parametrize("line", ["thruster 1 tired", "uwb noise", "uwb frozen 3", "rudder dead"])
def test_what_is_no_fault_is_refused(line):
    with pytest.raises(ValueError, match=r"no fault|size"):
        parse(line)


@pytest.mark.long
def test_a_boat_without_a_fault_is_not_accused():
    verdict = trial(3, duration_s=60.0)
    assert not verdict.failed and verdict.named == () and verdict.mode == "auto"
    assert [text for _, level, text in verdict.alerts if level != "info"] == []


@pytest.mark.long
def test_a_sound_boat_that_starts_in_waves_is_not_stopped():
    weather = Weather(V_c_m_s=0.15, V_w_m_s=5.0, gustiness=0.3, H_s_m=0.25, T_p_s=2.4, beta_w_deg=207)
    verdict = trial(83007, weather=weather, duration_s=30.0, mismatch=0.2)
    assert {cause for _, cause, _ in verdict.named} <= {"surroundings"} and verdict.mode == "auto"


@pytest.mark.long
@pytest.mark.parametrize(
    ("seed", "duration_s"),
    [
        (30146, 14.0),  # a thruster was stuck, in waves
        (30240, 43.0),  # gusts: slip of 0.55 m/s
        (30078, 157.0),  # gusts while it held its place: anchors were turned
        (30230, 182.0),  # a reflection was over: the estimate jumped by 2 m
    ],
)
def test_a_sound_boat_in_weather_is_not_stopped(seed, duration_s):
    verdict = sound_in_weather(seed, duration_s)
    assert verdict.named == () and verdict.mode == "auto"


@pytest.mark.long
@pytest.mark.parametrize("number", [1, 2, 3, 4])
def test_a_thruster_that_sticks_is_named_before_the_boat_has_left_its_place(number):
    verdict = trial(80001, f"thruster {number} stuck 1900 from 25", duration_s=60.0)
    t_s, cause, what = verdict.named[0]
    assert (cause, what) == ("thruster", THRUSTERS[number - 1].name) and t_s < 26.5
    assert verdict.mode == "safe" and verdict.true_farthest_m < 0.0


@pytest.mark.long
def test_a_thruster_that_sticks_at_more_than_was_believed_at_first_stops_the_boat_after_all():
    """Named at -10 N, it drove on for the whole mission: 16 N take 42 % of all thrust to hold against."""
    verdict = trial(110025, "thruster 1 stuck 1264.6 from 34.5", duration_s=45.0)
    assert verdict.mode == "safe" and not verdict.failed
    assert any(text.startswith("thruster front_port") and text.endswith("not -10 N") for _, _, text in verdict.alerts)


@pytest.mark.long
@pytest.mark.parametrize(
    ("seed", "line"),
    [
        (90002, "gyro flipped from 30"),
        (90001, "heading offset 60 from 0"),
        (91078, "gyro stuck from 30.8"),
        (10016, "uwb rotated 228.81 from 3.1 to 14"),
    ],
)
def test_a_sensor_that_is_wrong_is_no_thruster(seed, line):
    """Each was taken for thrusters that have changed places, or for a dead one."""
    verdict = trial(seed, line, duration_s=45.0)
    assert verdict.named[0][1] == "sensor" and not verdict.failed


@pytest.mark.long
def test_a_reversed_thruster_that_was_found_is_not_taken_for_anchors_that_stand_elsewhere():
    """Ten seconds later, by a path that had been reckoned without knowing."""
    verdict = trial(93212, "thruster 2 reversed from 7.8", duration_s=40.0)
    assert [what for _, _, what in verdict.named] == ["front_starboard"] and verdict.mode == "auto"


@pytest.mark.long
def test_a_push_is_no_thruster():
    """It was taken for one that sticks at 25 N."""
    verdict = trial(84009, "boat pushed 24.6 from 25.7 to 30.7", duration_s=60.0)
    assert not [named for named in verdict.named if named[1] == "thruster"] and not verdict.failed


@pytest.mark.long
def test_a_reversed_thruster_is_named_within_seconds_and_the_boat_drives_on():
    verdict = trial(4, "thruster 1 reversed from 25", duration_s=60.0)
    assert not verdict.failed and verdict.mode == "auto" and verdict.high_s < 1.0
    ((t_s, cause, what),) = verdict.named
    assert (cause, what) == ("thruster", "front_port") and t_s < 31.0


def test_frozen_ranges_are_left_out_and_end_in_neutral():
    verdict = trial(5, "uwb frozen from 20", duration_s=42.0)
    assert not verdict.failed and verdict.healthy_wrong_s == 0.0 and verdict.mode == "safe"
    assert verdict.named[0][1:] == ("sensor", "position") and verdict.first_alert_s(20.0) <= 4.0


@pytest.mark.long
def test_mirrored_anchors_are_noticed_as_soon_as_the_boat_moves():
    verdict = trial(6, "uwb mirrored from 0", duration_s=40.0)
    assert not verdict.failed and verdict.mode == "safe" and verdict.beyond_s == 0.0


@pytest.mark.long
def test_a_boat_whose_accelerometer_shakes_says_so_and_drives_on():
    """40 times as noisy as its file says. It was stopped before; a quarter of that noise took the estimate 5 m off."""
    verdict = trial(2, "accel noise 2.0 from 30")
    assert not verdict.failed and verdict.passed == WAYPOINTS and verdict.mode == "auto"
    assert verdict.wrong_m < 1.0 and verdict.cross_m < 0.15
    assert verdict.named[0][1:] == ("sensor", "accel") and verdict.first_alert_s(30.0) < 3.0


LONG = (
    "thruster 2 dead from 25",
    "thruster 3 swapped 4 from 25",
    pytest.param("thruster 2 swapped 3 from 25", marks=pytest.mark.matrix),
    pytest.param("thruster 4 weak 0.4 from 25", marks=pytest.mark.matrix),
)


@pytest.mark.long
@pytest.mark.parametrize("line", LONG)
def test_the_mission_ends_with_three_sound_thrusters(line):
    verdict = trial(7, line)
    assert verdict.passed == WAYPOINTS and verdict.mode == "auto" and verdict.high_s < 3.0


@pytest.mark.long
@pytest.mark.parametrize("seed", [500, *(pytest.param(s, marks=pytest.mark.matrix) for s in range(501, 506))])
def test_random_faults_leave_no_boat_that_is_confidently_wrong(seed):
    verdict = trial(seed, draw(seed))
    assert not verdict.failed, verdict


def test_faults_end_when_they_are_over():
    fault = Fault("uwb", "noise", size=1.0, from_s=5.0, to_s=6.0)
    assert [fault.acts(t) for t in (4.9, 5.0, 5.9, 6.0)] == [False, True, True, False]
