"""What leaves a pulse on a thruster in the simulated autopilot is refused by the pre-flight check; ours are not."""

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests.sim.world.wirings.checks_oracle import Judge

WIRINGS = ("gate", "scaled", "omni", "unsafe_plain")
STICKS, PILOT = (1500,) * 16, (1500,) * 8 + (1450,) * 4 + (1500,) * 4
RECEIVERS = [(), STICKS[:8], STICKS, PILOT]

VALUES: dict[str, tuple[float, ...]] = {
    **{
        f"SERVO{n}_FUNCTION": (0, 33, 34, 35, 36, 51, 53, 59, 60, 62, 94, 95, 97, 140, 148, 149, 151)
        for n in range(1, 5)
    },
    **{f"SERVO{n}_TRIM": (1100, 1480, 1500, 1700) for n in range(1, 5)},
    **{f"SERVO{n}_{key}": (1100, 1500, 1900) for n in (1, 4) for key in ("MIN", "MAX")},
    **{f"RC{n}_TRIM": (1300, 1500, 1600) for n in (1, 3, 9, 12)},
    **{f"{name}_REVERSED": (0, 1) for name in ("SERVO1", "RC9")},
    "FS_THR_ENABLE": (0, 1, 2),
    "FS_THR_VALUE": (0, 910, 1600),
    "FS_ACTION": (0, 2, 5),
    "FS_GCS_ENABLE": (0, 1),
    "FS_TIMEOUT": (1.5, 100),
    "FS_GCS_TIMEOUT": (5, 120),
    "RC_OVERRIDE_TIME": (-1, 0, 0.5, 3, 10, 60),
    "SERVO_RC_FS_MSK": (0, 256, 3584, 3840),
    "SCR_ENABLE": (0, 1),
    "SYSID_MYGCS": (1, 255),
    "MODE_CH": (0, 8, 9),
    "MODE4": (0, 4),
    "RCMAP_THROTTLE": (3, 9),
    "RCMAP_ROLL": (1, 9),
    "ARMING_RUDDER": (0, 2),
    "FRAME_TYPE": (0, 2),
    "BRD_SAFETY_DEFLT": (0, 1),
}
change = st.sampled_from(sorted(VALUES)).flatmap(lambda name: st.tuples(st.just(name), st.sampled_from(VALUES[name])))


@settings(max_examples=150, deadline=None, derandomize=True)
@given(
    st.sampled_from(WIRINGS), st.lists(change, max_size=3).map(dict), st.sampled_from(RECEIVERS),
    st.sampled_from(["4.6", "4.7"]), st.sampled_from([1300, 1700]),
)  # fmt: skip
@example("gate", {"FS_THR_ENABLE": 0, "FS_GCS_ENABLE": 0}, (), "4.6", 1700)
@example("omni", {"FS_THR_ENABLE": 0, "FS_ACTION": 0}, (), "4.7", 1300)
@example("scaled", {"SERVO_RC_FS_MSK": 3584}, (), "4.6", 1700)
@example("gate", {"RC_OVERRIDE_TIME": -1, "FS_GCS_ENABLE": 0}, STICKS, "4.6", 1700)
def test_a_thruster_that_would_still_turn_is_always_refused(wiring, changes, receiver_us, firmware, us):
    judge = Judge(changes, wiring=wiring, receiver_us=receiver_us, firmware=firmware)
    refused = judge.refused()
    assert refused or not judge.turns_after_death(us)


HAZARDS = [
    ("unsafe_plain", {}, (), "SERVO1-4_FUNCTION"),
    ("gate", {"SERVO2_FUNCTION": 60}, (), "SERVO2_FUNCTION"),
    ("gate", {"FS_THR_ENABLE": 0, "FS_ACTION": 0}, (), "FS_THR_ENABLE"),
    ("gate", {"RC_OVERRIDE_TIME": -1, "FS_GCS_ENABLE": 0}, STICKS, "RC_OVERRIDE_TIME"),
    ("gate", {"RC_OVERRIDE_TIME": 60, "FS_GCS_ENABLE": 0}, STICKS[:8], "RC_OVERRIDE_TIME"),
    ("scaled", {"SERVO_RC_FS_MSK": 0}, (), "SERVO_RC_FS_MSK"),
    ("scaled", {"SERVO3_TRIM": 1700}, (), "SERVO3_TRIM"),
    ("scaled", {}, STICKS[:8], "RC receiver"),
    ("scaled", {}, PILOT, "RC receiver"),
    ("omni", {"SERVO4_TRIM": 1100}, (), "SERVO4_TRIM"),
    ("omni", {"FS_THR_ENABLE": 0, "FS_GCS_ENABLE": 0}, (), "FS_THR_ENABLE"),
]


@pytest.mark.parametrize("firmware", ["4.6", "4.7"])
@pytest.mark.parametrize(("wiring", "changes", "receiver_us", "name"), HAZARDS)
def test_hazards_are_real_and_named(wiring, changes, receiver_us, name, firmware):
    judge = Judge(changes, wiring=wiring, receiver_us=receiver_us, firmware=firmware)
    assert name in judge.refused()
    assert judge.turns_after_death(), "the oracle agrees that this is dangerous"
    row = next(row for row in judge.rows if row.name == name)
    assert row.fix and len(row.why.split()) > 5


@pytest.mark.parametrize(("name", "trim", "arms"), [("RC1_TRIM", 1503, False), ("RC3_TRIM", 1490, False),
                                                     ("RC4_TRIM", 1510, False), ("RC2_TRIM", 1490, True)])  # fmt: skip
def test_sticks_off_their_trim_are_refused_where_the_autopilot_would_not_arm(name, trim, arms):
    """As an RC calibration leaves it; the companion holds 1500 us."""
    judge = Judge({name: trim})
    assert judge.refused() == ([] if arms else [name])
    assert judge.arms() == arms


@pytest.mark.parametrize("us", [1499, 1501])
def test_a_throttle_failsafe_above_the_held_throttle_is_refused_where_it_would_not_arm(us):
    judge = Judge({"FS_THR_VALUE": us})
    assert judge.refused() == ([] if us < 1500 else ["FS_THR_VALUE"])
    assert judge.arms() == (us < 1500)


@pytest.mark.parametrize("firmware", ["4.6", "4.7"])
@pytest.mark.parametrize(
    ("wiring", "receiver_us"),
    [
        ("gate", ()),
        ("gate", STICKS[:8]),
        ("gate", STICKS),
        ("scaled", ()),
        ("scaled", STICKS),
        ("omni", ()),
        ("omni", PILOT),
    ],
)
def test_the_shipped_files_stop_and_are_refused_where_aritra_does_not_drive_them(wiring, receiver_us, firmware):
    judge = Judge(wiring=wiring, receiver_us=receiver_us, firmware=firmware)
    assert judge.refused() == (["SERVOn_FUNCTION"] if wiring == "omni" else [])
    assert not judge.turns_after_death()
    warned = [row.name for row in judge.rows if row.level == "warning"]
    assert (warned == []) == (wiring != "scaled")
