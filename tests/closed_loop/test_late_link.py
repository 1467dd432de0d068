"""A late link under way: the whole App, its own TIMESYNC questions, the simulated autopilot's answers."""

import pytest

from companion.core.messages import Alert, ModeStatus, TimeSync
from tests.support.fault_fixture import FaultBench
from tests.support.fault_oracle import judge
from tests.support.faults import Fault, Sequence

S = 1_000_000_000


class Mute(FaultBench):
    """An autopilot that answers no TIMESYNC from `mute_from_ns` on."""

    mute_from_ns = 0

    def _tampered(self, m):
        mute = m.get_type() == "TIMESYNC" and self.world.t_ns >= self.mute_from_ns
        return b"" if mute else super()._tampered(m)


class MuteLater(Mute):
    mute_from_ns = 8 * S


def played(folder, kind, how, lasts_s, bench=FaultBench):
    told = Sequence("auto", False, False, (Fault(kind, how, 0.3, lasts_s),))
    return bench(folder / "run.mcap", told).play()


def stop(run):
    """When it came to be safe [s], and why."""
    return next((m.t_ns / S, m.why) for m in run.of(ModeStatus) if m.mode == "safe")


def modes(run):
    return list(dict.fromkeys(m.mode for m in run.of(ModeStatus)))


@pytest.mark.parametrize("delay_s", [0.6, 1.2])
@pytest.mark.long
def test_a_late_link_stops_the_boat_and_it_stays_stopped(tmp_path, delay_s):
    run = played(tmp_path, "down", f"delay {delay_s}", 6.0)
    assert modes(run) == ["idle", "starting", "auto", "safe"] and judge(run) == []
    at_s, why = stop(run)
    assert "arrives late" in why and "ms)" in why
    late_s = next(m.t_ns / S for m in run.of(ModeStatus) if m.mode == "auto") + 0.8
    assert 0.0 < at_s - late_s <= 0.75 + delay_s + 0.2, "three answers of four a second, their way, a tick or two"


@pytest.mark.long
def test_a_link_that_is_a_little_late_drives_on(tmp_path):
    run = played(tmp_path, "down", "delay 0.3", 6.0)
    assert modes(run) == ["idle", "starting", "auto"] and judge(run) == []


@pytest.mark.parametrize("bench", [Mute, FaultBench])
@pytest.mark.long
def test_an_autopilot_that_never_answers_is_driven_like_one_that_does(tmp_path, bench):
    run = played(tmp_path, "battery", "13.8", 8.0, bench)
    assert modes(run) == ["idle", "starting", "auto"]
    assert bool([m for m in run.of(TimeSync) if m.tc1_ns]) == (bench is FaultBench)
    assert not [m for m in run.of(Alert) if m.level == "error"]


def test_one_that_answers_no_more_stops_the_boat(tmp_path):
    run = played(tmp_path, "battery", "13.8", 9.0, MuteLater)
    at_s, why = stop(run)
    assert "has not answered TIMESYNC" in why and 12.7 <= at_s <= 13.2
