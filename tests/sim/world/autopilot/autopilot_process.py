"""The simulated autopilot on free local ports, stepped in real time beside a real client."""

from __future__ import annotations

import asyncio
import time
from contextlib import asynccontextmanager

from sim.world.autopilot import AT_REST, Rover
from sim.world.mavlink_server import MavlinkServer

PERIOD_S = 0.01


@asynccontextmanager
async def served(rover, udp_target=None, sensors=AT_REST):
    """Yields (udp address, tcp address) of the running autopilot."""
    server = MavlinkServer(rover, time.monotonic_ns)
    udp = await server.open_udp(("127.0.0.1", 0), udp_target)
    tcp = await server.open_tcp(("127.0.0.1", 0))

    async def steps():
        while True:
            server.send(rover.step(time.monotonic_ns(), sensors))
            await asyncio.sleep(PERIOD_S)

    stepping = asyncio.create_task(steps())
    try:
        yield udp, tcp
    finally:
        stepping.cancel()
        await asyncio.gather(stepping, return_exceptions=True)
        await server.close()


def booted_rover(**kwargs):
    """A rover that was switched on three seconds ago: start-up and its radio fail-safe are over."""
    now_ns = time.monotonic_ns()
    rover = Rover(now_ns - 3_000_000_000, **kwargs)
    for ms in range(0, 3000, 10):
        rover.step(now_ns - 3_000_000_000 + ms * 1_000_000, AT_REST)
    return rover


async def until(condition, seconds=5.0):
    """Wait for something to become true; the last value otherwise."""
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        await asyncio.sleep(0.02)
    return condition()
