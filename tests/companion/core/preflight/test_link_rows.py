"""Rows on the link and on the boat at rest: one cause at a time makes one row worse, and says what to do."""

from dataclasses import replace

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.core.messages import (
    AutopilotInfo,
    Heartbeat,
    LinkStatus,
    RcChannels,
    ServoOutput,
    StatusText,
)
from companion.core.preflight.link import link_rows, receiver_seen, rest_rows
from companion.core.preflight.observations import Disk, RoundTrip
from companion.core.preflight.rows import worst
from tests.companion.core.preflight.observations_fixture import BEAT, COMPANION, WANTED, by_name, heard, told


def test_a_good_link_is_in_order():
    assert worst(by_name(link_rows(heard(), COMPANION)).values()) == "ok"


@pytest.mark.parametrize(
    ("changed", "name", "level", "word"),
    [
        ({"heartbeat": None, "mavlink": LinkStatus(t_ns=0, link="m", state="searching", reason="no bytes")},
         "heartbeat", "refuse", "no bytes"),
        *(({"heartbeat": msgspec.structs.replace(BEAT, vehicle_type=kind)}, "heartbeat", level, f"type {kind}")
          for kind, level in ((1, "refuse"), (2, "refuse"), (10, "warning"), (12, "refuse"))),
        ({"info": None}, "firmware", "warning", "not told"),
        ({"info": AutopilotInfo(t_ns=0, flight_sw_version=4 << 24 | 5 << 16, board_version=0, capabilities=0)},
         "firmware", "warning", "4.5.0"),
        ({"strangers": (7, 8)}, "autopilots", "refuse", "systems 1, 7 8"),
        ({"heartbeat": None, "strangers": (7,), "autopilot": 1}, "heartbeat", "refuse", "only of systems 7"),
        ({"deaf": True}, "signing", "refuse", "we have no key"),
        ({"lost": 30}, "lost frames", "warning", "30 of 1030"),
        ({"rates_hz": {**WANTED, "RAW_IMU": 0.0}}, "RAW_IMU", "refuse", "0.0 Hz"),
        ({"rates_hz": {**WANTED, "ATTITUDE": 30.0}}, "ATTITUDE", "warning", "30.0 Hz"),
        ({"rates_hz": {**WANTED, "RC_CHANNELS": 0.0}}, "RC_CHANNELS", "warning", "0.0 Hz"),
        ({"round_trips": ()}, "autopilot", "warning", "no answer"),
        ({"round_trips": tuple(RoundTrip(0.501, 1.0) for _ in range(5))}, "autopilot", "refuse", "501.0 ms"),
        ({"round_trips": tuple(RoundTrip(0.499, 1.0) for _ in range(5))}, "autopilot", "warning", "499.0 ms"),
        ({"round_trips": tuple(RoundTrip(0.08, 1.0) for _ in range(5))}, "autopilot", "warning", "80.0 ms"),
        ({"round_trips": tuple(RoundTrip(0.01, 0.03 * (k % 2)) for k in range(6))}, "autopilot", "warning", "15.0 ms"),
        ({"wall_s": 1000.0}, "boat's date", "warning", "never set"),
        ({"disk": Disk("logs", 10**11, newest_s=1.8e9 + 600)}, "boat's date", "warning", "newest log"),
    ],
)  # fmt: skip
def test_one_fault_of_the_link_is_the_row_that_says_so(changed, name, level, word):
    rows = by_name(link_rows(heard(**changed), COMPANION))
    assert rows[name].level == level and word in rows[name].found
    assert [n for n, row in rows.items() if row.level != "ok"] == [name]


def test_another_autopilot_is_in_order_where_ours_is_named():
    rows = by_name(link_rows(heard(strangers=(7,), autopilot=1), COMPANION))
    assert rows["autopilots"].level == "ok" and "nothing is taken from the others" in rows["autopilots"].why


@pytest.mark.parametrize(("minor", "word"), [(6, "silently caps"), (7, "denies")])
def test_streams_say_what_the_firmware_does_with_fast_ones(minor, word):
    info = AutopilotInfo(t_ns=0, flight_sw_version=4 << 24 | minor << 16, board_version=0, capabilities=0)
    rows = by_name(link_rows(heard(info=info, rates_hz={}), COMPANION))
    assert word in rows["ATTITUDE"].why and "SCHED_LOOP_RATE" in rows["ATTITUDE"].fix


REST_US = (1500,) * 4 + (0,) * 12


