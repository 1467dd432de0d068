"""The App: leases on the wire whatever the links do, and neutral, disarm, release at every end."""

from __future__ import annotations

import os
import random

import pytest

from companion.boat.devices.sensor_device import device_timing
from companion.core.messages import (
    LoopTiming,
    ManualInput,
    ModeStatus,
    OperatorCommand,
    OverrideLease,
    PlanResult,
    Tick,
)
from companion.logs.log_file import LogFile
from tests.companion.boat.app.ending import ends_in_order
from tests.companion.boat.app_fixture import Bench, S, neutral


def test_a_run_from_start_to_stop(path):
    bench = Bench(path)

    async def story(bench):
        await bench.drive()
        await bench.run(2.0)
        bench.decided = [lease.pwm_us[:4] for lease in bench.of(OverrideLease)]
        bench.sent_then = [pwm[8:12] for t_ns, pwm in bench.overrides if t_ns >= bench.of(Tick)[0].t_ns]

    assert bench.scene(story) is None
    under_way = len(bench.decided) - len(bench.sent_then)  # the last may not have come out of the cable yet
    assert under_way in (0, 1)
    assert bench.sent_then == bench.decided[: len(bench.sent_then)], "what was decided is what was sent"
    counts = bench.leases_per_tick()
    driven = counts[:-12]  # the last second has the neutrals of the end beside the leases
    assert len(driven) > 60 and set(driven) == {1}
    ticks, leases = bench.of(Tick), bench.of(OverrideLease)
    assert [t.index for t in ticks] == [lease.index for lease in leases] == [t.index for t in bench.of(LoopTiming)]
    assert {p.status for p in bench.of(PlanResult)} == {"ok"}
    sources = [lease.source for lease in leases if lease.source != "neutral"]
    assert sources.count("plan") > 20
    ends_in_order(bench)
    log = LogFile(path)
    assert sum(isinstance(m, OverrideLease) for m in log.messages()) == len(leases)
    assert sum(len(raw.data) for raw in log.raw("mavlink") if raw.direction == "tx") > 1000


@pytest.mark.long
def test_a_lost_autopilot_stops_the_boat_and_it_goes_on_when_told(path):
    bench = Bench(path)

    async def story(bench):
        await bench.drive()
        bench.deaf, bench.answering = True, False
        await bench.run(4.2)
        assert bench.mode == "safe" and neutral(bench.overrides[-1][1])
        await bench.run(2.0)
        bench.deaf, bench.answering = False, True
        await bench.run(3.0)
        assert bench.mode == "safe", "not by itself"
        await bench.drive()

    assert bench.scene(story) is None
    assert bench.links("mavlink") == ["searching", "online", "stale", "lost", "searching", "online"]
    assert [lease.index for lease in bench.of(OverrideLease)] == [t.index for t in bench.of(Tick)]
    assert any("no heartbeat" in text for text in bench.alerts())
    ends_in_order(bench)


def test_garbage_from_the_tag_is_counted_and_the_boat_stays_neutral(path):
    bench, dice = Bench(path), random.Random(5)

    async def story(bench):
        bench.app.command(OperatorCommand(t_ns=bench.clock.now_ns(), command="start"))
        for _ in range(40):
            bench.garbage = dice.randbytes(40)
            await bench.run(0.1)
        assert set(bench.links("uwb")) == {"searching"}
        assert bench.tag_codec.counters != type(bench.tag_codec.counters)()

    assert bench.scene(story) is None
    assert {lease.source for lease in bench.of(OverrideLease)} == {"neutral"}
    assert sum(bench.leases_per_tick()[:-12]) > 25 and set(bench.leases_per_tick()[:-12]) == {1}
    ends_in_order(bench)


def test_garbage_from_the_autopilot_does_no_harm(path):
    bench = Bench(path)

    async def story(bench):
        await bench.drive()
        for _ in range(20):
            bench.far.send(os.urandom(60))
            await bench.run(0.05)
        assert bench.mode == "auto"

    assert bench.scene(story) is None
    ends_in_order(bench)


def test_by_hand_over_the_wire_and_neutral_when_the_hands_are_gone(path):
    """No tag, so no estimate: sticks need none. A client that dies leaves neutral within its timeout and a tick."""
    bench = Bench(path)

    async def hold(bench, surge, seconds):
        for _ in range(round(seconds / 0.05)):
            now = bench.clock.now_ns()
            bench.app.manual(ManualInput(t_ns=now, surge=surge, sway=0.0, yaw=0.0, source="test"))
            await bench.run(0.05)

    async def story(bench):
        bench.world.silent_uwb = True
        bench.app.command(OperatorCommand(t_ns=bench.clock.now_ns(), command="manual"))
        await hold(bench, 0.0, 5.0)
        assert bench.mode == "manual" and bench.world.rover.vehicle.modes.armed
        await hold(bench, 0.5, 2.0)
        assert min(bench.world.rover.outputs_us[:4]) > 1600 and bench.world.plant.motion.x[3] > 0.2
        gone_ns = bench.clock.now_ns()
        await bench.run(1.0)
        neutrals = [t_ns for t_ns, pwm in bench.overrides if t_ns > gone_ns and neutral(pwm)]
        assert 0.4 * S < neutrals[0] - gone_ns < 0.65 * S and bench.mode == "locked"
        assert bench.world.rover.outputs_us[:4] == (1500,) * 4
        await hold(bench, 0.5, 1.0)
        assert bench.mode == "locked" and neutral(bench.overrides[-1][1])

    assert bench.scene(story) is None
    assert next(m.mode for m in bench.of(ModeStatus) if m.driving) == "manual"
    assert set(bench.leases_per_tick()[:-12]) == {1}
    ends_in_order(bench)


@pytest.mark.parametrize(("rate_hz", "stale_s", "lost_s"), [(1.0, 2.5, 20.0), (10.0, 1.5, 20.0), (0.1, 25.0, 50.0)])
def test_a_slow_tag_is_given_its_time(rate_hz, stale_s, lost_s):
    timing = device_timing(rate_hz)
    assert (timing.stale_after_s, timing.lost_after_s) == (stale_s, lost_s)


@pytest.mark.parametrize("order", ["start", "hold", "manual"])
def test_an_order_that_is_given_while_the_run_ends_moves_nothing(path, order):
    """A key that is pressed in the second of neutral made the boat drive off once more."""
    bench = Bench(path)

    async def story(bench):
        await bench.drive()
        bench.app.stop()
        await bench.run(0.15)
        assert not bench.app.command(OperatorCommand(t_ns=bench.clock.now_ns(), command=order))
        assert bench.app.refusal
        await bench.run(3.0, until=bench.running.done)

    assert bench.scene(story) is None
    ends_in_order(bench)
