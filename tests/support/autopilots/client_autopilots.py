"""Autopilots in real time that a client connects to by TCP: the simulated one, or a firmware in our physics.

The companion's overrides reach both meanwhile, all channels in neutral, so that RC input is there.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, closing
from pathlib import Path

from pymavlink.dialects.v20 import ardupilotmega as wire

from sim.world.world import WorldSetup
from tests.evidence.main_job.parts import reference_boat
from tests.sim.world.autopilot.autopilot_process import booted_rover, served
from tests.support.autopilots.firmware_rig import firmware_world
from tests.support.autopilots.firmware_world import FirmwareWorld

SETTLE_S = 30.0
"""Simulated; as in tests/evidence/firmware/dialogue.py."""
PERIOD_S = 0.1


def _overrides() -> wire.MAVLink:
    return wire.MAVLink(None, 1, 191)


def _neutral(mav: wire.MAVLink) -> bytes:
    mav.seq = (mav.seq + 1) % 256
    values = [1500] * 4 + [65535] * 4 + [1500] * 4 + [0] * 6
    return wire.MAVLink_rc_channels_override_message(0, 0, *values).pack(mav)


@asynccontextmanager
async def autopilot(binary: Path | None, folder: Path) -> AsyncIterator[tuple[str, int]]:
    """Where it listens; None: the simulated one."""
    running = _simulated() if binary is None else _real(binary, folder)
    async with running as address:
        yield address


@asynccontextmanager
async def _simulated() -> AsyncIterator[tuple[str, int]]:
    rover, mav = booted_rover(), _overrides()

    async def hold() -> None:
        while True:
            rover.receive(_neutral(mav), "companion", time.monotonic_ns())
            await asyncio.sleep(PERIOD_S)

    async with served(rover) as (_, tcp):
        holding = asyncio.create_task(hold())
        try:
            yield tcp
        finally:
            holding.cancel()


@asynccontextmanager
async def _real(binary: Path, folder: Path) -> AsyncIterator[tuple[str, int]]:
    setup, _, _ = reference_boat()
    with closing(firmware_world(binary, folder, WorldSetup(setup.vessel, setup.site), 1, gps=False)) as world:
        stop, settled = threading.Event(), threading.Event()
        stepping = threading.Thread(target=_pace, args=(world, stop, settled), daemon=True)
        stepping.start()
        try:
            assert await asyncio.to_thread(settled.wait, 120.0), "the firmware did not settle"
            yield world.second_port
        finally:
            stop.set()
            await asyncio.to_thread(stepping.join)


def _pace(world: FirmwareWorld, stop: threading.Event, settled: threading.Event) -> None:
    """Step until `stop`: as fast as it goes until it has settled, then no faster than real time."""
    mav, due_s, ahead_of_s = _overrides(), 0.0, None
    while not stop.is_set():
        if world.t_ns * 1e-9 >= due_s:
            due_s += PERIOD_S
            world.mavlink(_neutral(mav))
        world.step()
        if world.t_ns * 1e-9 < SETTLE_S:
            continue
        if ahead_of_s is None:
            ahead_of_s = world.t_ns * 1e-9 - time.monotonic()
            settled.set()
        time.sleep(max(0.0, world.t_ns * 1e-9 - time.monotonic() - ahead_of_s))
