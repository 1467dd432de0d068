"""An order that waits for the check of the parameters, and what may happen to the boat meanwhile."""

import pytest

from companion.core.messages import OperatorCommand, RcChannels
from tests.companion.boat.app_fixture import Bench
from tests.companion.boat.guarded_fixture import Guarded, told

RECEIVER_US = (1500,) * 8


@pytest.mark.parametrize("taken", [False, True])
def test_a_hand_at_the_transmitter_takes_back_an_order_that_still_waits(taken, tmp_path):
    bench = Guarded(tmp_path / "run.mcap", receiver_us=RECEIVER_US)

    async def story(bench):
        await bench.run(2.0, until=lambda: len(bench.of(RcChannels)) > 3)
        bench.order("start")
        await bench.run(0.2)
        assert bench.mode == "idle" and told(bench, "waits for the check") == 1
        if taken:
            bench.world.receiver_us = (*RECEIVER_US[:5], 1900, *RECEIVER_US[6:])
        assert await bench.run(12.0, until=lambda: bench.mode != "idle") is not taken
        assert told(bench, "start dropped: meanwhile the pilot moved RC channel 6") == taken
        bench.order("start")
        assert await bench.run(12.0, until=lambda: bench.mode in ("starting", "auto")), "a new order is obeyed"

    assert bench.scene(story) is None


@pytest.mark.long
def test_without_the_interlock_an_order_expires_too(tmp_path):
    bench = Bench(tmp_path / "run.mcap")

    async def story(bench):
        bench.deaf = True
        bench.app.command(OperatorCommand(t_ns=bench.clock.now_ns(), command="start"))
        await bench.run(1.0)
        assert bench.mode == "starting"
        await bench.run(10.0)
        assert bench.mode == "idle"
        bench.deaf = False
        await bench.run(25.0)
        assert bench.mode == "idle"

    assert bench.scene(story) is None
    assert told(bench, "start expired after 10 s") == 1
