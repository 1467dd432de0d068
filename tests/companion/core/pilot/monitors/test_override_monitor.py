"""Echoes against what was sent: what may be seen when, RC_CHANNELS, hands at the transmitter."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.core.messages import RcChannels
from companion.core.pilot.monitors.override_monitor import (
    MOVED_US,
    NOTHING_SENT,
    PERSISTS_NS,
    at_rc,
)
from companion.core.pilot.monitors.sent_pulses import SLACK_NS, WINDOW_NS, expected_pulses
from tests.companion.core.pilot.monitors.override_fixture import (
    CHANNELS,
    MS,
    NEUTRAL,
    at_tick,
    driving,
    heard,
    rc,
    sent,
)

# --- what may be seen ------------------------------------------------------------------------------------


def firsts(echo, t_ms):
    return [pwm[0] for pwm in expected_pulses(echo, t_ms * MS)]


def test_an_echo_may_show_what_was_in_force_at_any_instant_of_its_window():
    echo = driving(2000)
    assert (WINDOW_NS, SLACK_NS) == (500 * MS, 50 * MS)
    assert firsts(echo, 1000) == [1624, 1625, 1626, 1627, 1628, 1629, 1630], "the one at 400 ms until 500 ms"
    assert firsts(echo, 960) == [1624, 1625, 1626, 1627, 1628, 1629, 1630], "and the stamp may be 50 ms early"
    assert firsts(echo, 949) == [1624, 1625, 1626, 1627, 1628, 1629][:7]


def test_where_a_lease_has_run_out_neutral_may_be_seen():
    echo = sent((0, (1600, 1400, 1500)), (500, (1700, 1400, 1500)))
    assert firsts(echo, 200) == firsts(echo, 250) == [1600]
    assert firsts(echo, 251) == [1600, 1500], "50 ms of slack: it runs out at 300"
    assert firsts(echo, 800) == [1600, 1500, 1700, 1500] and firsts(echo, 801) == [1500, 1700, 1500]
    assert firsts(echo, 400) == [1600, 1500], "it ran out at 300 ms"
    assert firsts(echo, 600) == [1600, 1500, 1700]
    assert firsts(echo, 1100) == [1700, 1500], "and so did the other at 800"
    assert firsts(echo, 5000) == [1500]


def test_before_the_first_lease_nothing_is_expected():
    assert expected_pulses(NOTHING_SENT, 0) == [] and expected_pulses(sent((1000, NEUTRAL)), 900 * MS) == []


@settings(max_examples=100, deadline=None, derandomize=True)
@given(st.lists(st.integers(20, 900), min_size=1, max_size=25), st.integers(0, 20_000))
def test_the_lease_in_force_is_always_among_them(gaps, t_ms):
    """Against a plain search: at t the last lease sent is in force for 300 ms, then neutral."""
    times = [sum(gaps[: k + 1]) for k in range(len(gaps))]
    echo = sent(*((t, (1501 + k, 1500, 1500)) for k, t in enumerate(times)))
    past = [(t, 1501 + k) for k, t in enumerate(times) if t <= t_ms]
    if not past:
        return
    begun, pwm = past[-1]
    assert (pwm if t_ms <= begun + 300 else 1500) in firsts(echo, t_ms)


# --- RC_CHANNELS -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("off_us", "obeyed"), [(-2, False), (-1, True), (0, True), (1, True), (2, False)])
def test_what_was_sent_is_obeyed_to_a_microsecond(off_us, obeyed):
    _, found = heard(driving(5400), [rc(t, (1620 + t // 100, 1380 + off_us, 1500)) for t in range(3000, 5401, 200)])
    assert any(found) != obeyed


def test_another_pulse_is_ignored_overrides_after_a_second_and_a_half_and_no_more_once_it_follows():
    echo = driving(5400)
    echo, found = heard(echo, [rc(t, NEUTRAL) for t in range(3000, 4601, 100)])
    assert found == [t >= 3000 + PERSISTS_NS // MS for t in range(3000, 4601, 100)]
    echo, found = heard(echo, [rc(4700, (1667, 1380, 1500)), rc(4800, NEUTRAL), rc(5300, NEUTRAL)])
    assert found == [False, False, False], "counted anew"


@pytest.mark.parametrize("shown", [(1745, 1380, 1500), (0, 0, 0)])
def test_one_channel_or_all_of_them_are_told_apart(shown):
    echo = driving(5400)
    echo, _ = heard(echo, [rc(t, shown) for t in range(3000, 5001, 200)])
    _, found, _ = at_tick(echo, 5000 * MS, heard=True)
    why = found["override_ignored"]
    if shown[1]:
        assert "RC channel 9 shows 1745 us" in why and "somebody else" in why and "SYSID" not in why
    else:
        assert "SYSID_MYGCS (4.7: MAV_GCS_SYSID), which must be 1" in why
        assert "RC_OVERRIDE_TIME" in why and "RC_OPTIONS" in why


@pytest.mark.parametrize("delay_ms", [900, 2500])
def test_what_was_sent_earlier_is_late_and_nobody_else_s(delay_ms):
    """A slow autopilot shows each of our leases, long after it was sent."""
    echo = driving(5400)
    echo, found = heard(echo, [rc(t, (1620 + (t - delay_ms) // 100, 1380, 1500)) for t in range(3000, 5001, 200)])
    assert found[-1]
    why = at_tick(echo, 5000 * MS, heard=True)[1]["override_ignored"]
    assert "as was sent earlier" in why and "late or not at all" in why and "somebody else" not in why


def test_an_uplink_that_was_cut_leaves_our_last_pulses_and_nobody_else_is_named():
    """Without a receiver the autopilot goes on to show what it heard last, however long ago."""
    echo, _ = heard(driving(1000), [rc(t, (1620 + t // 100, 1380, 1500)) for t in range(500, 1001, 100)])
    echo = sent(*((t, (1500 + t // 100, 1400, 1500)) for t in range(1100, 9001, 100)), start=echo)
    echo, found = heard(echo, [rc(t, (1630, 1380, 1500)) for t in range(2000, 9001, 200)])
    why = at_tick(echo, 9000 * MS, heard=True)[1]["override_ignored"]
    assert found[-1] and "RC channel 9 shows 1630 us" in why and "as was sent earlier" in why


@pytest.mark.parametrize("period_ms", [154, 200])
@pytest.mark.parametrize("theirs_ms", [10, 20, 50, 80, 85])
def test_two_senders_that_take_turns_are_seen_whenever_ours_comes_between(theirs_ms, period_ms):
    """Ours at 0, 100, 200 ms; somebody's neutral so long after each. At 5 Hz the echo would always show the same."""
    echo, found = driving(9000), []
    for t in range(3000, 9000, period_ms):
        since_ms = t % 100
        shown = NEUTRAL if since_ms >= theirs_ms else (1620 + t // 100, 1380, 1500)
        echo, _ = at_rc(echo, rc(t, shown), CHANNELS, 1)
        found.append((t, echo.rc_ignored))
    first = min((t for t, ignored in found if ignored), default=None)
    if period_ms == 154:
        assert first is not None and first - 3000 <= 5000
        assert "somebody else overrides it too" in at_tick(echo, 9000 * MS, heard=True)[1]["override_ignored"]
    else:
        assert first is None, "which is why it is asked for at 6.5 Hz"


def test_gaps_that_are_rare_are_nobody_else():
    echo = driving(30000)
    for t in range(3000, 30000, 154):
        bad = t % 2600 < 300
        echo, _ = at_rc(echo, rc(t, NEUTRAL if bad else (1620 + t // 100, 1380, 1500)), CHANNELS, 1)
        assert not echo.rc_ignored


def test_a_lost_autopilot_is_not_blamed_for_its_channels():
    echo, _ = heard(driving(5400), [rc(t, (0, 0, 0)) for t in range(3000, 5001, 200)])
    assert echo.rc_ignored and at_tick(echo, 5000 * MS, heard=False)[1] == {}


def test_fewer_channels_than_ours_do_not_show_them():
    echo = driving(5400)
    for t in range(3000, 5001, 200):
        echo, _ = at_rc(echo, RcChannels(t_ns=t * MS, pwm_us=(1500,) * 8), CHANNELS, 1)
    assert echo.rc_ignored


# --- hands -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("before", "after", "taken"),
    [(1500, 1500 + MOVED_US, True), (1500, 1500 - MOVED_US, True), (1500, 1499 + MOVED_US, False), (0, 1900, False),
     (1900, 0, False), (1500, 65535, False)],
)  # fmt: skip
def test_a_channel_that_is_not_ours_and_moves_is_a_hand(before, after, taken):
    echo, first = at_rc(sent((0, NEUTRAL)), rc(100, NEUTRAL, c6=before), CHANNELS, 1)
    _, events = at_rc(echo, rc(300, NEUTRAL, c6=after), CHANNELS, 1)
    assert first == {} and list(events) == (["rc_takeover"] if taken else [])
    if taken:
        assert f"RC channel 6 from 1500 to {after} us" in events["rc_takeover"]


def test_a_slow_hand_is_one_too_and_is_told_once():
    echo, told = sent((0, NEUTRAL)), []
    for k in range(30):
        echo, events = at_rc(echo, rc(100 * k, NEUTRAL, c6=1500 + 10 * k), CHANNELS, 1)
        told += [k for _ in events]
    assert told == [20]


def test_our_own_channels_are_no_hand_and_a_receiver_that_comes_is_none():
    echo, _ = at_rc(driving(4000), rc(1000, (1620, 1380, 1500), c6=0), CHANNELS, 1)
    echo, events = at_rc(echo, rc(1200, (1900, 1100, 1900), c6=1100), CHANNELS, 1)
    assert events == {} and echo.base_us[5] == 1100
    assert at_rc(echo, rc(1400, NEUTRAL, c6=1300), CHANNELS, 1)[1] != {}
