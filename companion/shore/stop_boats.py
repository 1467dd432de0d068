"""One stop to several boats, without a console: for a terminal, a script, a key on a desk."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Callable, Sequence

from companion.shore.console.keys import Keys
from companion.shore.console.known_boats import KnownBoats
from companion.shore.console.orders import PATIENCE_S, Orders, SentOrder
from companion.shore.console.store import BoatStore
from companion.shore.console.zenoh_client import ZenohClient

SEARCH_S = 8.0
"""How long boats are looked for where none is named (assumed)."""
OTHERS_S = 4.0
"""How long after the first one others may show themselves, through a router or a console: one that has just connected
to a console does so within 3 s (measured, zenoh 1.10). Where boats must connect to us they get all of `SEARCH_S`."""
PERIOD_S = 0.05


class NobodyThereError(Exception):
    """There is nobody whom a stop could be sent to. The text says where was looked."""


async def stop_boats(
    client: ZenohClient, keys: Keys, names: Sequence[str], say: Callable[[SentOrder], None], *, others_s: float
) -> list[SentOrder]:
    """Give a stop to the boats of these names, or to all that show themselves; what came of each, within 30 s.

    A named boat is sent its stop whether it is in reach or not. Of the others each gets it as soon as it is found;
    looking ends `others_s` after the first. `say`: called with each when it is settled. Raises NobodyThereError.
    """
    store, given = BoatStore(), dict[str, asyncio.Task[SentOrder]]()
    orders = Orders(KnownBoats(store, keys), client.ask, lambda _: None)

    async def give(boat: str) -> SentOrder:
        order = await orders.give(boat, "stop")
        say(order)
        return order

    session = asyncio.create_task(client.run())
    work = [session, asyncio.create_task(_receive(client, store))]
    try:
        await _connected(client, session)
        for boat in dict.fromkeys(names):
            given[boat] = asyncio.create_task(give(boat))
        if not names:
            async for boat in _in_reach(client, store, others_s):
                given[boat] = asyncio.create_task(give(boat))
        return list(await asyncio.gather(*given.values()))
    finally:
        for task in (*given.values(), *work):
            task.cancel()
        await asyncio.gather(*given.values(), *work, return_exceptions=True)


async def _receive(client: ZenohClient, store: BoatStore) -> None:
    """Telemetry says for which run and clock a stop is made out first."""
    while True:
        for sample in client.take():
            if sample.topic is None:
                store.alive(sample.boat, sample.there, sample.heard_ns)
            else:
                store.take(sample.boat, sample.topic, sample.data, sample.heard_ns)
        await asyncio.sleep(PERIOD_S)


async def _connected(client: ZenohClient, session: asyncio.Task[None]) -> None:
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(PATIENCE_S["stop"]):
            while client.problem:
                if session.done():
                    session.result()  # raises what it died of
                await asyncio.sleep(PERIOD_S)
    if client.problem:
        raise NobodyThereError(f"{client.where}: {client.problem}")


async def _in_reach(client: ZenohClient, store: BoatStore, others_s: float) -> AsyncIterator[str]:
    """Names of boats as they show themselves."""
    end_s, known = time.monotonic() + SEARCH_S, set[str]()
    while time.monotonic() < end_s:
        await asyncio.sleep(PERIOD_S)
        for boat in store.boats.keys() - known:
            if not known:
                end_s = min(end_s, time.monotonic() + others_s)
            known.add(boat)
            yield boat
    if not known:
        raise NobodyThereError(f"{client.where}: no boat has shown itself in {SEARCH_S:g} s")
