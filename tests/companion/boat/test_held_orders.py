"""An order that waits for the check of the parameters, and what may happen to the boat meanwhile."""

import pytest

from companion.core.messages import RcChannels
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
