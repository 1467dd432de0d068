"""The simulated world in real time, on real wires: MAVLink over UDP (and TCP), UWB bytes over a pty.

Steps of 10 ms against the machine's monotonic clock, which is also the world's clock, so that stamps of two
processes on one machine compare. Late steps are caught up; the truth is recorded at 20 Hz.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from companion.core.messages import GroundTruth
from drivers.ports.pseudo_terminal import PtyPort
from sim.world.mavlink_server import Address, MavlinkServer
from sim.world.world import STEP_NS, World, WorldSetup

TRUTH_NS = 50_000_000
CATCH_UP_STEPS = 20
"""Steps made up at once after a stall, before the wires get their turn again."""


@dataclass(frozen=True)
class LoopbackWires:
    """Where the devices appear. `target`: where UDP sends from the start; `tcp`: listen there, or None."""

    udp: Address = ("127.0.0.1", 0)
    target: Address | None = ("127.0.0.1", 14551)
    tcp: Address | None = None
    uwb_path: str = "/tmp/aritra-uwb"


async def serve(
    setup: WorldSetup,
    seed: int,
    wires: LoopbackWires,
    on_truth: Callable[[GroundTruth], None],
    ready: Callable[[str], None],
) -> None:
    """Run until cancelled. `ready` is told once where the devices are. Raises OSError for a taken port."""
    world = World(replace(setup, boot_ns=time.monotonic_ns()), seed)
    server = MavlinkServer(world.rover, lambda: world.t_ns)
    pty = PtyPort(wires.uwb_path)
    try:
        udp = await server.open_udp(wires.udp, wires.target)
        where = [f"MAVLink on udp {udp[0]}:{udp[1]}" + (f" to {_text(wires.target)}" if wires.target else "")]
        if wires.tcp:
            where.append(f"tcp {_text(await server.open_tcp(wires.tcp))}")
        await pty.open()
        where.append(f"UWB tag on {wires.uwb_path}")
        ready(", ".join(where))
        async with asyncio.TaskGroup() as group:
            group.create_task(_answer_tag(world, pty))
            group.create_task(_advance(world, server, pty, on_truth))
    finally:
        await pty.close()
        await server.close()


async def _advance(world: World, server: MavlinkServer, pty: PtyPort, on_truth: Callable[[GroundTruth], None]) -> None:
    truth_due_ns = world.t_ns
    while True:
        behind = (time.monotonic_ns() - world.t_ns) // STEP_NS
        for _ in range(min(behind, CATCH_UP_STEPS)):
            outgoing = world.step()
            server.send(outgoing.mavlink)
            if outgoing.uwb:
                _offer(pty, outgoing.uwb)
            if world.t_ns >= truth_due_ns:
                truth_due_ns += TRUTH_NS
                on_truth(world.truth())
        await asyncio.sleep(max(0.0, (world.t_ns + STEP_NS - time.monotonic_ns()) * 1e-9))


async def _answer_tag(world: World, pty: PtyPort) -> None:
    """What the companion says to the tag; while nobody has the device open this waits."""
    while data := await pty.receive():
        _offer(pty, world.uwb(data))


def _offer(pty: PtyPort, data: bytes) -> None:
    if data:
        pty.send(data)


def _text(address: Address) -> str:
    return f"{address[0]}:{address[1]}"
