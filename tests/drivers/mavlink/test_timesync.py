import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.mavlink.timesync import MAX_AGE_NS, MAX_ROUND_TRIP_NS, ODD_LIMIT, ClockOffset

MS = 1_000_000
S = 1_000_000_000


class Device:
    """A clock that runs fast by `ppm` since companion time `boot_ns`, behind a link with random delays."""

    def __init__(self, seed: int, boot_ns: int, ppm: float = 0.0, mean_delay_ms: float = 3.0) -> None:
        self.rng = random.Random(seed)
        self.boot_ns, self.ppm, self.mean_delay_ms = boot_ns, ppm, mean_delay_ms

    def clock(self, t_ns: int) -> int:
        return round((t_ns - self.boot_ns) * (1 + self.ppm * 1e-6))

    def delay(self) -> int:
        return round((0.5 + self.rng.expovariate(1 / self.mean_delay_ms)) * MS)

    def ask(self, offset: ClockOffset, t_ns: int) -> bool:
        ts1 = offset.question(t_ns)
        there = t_ns + self.delay()
        return offset.answer(self.clock(there), ts1, there + self.delay())


@settings(deadline=None)
@given(st.integers(0, 1000), st.floats(-50, 50), st.floats(0.1, 20))
def test_offset_is_right_within_the_physical_bound(seed: int, ppm: float, mean_delay_ms: float):
    """|error| <= half the longest round trip among the best ones, plus the drift over the window."""
    device, offset = Device(seed, 7 * S, ppm, mean_delay_ms), ClockOffset()
    trips = []
    for i in range(60):
        t_ns = 100 * S + i * S // 2
        before = device.rng.getstate()
        trips.append(device.delay() + device.delay())
        device.rng.setstate(before)
        device.ask(offset, t_ns)
    now = 130 * S
    bound_ns = sorted(trips[-20:])[4] // 2 + 10 * S * 50e-6 + 1
    assert offset.offset_ns is not None
    assert abs(device.clock(now) + offset.offset_ns - now) <= bound_ns


def test_queueing_in_one_direction_is_shrugged_off():
    """Seven in eight answers are held up by 40 ms, the first three too: a median would be wrong by 20 ms."""
    offset = ClockOffset()
    for i in range(40):
        t_ns = 10 * S + i * S // 2
        offset.question(t_ns)
        offset.answer(t_ns + MS - 3 * S, t_ns, t_ns + 2 * MS + (0 if i % 8 == 3 else 40 * MS))
    assert offset.offset_ns == 3 * S


def test_before_the_first_answer_the_arrival_counts():
    offset = ClockOffset()
    assert offset.to_companion("A", 5 * S, 77 * S) == 77 * S


def synced(offset_ns: int = 10 * S, round_trip_ns: int = 2 * MS, times: int = 10) -> ClockOffset:
    offset = ClockOffset()
    for i in range(times):
        t_ns = 20 * S + i * S // 2
        assert offset.answer(t_ns + round_trip_ns // 2 - offset_ns, offset.question(t_ns), t_ns + round_trip_ns)
    return offset


def test_only_answers_to_our_own_questions_count_and_each_once():
    offset = synced()
    ts1 = offset.question(40 * S)
    assert not offset.answer(30 * S, ts1 + 1, 40 * S + MS)
    assert offset.answer(30 * S, ts1, 40 * S + MS)
    assert not offset.answer(30 * S, ts1, 40 * S + MS)
    assert offset.rejected == 2


@pytest.mark.parametrize("late_ns", [-1, MAX_ROUND_TRIP_NS + 1])
def test_impossible_or_slow_round_trips_are_rejected(late_ns: int):
    offset = synced()
    ts1 = offset.question(40 * S)
    assert not offset.answer(30 * S, ts1, ts1 + late_ns)
    assert offset.offset_ns == 10 * S


def test_one_outlier_is_rejected_a_step_is_followed():
    offset = synced()
    for i in range(ODD_LIMIT):
        t_ns = 40 * S + i * S // 2
        assert offset.offset_ns == 10 * S
        took = offset.answer(t_ns + MS - 9 * S - S // 2, offset.question(t_ns), t_ns + 2 * MS)
        assert took == (i == ODD_LIMIT - 1)
    assert offset.offset_ns == 9 * S + S // 2
    assert offset.reboots == 0


@settings(deadline=None)
@given(st.integers(0, 2**62), st.integers(0, 2**62))
def test_never_later_than_arrival_never_older_than_the_limit(device_ns: int, t_rx_ns: int):
    t_ns = synced().to_companion("A", device_ns, t_rx_ns)
    assert t_rx_ns - MAX_AGE_NS <= t_ns <= t_rx_ns


@settings(deadline=None)
@given(st.integers(0, MAX_AGE_NS))
def test_a_believable_stamp_is_converted_exactly(age_ns: int):
    assert synced().to_companion("A", 20 * S - age_ns, 30 * S) == 30 * S - age_ns


def test_a_counter_that_wraps():
    """SERVO_OUTPUT_RAW.time_usec has 32 bits: 71.6 minutes."""
    wrap = 2**32 * 1000
    offset = synced(offset_ns=-wrap)  # the device has been up for one wrap longer than the companion
    assert offset.to_companion("S", 29 * S - 5 * MS, 29 * S, wrap) == 29 * S - 5 * MS
    offset = synced(offset_ns=30 * S - wrap)
    assert offset.to_companion("S", wrap - 5 * MS, 30 * S - 3 * MS, wrap) == 30 * S - 5 * MS
    assert offset.to_companion("S", 4 * MS, 30 * S + 6 * MS, wrap) == 30 * S + 4 * MS
    assert offset.reboots == 0


def test_reboot_seen_in_a_stamp_forgets_the_offset_until_the_next_answer():
    offset = synced()
    assert offset.to_companion("A", 20 * S - 5 * MS, 30 * S) == 30 * S - 5 * MS
    assert offset.to_companion("A", S, 36 * S) == 36 * S
    assert (offset.reboots, offset.offset_ns) == (1, None)
    assert offset.answer(2 * S, offset.question(37 * S), 37 * S + 2 * MS)
    assert offset.offset_ns == 35 * S + MS
    assert offset.to_companion("A", 3 * S, 38 * S + 4 * MS) == 38 * S + MS
    assert offset.reboots == 1


def test_reboot_seen_in_an_answer():
    offset = synced()
    assert offset.answer(S, offset.question(40 * S), 40 * S + 2 * MS)
    assert (offset.reboots, offset.offset_ns) == (1, 39 * S + MS)


def test_streams_have_their_own_counters():
    """A boot clock beside a clock of the day is no reboot."""
    offset = ClockOffset()
    for i in range(3):
        offset.to_companion("A", i * S, i * S)
        offset.to_companion("B", 1_700_000_000 * S + i * S, i * S)
    assert offset.reboots == 0
