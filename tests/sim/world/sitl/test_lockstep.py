"""The lockstep with the firmware: a state leaves only as the answer to a servo packet."""

from dataclasses import replace
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.world.sitl.backend import LONGEST_FRAME_NS, SILENT_NS, JsonBackend, frame_ns
from tests.sim.world.sitl.json_firmware import parse
from tests.sim.world.sitl.sitl_fixture import AT_REST, MS, S, packet


class Clockwork:
    """A world that counts."""

    def __init__(self):
        self.t_ns, self.steps, self.restarts, self.pulses = 0, [], 0, ()

    def advance(self, outputs_us, frame_ns):
        self.t_ns += frame_ns
        self.steps.append(frame_ns)
        self.pulses = outputs_us
        return replace(AT_REST, timestamp_s=self.t_ns * 1e-9), b"uwb"

    def restart(self):
        self.t_ns = 0
        self.restarts += 1


class Line:
    """A backend with a firmware's packets, 5 ms apart."""

    def __init__(self):
        self.world, self.now_ns = Clockwork(), 7 * S
        self.backend = JsonBackend(self.world)

    def send(self, count, *, sender="a", after_ns=5 * MS, **told):
        self.now_ns += after_ns
        return self.backend.receive(packet(count, **told), sender, self.now_ns)

    def time_of(self, answer):
        return parse(answer.data.decode("ascii"))["timestamp"]


@pytest.fixture
def line():
    return Line()


def test_a_state_leaves_only_as_the_answer_to_a_servo_packet(line):
    for _ in range(100):
        line.now_ns += S
        line.backend.watch(line.now_ns)
    assert line.world.steps == []
    answer = line.send(0)
    assert line.world.steps == [5 * MS] and answer.stepped and answer.uwb == b"uwb"


def test_the_pulses_of_the_packet_drive_the_step(line):
    line.send(0, pulses=(1600, 1400, 0, 1500))
    assert line.world.pulses[:4] == (1600, 1400, 0, 1500)


def test_after_a_second_of_silence_the_same_frame_count_comes_again_and_gets_the_same_answer(line):
    first = line.send(0)
    again = [line.send(0, after_ns=S) for _ in range(3)]
    assert {a.data for a in again} == {first.data} and not any(a.stepped or a.uwb for a in again)
    assert len(line.world.steps) == 1 and line.backend.counters.repeated == 3
    assert line.time_of(line.send(1)) == pytest.approx(0.01)


def test_repeats_that_had_queued_up_get_one_answer_between_them(line):
    """This program was stopped for a minute: the firmware must not find sixty answers, and lag by sixty frames."""
    answers = [line.send(0, after_ns=0) for _ in range(61)]
    assert answers[0].stepped and answers[1:] == [None] * 60
    assert line.send(0, after_ns=S).data == answers[0].data, "lost after all: it asks once more"
    assert [line.send(0, after_ns=0) for _ in range(3)] == [None] * 3


def test_a_lower_frame_count_is_a_firmware_started_again_and_resets_the_world(line):
    for count in range(50):
        line.send(count)
    line.backend.take_news()
    assert line.time_of(line.send(0)) == pytest.approx(0.005)
    assert line.world.restarts == line.backend.counters.restarts == 1
    assert line.backend.take_news() == ["firmware started again (frame 0 after 49): the boat is back at its start"]


def test_frames_that_were_missed_are_counted_and_told(line):
    line.send(0)
    assert line.time_of(line.send(4)) == pytest.approx(0.01), "one step, for the firmware's clock goes by our time"
    assert line.backend.counters.missed == 3
    assert "frames missed: 3 (now 4), 3 in all" in line.backend.take_news()


def test_a_simulator_started_again_takes_any_frame_count_and_its_time_begins_anew(line):
    """The firmware sees the timestamp go back and goes on: `test_process`."""
    assert line.time_of(line.send(123_456)) == pytest.approx(0.005)
    assert line.backend.counters.missed == line.world.restarts == 0


@pytest.mark.parametrize(("rate", "ms"), [(1200, 1 / 1.2), (400, 2.5), (200, 5), (50, 20), (20, 50), (10, 50), (0, 50)])
def test_the_frame_rate_asks_for_the_step_which_stays_below_a_tenth_of_a_second(line, rate, ms):
    line.send(0, rate=200)
    line.send(1, rate=rate)
    assert line.world.steps[1] == pytest.approx(ms * MS, abs=1)


