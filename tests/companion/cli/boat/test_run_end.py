"""When a run ends by itself: some seconds after its mission, or after the boat has stopped itself."""

import pytest

from companion.cli.boat.run_end import RunEnd
from companion.core.messages import Alert, ExcitationStatus, ModeStatus, OperatorCommand

S = 1_000_000_000


def mode(t_s, name):
    return ModeStatus(t_ns=t_s * S, mode=name, why="", driving=False)


def flown(t_s, phase):
    return ExcitationStatus(t_ns=t_s * S, phase=phase, segment=0, segments=1, name="", elapsed_s=0.0)


@pytest.mark.parametrize(
    ("messages", "ends_s", "stopped"),
    [
        ([flown(1, "fly"), flown(2, "done"), flown(6, "done"), flown(7, "done")], 7, False),
        ([flown(2, "failed"), mode(3, "idle"), mode(7, "idle")], 7, False),
        ([flown(2, "done"), flown(3, "fly"), flown(9, "done"), flown(13, "done")], None, False),
        ([mode(1, "auto"), mode(2, "safe"), mode(6, "safe"), mode(7, "safe")], 7, True),
        ([mode(2, "safe"), mode(4, "auto"), mode(9, "auto")], None, False),
        ([mode(2, "safe"), mode(7, "safe"), mode(8, "idle")], 7, True),
        ([mode(1, "auto"), mode(2, "idle"), mode(61, "idle"), mode(62, "idle")], 62, True),
        ([mode(1, "auto"), mode(2, "idle"), mode(50, "starting"), mode(52, "auto"), mode(90, "idle")], None, False),
        ([mode(1, "safe"), mode(4, "idle"), mode(63, "idle"), mode(64, "idle")], 64, True),
        ([mode(t, "idle") for t in range(100)], None, False),
    ],
)
def test_it_ends_after_five_seconds_and_a_minute_after_an_operators_stop(messages, ends_s, stopped):
    end = RunEnd(5.0)
    ended = [message.t_ns // S for message in messages if end.see(message)]
    assert ended[:1] == ([] if ends_s is None else [ends_s])
    assert end.stopped == stopped


def test_without_a_time_it_never_ends():
    end = RunEnd(None)
    assert not any(end.see(mode(t, "safe")) for t in range(1000)) and not end.stopped


def expired(t_s, order):
    text = f"{order} expired: it waited for an autopilot; give it again"
    return Alert(t_ns=t_s * S, level="warning", text=text)


@pytest.mark.parametrize(
    ("order", "alert", "ends"), [("excite", "excite", True), ("excite", "start", False), ("", "start", False)]
)
def test_a_run_whose_order_to_begin_expired_ends_at_once(order, alert, ends):
    """It waited for an operator who was not there, for ever."""
    end = RunEnd(5.0, order)
    assert [end.see(mode(1, "idle")), end.see(expired(60, alert))] == [False, ends]
    assert end.stopped == ends


def test_without_a_time_an_order_that_expired_ends_nothing():
    end = RunEnd(None, "start")
    assert not end.see(expired(60, "start")) and not end.stopped


@pytest.mark.parametrize(("order", "ends"), [("start", True), ("", False)])
def test_a_stop_before_it_has_begun_ends_it_after_a_minute(order, ends):
    end = RunEnd(5.0, order)
    seen = [OperatorCommand(t_ns=3 * S, command="stop"), *(mode(t, "idle") for t in range(4, 65))]
    assert [end.see(message) for message in seen] == (len(seen) - 1) * [False] + [ends]
