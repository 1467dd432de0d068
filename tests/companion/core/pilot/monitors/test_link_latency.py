"""A late link: which answers make it one, which do not, and what is said of it."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.core.messages import TimeSync
from companion.core.pilot.monitors.link_latency import NO_ANSWER, LinkLatencyMonitor
from tests.companion.core.pilot.monitors.monitor_fixture import view

MS = 1_000_000
MONITOR = LinkLatencyMonitor()


def answer(asked_ms, took_ms):
    return TimeSync(t_ns=(asked_ms + took_ms) * MS, tc1_ns=7, ts1_ns=asked_ms * MS)


def hear(trips, message):
    trips, report = MONITOR.on_message(trips, message, message.t_ns)
    assert not report.events and not report.alerts
    return trips


def after(*answers, trips=NO_ANSWER):
    for message in sorted(answers, key=lambda m: m.t_ns):
        trips = hear(trips, message)
    return trips


def steady(took_ms, count=8, from_ms=0):
    return [answer(from_ms + 250 * k, took_ms) for k in range(count)]


def condition(trips, t_ms, heard=True):
    """Seen at a tick: the state, and the words or None."""
    trips, report = MONITOR.on_tick(trips, view(t_ms * MS, autopilot_alive=heard))
    assert set(report.events) <= {"link_late"} and bool(report.events) == trips.late and not report.alerts
    return trips, report.events.get("link_late")


@pytest.mark.parametrize(("took_ms", "late"), [(1, False), (200, False), (500, False), (501, True), (1000, True)])
def test_a_link_is_late_above_half_a_second(took_ms, late):
    _, told = condition(after(*steady(took_ms)), 2900)
    assert (told is not None) == late
    assert not late or f"({took_ms} ms)" in told


def test_a_late_link_of_a_busy_computer_is_the_computers():
    trips = after(*steady(900))
    assert "look for a radio" in condition(trips, 2900)[1]
    trips, _ = MONITOR.on_tick(trips, view(2900 * MS, lateness_ns=140 * MS))
    assert "this computer is too busy, its own control loop was 140 ms late" in condition(trips, 3000)[1]
    assert "radio" in condition(after(*steady(900, from_ms=6000), trips=trips), 8100)[1], "long ago"


def test_a_second_of_delay_is_seen_a_second_and_a_half_after_it_began():
    """The third late answer of the last five: asked half a second after the first, and a second under way."""
    answers = [*steady(4, 8), *steady(1000, 8, from_ms=2000)]
    late = {}
    for t_ms in range(2000, 5000, 50):
        trips = after(*(a for a in answers if a.t_ns <= t_ms * MS))
        late[t_ms] = condition(trips, t_ms)[1] is not None
    begun = min(t for t, is_late in late.items() if is_late)
    assert begun == 3500 and all(is_late for t, is_late in late.items() if t >= begun)


def test_it_is_prompt_again_below_three_tenths_only():
    trips, told = condition(after(*steady(600)), 2900)
    assert told
    between, told = condition(after(*steady(310, from_ms=4000), trips=trips), 6500)
    assert told, "between the limits it stays what it was"
    prompt, told = condition(after(*steady(300, from_ms=8000), trips=between), 10200)
    assert told is None
    assert condition(after(*steady(400, from_ms=12000), trips=prompt), 14300)[1] is None


@pytest.mark.parametrize("slow", [1, 2])
def test_one_or_two_answers_that_were_held_up_stop_nobody(slow):
    trips = after(*steady(3, 6), *(answer(1500 + 250 * k, 900 + 200 * k) for k in range(slow)))
    assert condition(trips, 3000)[1] is None
    assert condition(after(*steady(3, 2)), 500)[1] is None, "two answers say nothing"
    assert condition(after(*steady(900, 4)), 1700)[1] is None, "nor do four, however slow"
    assert condition(after(*steady(900, 5)), 1950)[1] is not None, "five do"


@settings(max_examples=60, deadline=None)
@given(stall_ms=st.integers(0, 4000), quick_ms=st.integers(0, 20), phase_ms=st.integers(0, 249))
def test_a_line_that_stood_still_once_is_not_late(stall_ms, quick_ms, phase_ms):
    """A busy computer: all that was asked meanwhile is answered in one burst. No tick finds a late link."""
    freed_ms, trips, answers = 5000 + phase_ms + stall_ms, NO_ANSWER, []
    for asked_ms in range(0, 12000, 250):
        held = 5000 + phase_ms <= asked_ms + quick_ms < freed_ms
        answers.append(answer(asked_ms, freed_ms - asked_ms + asked_ms // 1000 % 3 if held else quick_ms))
    for message in sorted(answers, key=lambda m: m.t_ns):
        trips, told = condition(hear(trips, message), message.t_ns // MS)
        assert told is None, (message, trips)


def test_answers_count_as_one_where_they_come_within_half_a_period():
    for gap_ms, took in ((0, (40,)), (124, (40,)), (125, (900, 40)), (130, (900, 40))):
        trips = after(answer(1000, 900), answer(1860 + gap_ms, 40))
        assert trips.took_ns == tuple(ms * MS for ms in took), gap_ms
    assert after(answer(1000, 20), answer(1010, 90)).took_ns == (20 * MS,), "the quickest, whichever it was"


def test_repeated_answers_questions_and_what_comes_from_the_future_change_nothing():
    trips = after(*steady(2))
    assert hear(trips, answer(1750, 900)) == trips, "the newest, once more"
    assert hear(trips, answer(500, 900)) == trips, "an old one, overtaken"
    assert hear(trips, TimeSync(t_ns=9000 * MS, tc1_ns=0, ts1_ns=8000 * MS)) == trips, "a question"
    assert hear(trips, TimeSync(t_ns=9000 * MS, tc1_ns=1, ts1_ns=8000 * MS)) != trips, "an answer of a young clock"
    assert hear(trips, answer(9000, -1)) == trips
    assert hear(trips, answer(9000, 0)) != trips


def test_answers_that_come_no_more_are_late_after_five_seconds_and_a_fresh_start_is_judged_afresh():
    trips = after(*steady(2))  # the newest was asked at 1750 ms
    assert condition(trips, 6750)[1] is None
    trips, told = condition(trips, 6760)
    assert "has not answered TIMESYNC for 5 s" in told
    trips, told = condition(after(*steady(2, 2, from_ms=7000), trips=trips), 7400)
    assert told, "two answers are no proof"
    assert condition(after(*steady(2, 5, from_ms=7500), trips=trips), 8600)[1] is None


def test_an_autopilot_that_never_answers_is_not_judged_nor_one_that_is_not_heard():
    assert condition(NO_ANSWER, 10**6) == (NO_ANSWER, None)
    late = after(*steady(900))
    assert condition(late, 2900, heard=False) == (NO_ANSWER, None), "the lost link is told elsewhere"