@given(st.integers(0, 65535))
def test_a_step_is_never_longer_than_asked_for_nor_none_at_all(rate):
    assert 0 < frame_ns(rate) <= LONGEST_FRAME_NS < 0.1 * S
    assert frame_ns(rate) * rate <= S


def test_a_firmware_that_goes_silent_is_told_once_and_so_is_its_return(line):
    line.send(0)
    line.backend.take_news()
    for _ in range(10):
        line.now_ns += S
        line.backend.watch(line.now_ns)
    assert line.backend.take_news() == ["firmware silent for 2 s, the world waits for it"]
    assert line.time_of(line.send(1)) == pytest.approx(0.01)
    assert line.backend.take_news() == ["firmware back after 10.0 s"]
    line.backend.watch(line.now_ns)
    assert line.backend.take_news() == []


@pytest.mark.parametrize(("gap_ms", "pace"), [(10, "0.50"), (5, None), (1, "5.00")])
def test_it_is_told_once_that_simulated_time_is_not_real_time(line, gap_ms, pace):
    for count in range(20_000 // gap_ms):
        line.send(count, after_ns=gap_ms * MS)
        line.backend.watch(line.now_ns)
    told = [text for text in line.backend.take_news() if "real time" in text]
    assert len(told) == (pace is not None) and all(f"runs at {pace} of real time; " in text for text in told)
    for count in range(20_000 // gap_ms, 20_000 // gap_ms + 3000):
        line.send(count)
        line.backend.watch(line.now_ns)
    back = [text for text in line.backend.take_news() if "real time" in text]
    assert back == (["simulated time runs at 1.00 of real time"] if pace else [])


def test_a_firmware_that_waits_and_asks_again_is_not_silent(line):
    """It asks again after a second; losing that too would be bad luck."""
    line.send(0)
    line.backend.take_news()
    for _ in range(5):
        line.send(0, after_ns=1_100 * MS)
        line.backend.watch(line.now_ns + 1_000 * MS)
    assert not any("silent" in text for text in line.backend.take_news())


def test_a_second_firmware_does_not_displace_a_live_one(line):
    for count in range(100):
        assert line.send(count, after_ns=S).stepped
        assert line.send(0, sender="b", after_ns=500 * MS) is None
    assert line.backend.counters.strangers == 100 and line.world.restarts == 0
    assert sum("b waits" in text for text in line.backend.take_news()) == 1
    assert line.send(0, sender="b", after_ns=SILENT_NS).stepped and line.world.restarts == 1


def test_garbage_is_counted_told_once_and_harmless(line):
    line.send(0)
    assert all(line.backend.receive(b"hello", "c", line.now_ns) is None for _ in range(9))
    assert line.backend.counters.garbage == 9
    assert sum("ignored what c sent: 5 bytes" in text for text in line.backend.take_news()) == 1
    assert line.send(1).stepped


@settings(max_examples=60)
@given(st.lists(st.tuples(st.sampled_from(["next", "again", "jump", "restart", "garbage", "other"]), st.integers(0, 2)),
                max_size=60))  # fmt: skip
def test_whatever_comes_each_frame_is_one_step_and_time_goes_on(doings):
    """Steps = packets of ours that were new; between restarts the timestamps rise by exactly the steps."""
    line, count, new, told = Line(), 0, 1, []
    told.append(line.time_of(line.send(0)))
    for doing, seconds in doings:
        if doing == "garbage":
            line.backend.receive(b"\0" * 40, "a", line.now_ns)
            continue
        if doing == "other":
            line.send(0, sender="b", after_ns=0)
            continue
        before, count = count, {"next": count + 1, "again": count, "jump": count + 5, "restart": 0}[doing]
        fresh = doing in ("next", "jump") or (doing == "restart" and before != 0)
        answer = line.send(count, after_ns=seconds * S + MS)
        if not fresh and not seconds:
            assert answer is None
            continue
        assert answer.stepped == fresh
        new += fresh
        if doing == "restart" and fresh:
            told = []
        if fresh:
            told.append(line.time_of(answer))
        else:
            assert line.time_of(answer) == told[-1]
    assert len(line.world.steps) == line.backend.counters.steps == new
    assert all(b - a == pytest.approx(0.005) for a, b in pairwise(told))