@pytest.mark.parametrize(
    ("wiring_name", "changed", "name", "level"),
    [
        ("gate", {}, None, None),
        ("gate", {"heartbeat": Heartbeat(**{**{f: getattr(BEAT, f) for f in BEAT.__struct_fields__}, "armed": True})},
         "armed", "refuse"),
        ("gate", {"texts": (StatusText(t_ns=0, severity=2, text="PreArm: Compass not calibrated"),)},
         "arming checks", "refuse"),
        ("gate", {"texts": (StatusText(t_ns=0, severity=2, text="PreArm: Radio failsafe on"),)}, None, None),
        ("gate", {"arming_told": False}, "arming checks", "warning"),
        ("gate", {"texts": (StatusText(t_ns=0, severity=3, text="gate: no output has SERVOn_FUNCTION 94"),)},
         "gate.lua", "refuse"),
        ("gate", {"texts": (StatusText(t_ns=0, severity=6, text="gate: thrusters on channels 9 10 11 13"),)},
         "gate.lua", "refuse"),
        ("gate", {"texts": (StatusText(t_ns=0, severity=6, text="gate: thrusters on channels 9 10 11 12"),)},
         None, None),
        ("gate", {"servo": ServoOutput(t_ns=0, pwm_us=(0,) * 16)}, "output 1-4", "refuse"),
        ("gate", {"servo": ServoOutput(t_ns=0, pwm_us=(1500, 1500, 1700, 1500))}, "output 1-4", "refuse"),
        ("scaled", {"servo": ServoOutput(t_ns=0, pwm_us=(0,) * 16)}, None, None),
        ("scaled", {"servo": ServoOutput(t_ns=0, pwm_us=(1100,) * 16)}, "output 1-4", "refuse"),
        ("omni", {"servo": ServoOutput(t_ns=0, pwm_us=(1900,) * 16)}, "output 1-4", "refuse"),
        ("gate", {"rc": RcChannels(t_ns=0, pwm_us=(1500,) * 16 + (0, 0))}, None, None),
        ("gate", {"rc": RcChannels(t_ns=0, pwm_us=(1500,) * 8 + (1000,) * 4 + (0,) * 6)}, "RC receiver", "refuse"),
        ("gate", {"rc": RcChannels(t_ns=0, pwm_us=(1500,) * 8 + (0,) * 10)}, None, None),
        ("scaled", {"rc": RcChannels(t_ns=0, pwm_us=(1500,) * 8 + (0,) * 10)}, "RC receiver", "refuse"),
        ("scaled", {"rc": RcChannels(t_ns=0, pwm_us=(1500,) * 4 + (0,) * 14)}, "RC receiver", "refuse"),
        ("omni", {"rc": RcChannels(t_ns=0, pwm_us=(1700,) * 8 + (0,) * 10)}, None, None),
    ],
)  # fmt: skip
def test_what_the_boat_does_at_rest(wiring_name, changed, name, level):
    seen = heard(
        **{"servo": ServoOutput(t_ns=0, pwm_us=REST_US), "rc": RcChannels(t_ns=0, pwm_us=(0,) * 18), **changed}
    )
    rows = by_name(rest_rows(seen, told(wiring_name), COMPANION))
    assert {n: row.level for n, row in rows.items() if row.level != "ok"} == ({name: level} if name else {})


@pytest.mark.parametrize(("still", "sticks_us", "level"), [((1, 2, 4), (0,) * 18, "refuse"), ((3,), (0,) * 18, "ok"),
                                                          ((), (1500,) * 8 + (0,) * 10, "ok")])  # fmt: skip
def test_without_a_receiver_somebody_holds_the_throttle_or_it_never_arms(still, sticks_us, level):
    seen = heard(servo=ServoOutput(t_ns=0, pwm_us=REST_US), rc=RcChannels(t_ns=0, pwm_us=sticks_us))
    rows = by_name(rest_rows(seen, told("gate"), replace(COMPANION, still=still)))
    assert rows["RC receiver"].level == level


@given(st.lists(st.sampled_from([0, 1500, 1700]), min_size=12, max_size=12))
def test_what_an_earlier_run_left_is_no_receiver(left):
    """Without a receiver only overridden channels have pulses; a run leaves them on both kinds."""
    pulses = [us if n in COMPANION.channels else 0 for n, us in enumerate(left, start=1)]
    pulses[8] = pulses[8] or 1500
    assert not receiver_seen((*pulses, *[0] * 6), COMPANION)
    assert receiver_seen((*pulses[:5], 1500, *pulses[6:], *[0] * 6), COMPANION)


def test_a_script_s_output_beside_scaled_ones_counts_once_scripts_may_run():
    """It may carry the thruster then, and is asked for all that the gate needs."""
    seen = heard(servo=ServoOutput(t_ns=0, pwm_us=REST_US), rc=RcChannels(t_ns=0, pwm_us=(0,) * 18))
    for enabled, level in ((0.0, None), (1.0, "refuse")):
        rows = by_name(rest_rows(seen, told("scaled", SCR_ENABLE=enabled), COMPANION))
        assert (rows["output 8"].level if "output 8" in rows else None) == level
