"""Clocks: order of waking, exactness, an hour in no time."""

import asyncio

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.boat.clock import BoatClock, Clock
from tests.support.stand_ins.sim_clock import SimClock

HOUR_NS = 3600 * 10**9


async def _note(clock: Clock, t_ns: int, seen: list[tuple[int, int]], tag: int) -> None:
    await clock.sleep_until(t_ns)
    seen.append((clock.now_ns(), tag))


@settings(max_examples=50, deadline=None)
@given(st.lists(st.integers(1, 1000), max_size=8), st.lists(st.integers(0, 400), max_size=8))
def test_sleepers_wake_exactly_and_in_order_however_time_is_cut(instants, steps):
    async def main() -> list[tuple[int, int]]:
        clock, seen = SimClock(), []
        tasks = [asyncio.create_task(_note(clock, t_ns, seen, tag)) for tag, t_ns in enumerate(instants)]
        for step in [*steps, 1000]:
            await clock.advance(step)
        await asyncio.gather(*tasks)
        return seen

    expected = sorted((t_ns, tag) for tag, t_ns in enumerate(instants))
    assert asyncio.run(main()) == expected


def test_every_tick_of_an_hour_comes():
    async def main() -> int:
        clock, ticks = SimClock(start_ns=7), 0

        async def every_second() -> None:
            nonlocal ticks
            while True:
                await clock.sleep_until(clock.now_ns() + 10**9)
                ticks += 1

        task = asyncio.create_task(every_second())
        await clock.advance(HOUR_NS)
        task.cancel()
        assert clock.now_ns() == HOUR_NS + 7
        return ticks

    assert asyncio.run(main()) == 3600


def test_nothing_moves_without_advance_and_time_stops_short_of_the_next_sleeper():
    async def main() -> None:
        clock, seen = SimClock(), []
        task = asyncio.create_task(_note(clock, 100, seen, 0))
        await asyncio.sleep(0.01)
        assert clock.now_ns() == 0
        await clock.advance(99)
        assert not seen
        await clock.advance(1)
        assert seen == [(100, 0)]
        await task

    asyncio.run(main())


def test_a_cancelled_sleeper_neither_wakes_nor_stops_the_others():
    async def main() -> list[tuple[int, int]]:
        clock, seen = SimClock(), []
        first, second = (asyncio.create_task(_note(clock, t_ns, seen, t_ns)) for t_ns in (10, 20))
        await clock.advance(5)
        first.cancel()
        await clock.advance(20)
        await second
        assert first.cancelled()
        return seen

    assert asyncio.run(main()) == [(20, 20)]


def test_what_a_sleeper_causes_happens_at_its_own_instant():
    async def main() -> list[int]:
        clock, stamps = SimClock(), []
        queue: asyncio.Queue[int] = asyncio.Queue()

        async def consumer() -> None:
            while True:
                await queue.get()
                stamps.append(clock.now_ns())

        async def producer() -> None:
            for t_ns in (3, 5):
                await clock.sleep_until(t_ns)
                queue.put_nowait(t_ns)

        tasks = [asyncio.create_task(consumer()), asyncio.create_task(producer())]
        await clock.advance(100)
        for task in tasks:
            task.cancel()
        return stamps

    assert asyncio.run(main()) == [3, 5]


def test_a_step_back_and_two_drivers_are_refused():
    async def main() -> None:
        clock = SimClock()
        with pytest.raises(ValueError, match="back"):
            await clock.advance(-1)
        other = asyncio.create_task(clock.advance(10))
        await asyncio.sleep(0)
        with pytest.raises(RuntimeError, match="another task"):
            await clock.advance(10)
        await other
        assert clock.now_ns() == 10

    asyncio.run(main())


@pytest.mark.parametrize("clock", [BoatClock(), SimClock(100)])
def test_the_past_returns_at_once_but_lets_others_run(clock):
    async def main() -> bool:
        other = asyncio.create_task(asyncio.sleep(0))
        await clock.sleep_until(clock.now_ns() - 50)
        await clock.sleep_until(clock.now_ns())
        return other.done()

    assert asyncio.run(main())


@pytest.mark.parametrize("share", [1.0, 0.5])
def test_the_boat_clock_never_wakes_early(share, monkeypatch):
    """Also with timers that fire after half of the time."""
    sleep = asyncio.sleep
    monkeypatch.setattr(asyncio, "sleep", lambda delay_s: sleep(share * delay_s))

    async def main() -> list[int]:
        clock, early = BoatClock(), []
        for ns in (100_000, 1_000_000, 30_000_000):
            target_ns = clock.now_ns() + ns
            await clock.sleep_until(target_ns)
            early.append(clock.now_ns() - target_ns)
        return early

    assert min(asyncio.run(main())) >= 0
