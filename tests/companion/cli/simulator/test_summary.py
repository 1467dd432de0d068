"""What a demo's summary says of a drive that was stopped."""

import pytest

from companion.cli.simulator import summary
from companion.core.messages import ModeStatus, Tick

STOP_NS = 5_000_000_000
WHY = "stopped: UWB is silent; thrusters are neutral until the operator starts again"


def said(*modes):
    """Of a boat in these modes, one after the other, a second each; it is in the third of them at `STOP_NS`."""
    messages = {kind: [] for kind in summary.KINDS}
    messages[Tick] = [Tick(t_ns=0, index=0)]
    begin_ns = STOP_NS - 2_000_000_000
    messages[ModeStatus] = [
        ModeStatus(
            t_ns=begin_ns + k * 1_000_000_000, mode=mode, why=WHY if mode == "safe" else "", driving=mode == "auto"
        )
        for k, mode in enumerate(modes)
    ]
    return summary.why_stopped(messages)


@pytest.mark.parametrize("modes", [(), ("idle", "idle"), ("starting", "auto", "idle"), ("starting", "auto", "hold")])
def test_other_ends_are_no_stop(modes):
    assert said(*modes) == ""


@pytest.mark.parametrize("end", [(), ("safe",), ("safe", "idle"), ("idle", "idle")])
def test_a_stop_for_good_is_told_with_its_time_and_reason(end):
    assert said("starting", "auto", "safe", *end) == "driving was stopped after 5.0 s: UWB is silent"


def test_an_operators_stop_is_told_where_the_program_went_on():
    idle = ModeStatus(t_ns=STOP_NS, mode="idle", why="stopped by the operator", driving=False)
    auto = ModeStatus(t_ns=0, mode="auto", why="", driving=True)
    for last_s, told in ((6, ""), (20, "driving was stopped after 5.0 s: stopped by the operator")):
        ticks = [Tick(t_ns=t * 1_000_000_000, index=t) for t in (0, last_s)]
        messages = {kind: [] for kind in summary.KINDS} | {Tick: ticks, ModeStatus: [auto, idle, idle]}
        assert summary.why_stopped(messages) == told


def test_a_boat_that_was_started_again_was_not_stopped():
    assert said("starting", "auto", "safe", "starting", "auto", "idle") == ""
