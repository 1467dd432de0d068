"""One stop to several boats, without a console: for a terminal, a script, a key on a desk."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Sequence

from companion.shore.console.keys import Keys
from companion.shore.console.known_boats import KnownBoats
from companion.shore.console.orders import PATIENCE_S, Orders, SentOrder
from companion.shore.console.store import BoatStore
from companion.shore.console.zenoh_client import ZenohClient

SEARCH_S = 8.0
"""How long boats are looked for where none is named: one without a connection tries each 4 s (zenoh's default)."""
OTHERS_S = 1.0
"""How long others may come after the first (assumed)."""
PERIOD_S = 0.05


class NobodyThereError(Exception):
    """There is nobody whom a stop could be sent to. The text says where was looked."""


async def stop_boats(client: ZenohClient, keys: Keys, names: Sequence[str]) -> list[SentOrder]:
    """Give a stop to the boats of these names, or to all that are in reach; what came of each, within about 20 s.

    A named boat is sent its stop whether it is in reach or not. Raises NobodyThereError.
    """
    store = BoatStore()
    orders = Orders(KnownBoats(store, keys), client.ask, lambda _: None)
    work = [asyncio.create_task(client.run()), asyncio.create_task(_receive(client, store))]
    try:
        await _connected(client)
        boats = dict.fromkeys(names or await _in_reach(client, store))
        return list(await asyncio.gather(*(orders.give(boat, "stop") for boat in boats)))
    finally:
        for task in work:
            task.cancel()
        await asyncio.gather(*work, return_exceptions=True)


async def _receive(client: ZenohClient, store: BoatStore) -> None:
    """Telemetry says for which run and clock a stop is made out first."""
    while True:
        for sample in client.take():
            if sample.topic is None:
                store.alive(sample.boat, sample.there, sample.heard_ns)
            else:
                store.take(sample.boat, sample.topic, sample.data, sample.heard_ns)
        await asyncio.sleep(PERIOD_S)


async def _connected(client: ZenohClient) -> None:
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(PATIENCE_S["stop"]):
            while client.problem:
                await asyncio.sleep(PERIOD_S)
    if client.problem:
        raise NobodyThereError(f"{client.where}: {client.problem}")


async def _in_reach(client: ZenohClient, store: BoatStore) -> list[str]:
    """Names of all boats, a while after the first has shown itself."""
    end_s = time.monotonic() + SEARCH_S
    found_s = None
    while time.monotonic() < (end_s if found_s is None else min(end_s, found_s + OTHERS_S)):
        await asyncio.sleep(PERIOD_S)
        if found_s is None and store.boats:
            found_s = time.monotonic()
    if not store.boats:
        raise NobodyThereError(f"{client.where}: no boat has shown itself in {SEARCH_S:g} s")
    return list(store.boats)
