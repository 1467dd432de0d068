"""The table of link states: every state under every observation, back-off, timing."""

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.link import LinkTiming, link_state
from drivers.link_state import LinkObservations, backoff_s
from tests.drivers.link_bench import CYCLE, SECOND, TIMING

STATES = ("searching", "online", "stale", "lost")


def whole_ns() -> st.SearchStrategy[int]:
    edges = [TIMING.stale_after_ns, TIMING.lost_after_ns]
    return st.one_of(st.integers(0, 10 * SECOND), st.sampled_from([e + d for e in edges for d in (-1, 0, 1)]))


SEEN = st.builds(
    LinkObservations, fault=st.sampled_from(["", "cannot open"]), framed=st.booleans(), silent_ns=whole_ns(),
    frameless_ns=whole_ns(), babble_ns=st.one_of(st.just(0), whole_ns()),
)  # fmt: skip


@given(st.sampled_from(STATES), SEEN)
def test_every_state_under_every_observation(before, seen):
    state, cause, reason, reopen = link_state(before, seen, TIMING)
    assert (before, state) in CYCLE
    assert reason
    assert cause
    if state == "online":
        assert seen.framed
        assert seen.frameless_ns < TIMING.stale_after_ns
    if seen.fault:
        assert state in ("lost", "searching")
        assert reason == seen.fault
    if state == "lost":
        assert reopen
        assert link_state("lost", seen, TIMING).state == "searching"
    if state == "stale":
        assert not reopen
        assert TIMING.stale_after_ns <= seen.frameless_ns < TIMING.lost_after_ns


@pytest.mark.parametrize(
    ("before", "seen", "state", "reason"),
    [
        ("searching", LinkObservations("", False, 0, 0, 0), "searching", "port open, waiting for a message"),
        ("searching", LinkObservations("", True, 0, 0, 0), "online", "messages arrive"),
        ("searching", LinkObservations("", False, 2 * SECOND, 2 * SECOND, 0), "searching", "no bytes for 2.0 s"),
        ("online", LinkObservations("", True, 1_199_999_999, 1_199_999_999, 0), "online", "messages arrive"),
        ("online", LinkObservations("", True, 1_200_000_000, 1_200_000_000, 0), "stale", "no bytes for 1.2 s"),
        ("stale", LinkObservations("", True, 100, 100, 0), "online", "messages arrive"),
        ("stale", LinkObservations("", True, 4 * SECOND, 4 * SECOND, 0), "lost", "no bytes for 4.0 s"),
        ("online", LinkObservations("unplugged", True, 0, 0, 0), "lost", "unplugged"),
        ("lost", LinkObservations("unplugged", True, 0, 0, 0), "searching", "unplugged"),
        (
            "online", LinkObservations("", True, 1000, 2 * SECOND, 1_900_000_000), "stale",
            "bytes come, and no message for 2.0 s",
        ),
        (
            "stale", LinkObservations("", True, 1000, 3_500_000_000, 3_400_000_000), "stale",
            "bytes but no valid frame for 3.4 s: wrong baud rate?",
        ),
        (
            "searching", LinkObservations("", False, 1000, 60 * SECOND, 2_999_000_000), "searching",
            "bytes come, and no message for 60.0 s",
        ),
        (
            "searching", LinkObservations("", False, 1000, 3 * SECOND, 3 * SECOND), "searching",
            "bytes but no valid frame for 3.0 s: wrong baud rate?",
        ),
    ],
)  # fmt: skip
def test_rows_of_the_table(before, seen, state, reason):
    verdict = link_state(before, seen, TIMING)
    assert (verdict.state, verdict.reason) == (state, reason)


def test_the_guess_at_a_baud_rate_waits_for_two_periods_of_a_slow_device():
    slow = LinkTiming(stale_after_s=25.0, lost_after_s=50.0)
    early, late = (LinkObservations("", False, SECOND, 60 * SECOND, s * SECOND) for s in (24, 25))
    assert link_state("searching", early, slow).cause == "waiting"
    assert link_state("searching", late, slow).cause == "garbage"


def test_silence_before_the_first_message_does_not_reopen_but_lasting_garbage_does():
    hour = 3600 * SECOND
    assert not link_state("searching", LinkObservations("", False, hour, hour, 0), TIMING).reopen
    assert not link_state("searching", LinkObservations("", False, 0, hour, 3 * SECOND), TIMING).reopen
    assert link_state("searching", LinkObservations("", False, 0, hour, 4 * SECOND), TIMING).reopen


def test_backoff_grows_from_a_tenth_to_two_seconds_with_jitter():
    rng = random.Random(0)
    for attempt in range(40):
        whole = min(0.1 * 2**attempt, 2.0)
        pauses = [backoff_s(attempt, rng, TIMING) for _ in range(200)]
        assert max(0.1, 0.75 * whole) <= min(pauses) <= max(pauses) <= min(2.0, 1.25 * whole)
        assert max(pauses) - min(pauses) > 0.15 * whole


@pytest.mark.parametrize(
    "wrong",
    [
        {"stale_after_s": 0.0},
        {"stale_after_s": 5.0},
        {"backoff_min_s": 0.0},
        {"backoff_min_s": 3.0},
        {"lost_after_s": float("nan")},
    ],
)
def test_timing_that_makes_no_sense_is_refused(wrong):
    with pytest.raises(ValueError, match="need 0 <"):
        LinkTiming(**wrong)
