"""The rows of the pre-flight check: one cause at a time makes one row worse, and says what to do."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.core.preflight.autopilot import further_parameter_names, parameter_names, parameter_rows
from companion.core.preflight.parameter_diff import changes, unknown
from companion.core.preflight.rows import ParameterSet, numbers, worst
from companion.core.preflight.wiring import scaled_us, wiring
from tests.companion.core.preflight.observations_fixture import COMPANION, by_name, told


def levels(p, companion=COMPANION):
    return {row.name: row.level for row in parameter_rows(p, companion) if row.level != "ok"}


def test_the_recommended_wiring_is_all_in_order():
    assert levels(told("gate")) == {}
    by_name(parameter_rows(told("gate"), COMPANION))


@pytest.mark.parametrize(
    ("name", "value", "row", "level"),
    [
        ("SERVO1_FUNCTION", 59.0, "SERVO1_FUNCTION", "refuse"),
        ("SERVO9_FUNCTION", 1.0, "SERVO9_FUNCTION", "refuse"),
        ("SERVO5_FUNCTION", 55.0, "SERVO5_FUNCTION", "warning"),
        ("SERVO2_FUNCTION", 0.0, "SERVOn_FUNCTION", "refuse"),
        ("SERVO2_TRIM", 1530.0, "SERVO2_TRIM", "refuse"),
        ("SERVO2_TRIM", 1510.0, "SERVO1-4_TRIM", "warning"),
        ("SCR_ENABLE", 0.0, "SCR_ENABLE", "refuse"),
        ("FS_THR_ENABLE", 0.0, "FS_THR_ENABLE", "refuse"),
        ("FS_THR_VALUE", 1600.0, "FS_THR_VALUE", "refuse"),
        ("FS_THR_VALUE", 1400.0, "FS_THR_VALUE", "warning"),
        ("FS_ACTION", 0.0, "FS_ACTION", "warning"),
        ("FS_GCS_ENABLE", 0.0, "FS_GCS_ENABLE", "warning"),
        ("FS_TIMEOUT", 100.0, "FS_TIMEOUT", "warning"),
        ("FS_GCS_TIMEOUT", 600.0, "FS_GCS_TIMEOUT", "warning"),
        ("RC_OVERRIDE_TIME", -1.0, "RC_OVERRIDE_TIME", "refuse"),
        ("RC_OVERRIDE_TIME", 0.0, "RC_OVERRIDE_TIME", "refuse"),
        ("RC_OVERRIDE_TIME", 0.1, "RC_OVERRIDE_TIME", "warning"),
        ("RC_OVERRIDE_TIME", 3.0, "RC_OVERRIDE_TIME", "warning"),
        ("RC_OPTIONS", 34.0, "RC_OPTIONS", "refuse"),
        ("SYSID_MYGCS", 255.0, "SYSID_MYGCS", "refuse"),
        ("MAV_OPTIONS", 1.0, "MAV_OPTIONS", "warning"),
        ("SYSID_ENFORCE", 1.0, "SYSID_ENFORCE", "warning"),
        ("MAV_GCS_SYSID_HI", 2.0, "MAV_GCS_SYSID_HI", "warning"),
        ("ARMING_RUDDER", 2.0, "ARMING_RUDDER", "warning"),
        ("MODE_CH", 9.0, "MODE_CH", "refuse"),
        ("RCMAP_YAW", 12.0, "RCMAP_YAW", "warning"),
        ("RCMAP_THROTTLE", 7.0, "RCMAP_THROTTLE", "warning"),
        ("RC9_OPTION", 41.0, "RC9_OPTION", "refuse"),
        ("RC2_OPTION", 41.0, "RC2_OPTION", "warning"),
        ("BRD_SAFETY_DEFLT", 1.0, "BRD_SAFETY_DEFLT", "warning"),
        ("ARMING_REQUIRE", 0.0, "ARMING_REQUIRE", "warning"),
        ("ARMING_CHECK", 0.0, "ARMING_CHECK", "warning"),
        ("SERVO_AUTO_TRIM", 1.0, "SERVO_AUTO_TRIM", "warning"),
        ("ARMING_SKIPCHK", -1.0, "ARMING_SKIPCHK", "warning"),
        ("FRAME_CLASS", 1.0, "FRAME_CLASS", "warning"),
        ("FRAME_TYPE", 2.0, "FRAME_TYPE", "refuse"),
        ("RC3_TRIM", 1506.0, "RC3_TRIM", "refuse"),
        ("RC4_TRIM", 1494.0, "RC4_TRIM", "refuse"),
        ("RC1_TRIM", 1499.0, "RC1_TRIM", "refuse"),
        ("SERVO9_FUNCTION", 26.0, "SERVOn_FUNCTION", "refuse"),
        ("SERVO9_FUNCTION", 73.0, "SERVOn_FUNCTION", "refuse"),
    ],
)
def test_one_wrong_parameter_is_the_row_that_says_so(name, value, row, level):
    found = levels(told("gate", **{name: value}))
    assert found[row] == level
    assert set(found) - {row, "SERVOn_FUNCTION"} == set(), "and no other"


@pytest.mark.parametrize(
    "lets",
    [{"RC3_DZ": 30.0}, {"RC_OPTIONS": 0.0}, {"ARMING_CHECK": 16.0}, {"ARMING_SKIPCHK": 64.0}, {"RC3_TRIM": 1503.0},
     {"RCMAP_THROTTLE": 7.0}],
)  # fmt: skip
def test_a_throttle_off_its_trim_matters_only_where_arming_asks_for_it(lets):
    assert "RC3_TRIM" not in levels(told("gate", **{"RC3_TRIM": 1510.0} | lets))


def test_a_rudder_on_a_thruster_s_channel_is_refused():
    assert levels(told("gate", ARMING_RUDDER=2.0, RCMAP_ROLL=9.0))["ARMING_RUDDER"] == "refuse"


@pytest.mark.parametrize(
    ("changed", "row", "level"),
    [
        ({"SERVO_RC_FS_MSK": 3584.0}, "SERVO_RC_FS_MSK", "refuse"),
        ({"RC9_TRIM": 1300.0}, "RC9_*, SERVO1_*", "refuse"),
        ({"RC9_DZ": 20.0}, "RC9_*, SERVO1_*", "warning"),
        ({"SERVO1_REVERSED": 1.0}, "RC9_*, SERVO1_*", "warning"),
        ({"SERVO8_FUNCTION": 0.0}, "SERVOn_FUNCTION", "refuse"),
        ({"SERVO8_FUNCTION": 109.0}, "SERVOn_FUNCTION", "refuse"),
        ({"SERVO8_FUNCTION": 33.0}, "SERVOn_FUNCTION", "refuse"),
        ({"FS_ACTION": 2.0}, "FS_ACTION", "warning"),
    ],
)
def test_scaled_needs_more_and_warns_that_disarming_does_not_stop_it(changed, row, level):
    always = {"SERVO1-4_FUNCTION": "warning"}
    assert levels(told("scaled")) == always
    assert levels(told("scaled", **changed)) == {**always, row: level}


def test_the_hint_for_arming_is_one_that_makes_it_arm():
    p = told("scaled", SERVO8_FUNCTION=109.0)
    row = next(r for r in parameter_rows(p, COMPANION) if r.name == "SERVOn_FUNCTION")
    assert row.fix.startswith("set SERVO8_FUNCTION to 94")
    assert "SERVOn_FUNCTION" not in levels(told("scaled", SERVO8_FUNCTION=94.0))


def test_aritra_does_not_drive_the_mixer_and_the_check_says_so():
    assert levels(told("omni"))["SERVOn_FUNCTION"] == "refuse"


def test_the_mask_that_is_needed_is_told():
    row = next(r for r in parameter_rows(told("scaled", SERVO_RC_FS_MSK=1), COMPANION) if r.name == "SERVO_RC_FS_MSK")
    assert row.fix == "set it to 3841" and "9-12" in row.why


def test_the_slow_default_loop_is_told_with_the_latency_it_makes():
    rows = {r.name: r for r in parameter_rows(told("gate", SCHED_LOOP_RATE=50.0), COMPANION)}
    assert rows["SCHED_LOOP_RATE"].level == rows["control.latency_s"].level == "warning"
    assert "0.050" in rows["control.latency_s"].fix


def test_a_latency_that_was_meant_for_a_slower_gate_is_told():
    """Run files of before the gate was measured at 200 Hz said 0.03."""
    rows = {r.name: r for r in parameter_rows(told("gate"), replace(COMPANION, latency_s=0.03))}
    assert rows["control.latency_s"].level == "warning" and "0.015" in rows["control.latency_s"].fix


def test_outputs_beyond_16_are_asked_for_and_judged_where_they_are_in_use():
    p = told("gate", SERVO_32_ENABLE=1.0)
    assert "SERVO17_FUNCTION" in further_parameter_names(p) and not further_parameter_names(told("gate"))
    more = {f"SERVO{n}_FUNCTION": 0.0 for n in range(17, 33)} | {"SERVO_32_ENABLE": 1.0}
    assert levels(told("gate", **more | {"SERVO20_FUNCTION": 60.0})) == {"SERVO20_FUNCTION": "refuse"}
    assert levels(told("gate", SERVO_32_ENABLE=1.0)) == {"SERVO17-32_FUNCTION": "refuse"}, "and none was told"
    assert "SERVO17_FUNCTION" not in parameter_names(COMPANION)


@pytest.mark.parametrize(("lowest", "highest", "taken"), [(1.0, 1.0, True), (2.0, 9.0, False), (0.0, 9.0, True)])
def test_overrides_of_a_range_of_systems_are_taken(lowest, highest, taken):
    found = levels(told("gate", SYSID_MYGCS=lowest, MAV_GCS_SYSID_HI=highest))
    assert ("SYSID_MYGCS" not in found) is taken and ("MAV_GCS_SYSID_HI" in found) is (highest > lowest)


def test_both_spellings_are_understood():
    values = dict(told("gate").values)
    values["MAV_GCS_SYSID"] = values.pop("SYSID_MYGCS")
    assert levels(ParameterSet(values)) == {}
    values["MAV_GCS_SYSID"] = 255.0
    assert levels(ParameterSet(values)) == {"MAV_GCS_SYSID": "refuse"}
    assert {"SYSID_MYGCS", "MAV_GCS_SYSID"} <= set(parameter_names(COMPANION))


@given(st.sets(st.sampled_from(sorted(told("gate").values))))
def test_a_parameter_that_was_not_told_is_never_taken_for_good(silent):
    """What decides about stopping refuses when it is unknown."""
    p = ParameterSet({name: value for name, value in told("gate").values.items() if name not in silent})
    vital = {f"SERVO{n}_FUNCTION" for n in range(1, 17)} | {f"SERVO{n}_TRIM" for n in range(1, 5)}
    vital |= {"SCR_ENABLE", "FS_THR_ENABLE", "RC_OVERRIDE_TIME", "SYSID_MYGCS"}
    assert (worst(parameter_rows(p, COMPANION)) == "refuse") == bool(silent & vital)


def test_an_output_whose_answer_was_lost_may_carry_anything():
    """As on a slow link: the answers of outputs 9 and 10, plain pass-through of two thrusters, never came."""
    p = told("gate", SERVO9_FUNCTION=59.0, SERVO10_FUNCTION=60.0)
    heard_of = ParameterSet({k: v for k, v in p.values.items() if k not in ("SERVO9_FUNCTION", "SERVO10_FUNCTION")})
    assert levels(p) == levels(heard_of) == {"SERVO9 10_FUNCTION": "refuse"}


@given(st.integers(1100, 1900))
def test_the_scaled_file_is_one_to_one(us):
    p = told("scaled")
    assert [scaled_us(p, o, us) for o in wiring(p, COMPANION).of("scaled")] == pytest.approx([us] * 4)


@given(st.sets(st.integers(1, 32)))
def test_runs_of_numbers_say_the_same_numbers(values):
    spans = [part.split("-") for part in numbers(values).split()]
    assert {n for span in spans for n in range(int(span[0]), int(span[-1]) + 1)} == values


def test_the_difference_to_a_file():
    values = {"MAV_GCS_SYSID": 255.0, "FS_TIMEOUT": 1.5000000596, "A": 1.0}
    found = changes(values, {"SYSID_MYGCS": 1.0, "FS_TIMEOUT": 1.5, "A": 1.0, "B": 2.0})
    assert [(c.name, c.found, c.wanted) for c in found] == [("MAV_GCS_SYSID", 255.0, 1.0), ("B", None, 2.0)]
    assert unknown(found) == ["B"] and not found[0].reboot
