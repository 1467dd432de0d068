"""When a run ends by itself: some seconds after its mission, or after the boat has stopped itself."""

import pytest

from companion.cli.boat.run_end import RunEnd
from companion.core.messages import ExcitationStatus, ModeStatus

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
