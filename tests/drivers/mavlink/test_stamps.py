"""The time of a message: the companion's clock, from the autopilot's, by TIMESYNC questions that only we asked."""

from companion.core.messages import TimeSync
from drivers.mavlink.codec import MavlinkCodec
from tests.drivers.mavlink.mavlink_autopilot import Sender, read_one

T = 5_000_000_000


def test_stamps_become_companion_time_once_synchronised():
    codec, sender = MavlinkCodec(target_system=1), Sender()
    offset = 3_000_000_000  # the autopilot booted 3 s after the companion's clock began
    m = read_one(codec.timesync_question(T))
    assert (m.tc1, m.ts1) == (0, T)
    (answer,) = codec.feed(sender.timesync(T + 1_000_000 - offset, m.ts1), T + 2_000_000)
    assert answer == TimeSync(t_ns=T + 2_000_000, tc1_ns=T + 1_000_000 - offset, ts1_ns=T)
    now = T + 100_000_000
    device_ms = (now - 7_000_000 - offset) // 1_000_000
    frames = (
        sender.att(device_ms) + sender.imu(device_ms * 1000) + sender.servo_output_raw(device_ms * 1000, 0, *[1500] * 8)
    )
    assert [m.t_ns for m in codec.feed(frames, now)] == [now - 7_000_000] * 3
    (unsynced,) = MavlinkCodec(target_system=1).feed(sender.att(device_ms), now)
    assert (unsynced.t_ns, unsynced.t_rx_ns) == (now, now)


def test_a_fix_is_stamped_too_and_one_of_another_clock_is_no_reboot():
    """Some autopilots stamp GPS_RAW_INT by Unix time once they know it."""
    codec, sender = MavlinkCodec(target_system=1), Sender()
    question = read_one(codec.timesync_question(T))
    codec.feed(sender.timesync(T + 1_000_000 - 10**9, question.ts1), T + 2_000_000)
    device_us, now = 4_500_000, T + 700_000_000
    stamps = [
        codec.feed(sender.gps_raw_int(us, 3, 500000000, 80000000, 0, 0, 0, 0, 0, 9), now)[0].t_ns
        for us in (device_us, 1_700_000_000_000_000, device_us)
    ]
    assert stamps == [device_us * 1000 + 10**9, now, device_us * 1000 + 10**9]
    assert (codec.clock.reboots, codec.clock.offset_ns) == (0, 10**9)


def test_what_a_link_held_back_is_of_the_instant_of_its_measurement():
    """TCP over WiFi that stood still for 2.5 s."""
    codec, sender = MavlinkCodec(target_system=1), Sender()
    question = read_one(codec.timesync_question(T))
    codec.feed(sender.timesync(T + 1_000_000 - 10**9, question.ts1), T + 2_000_000)
    device_ms, now = [5000 + 20 * k for k in range(126)], T + 10**9 + 2_500_000_000
    fix = sender.gps_raw_int(5_100_000, 3, 500000000, 80000000, 0, 0, 0, 0, 0, 9)
    turned = codec.feed(b"".join(sender.att(ms) + sender.imu(1000 * ms) for ms in device_ms) + fix, now)
    measured_ns = [ms * 1_000_000 + 10**9 for ms in device_ms]
    assert [m.t_ns for m in turned] == [t for t in measured_ns for _ in range(2)] + [T + 1_100_000_000]


def test_a_fix_counts_once_and_never_as_a_new_one_when_the_receiver_was_unplugged():
    codec, sender = MavlinkCodec(target_system=1), Sender()
    question = read_one(codec.timesync_question(T))
    codec.feed(sender.timesync(T + 1_000_000 - 10**9, question.ts1), T + 2_000_000)

    def fixes(device_us: int, now_ns: int, fix_type: int = 3) -> list[int]:
        frame = sender.gps_raw_int(device_us, fix_type, 500000000, 80000000, 0, 0, 0, 100, 0, 9)
        return [m.t_ns for m in codec.feed(frame, now_ns)]

    first_us, second_us = 4_100_000, 5_100_000
    assert fixes(first_us, T + 200_000_000) == [first_us * 1000 + 10**9]
    assert fixes(first_us, T + 400_000_000) == []
    assert fixes(second_us, T + 1_200_000_000) == [second_us * 1000 + 10**9]
    told = [t for k in range(20) for t in fixes(second_us, T + 1_400_000_000 + k * 200_000_000)]
    assert told == [], "it stays for 4 s"
    assert codec.counters.repeated["GPS_RAW_INT"] == 21
    lost_ns = [T + k * 10**9 for k in (6, 7)]
    assert [t for now_ns in lost_ns for t in fixes(second_us, now_ns, 1)] == lost_ns, "no fix, each time"
    assert fixes(12_000_000, T + 8 * 10**9) == [T + 8 * 10**9]


def test_answers_to_others_and_second_answers_are_as_if_they_had_never_come():
    codec, sender = MavlinkCodec(target_system=1), Sender()
    question = read_one(codec.timesync_question(T))
    for asked_ns in (T - 5, T + 5, 1_760_000_000 * 10**9):  # another companion's; one that asks with Unix time
        assert codec.feed(sender.timesync(77, asked_ns), T + 9) == []
    assert len(codec.feed(sender.timesync(77, question.ts1), T + 9)) == 1
    assert codec.feed(sender.timesync(77, question.ts1), T + 9) == [], "the same once more"
    assert codec.counters.ignored["TIMESYNC"] == 4 and codec.counters.received["TIMESYNC"] == 5
    assert [m.tc1_ns for m in codec.feed(sender.timesync(0, 5), T)] == [0], "a question is for whoever can answer"


def test_timesync_answer_is_never_a_question():
    codec = MavlinkCodec(target_system=1)
    question = TimeSync(t_ns=0, tc1_ns=0, ts1_ns=77)
    assert read_one(codec.timesync_answer(question, 0)).tc1 == 1
    m = read_one(codec.timesync_answer(question, T))
    assert (m.tc1, m.ts1) == (T, 77)
