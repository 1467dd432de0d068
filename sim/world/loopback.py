"""The simulated world in real time, on real wires: MAVLink over UDP (and TCP), UWB bytes over a pty.

Steps of 10 ms against the machine's monotonic clock, which is also the world's clock, so that stamps of two
processes on one machine compare. Late steps are caught up; the truth is recorded at 20 Hz.
"""

from __future__ import annotations

import asyncio
import errno
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from companion.core.messages import GroundTruth
from drivers.devices import devices_of
from drivers.ports.pseudo_terminal import PtyPort
from sim.world.mavlink_server import Address, MavlinkServer
from sim.world.world import STEP_NS, World, WorldSetup

TRUTH_NS = 50_000_000
CATCH_UP_STEPS = 20
"""Steps made up at once after a stall, before the wires get their turn again."""


@dataclass(frozen=True)
class LoopbackWires:
    """Where the devices appear. `target`: where UDP sends from the start; `tcp`: listen there, or None.

    `uwb_path`: of the tag; other sensors with a wire appear beside it (`device_path`).
    """

    udp: Address = ("127.0.0.1", 0)
    target: Address | None = ("127.0.0.1", 14551)
    tcp: Address | None = None
    uwb_path: str = "/tmp/aritra-uwb"


def device_path(uwb_path: str, key: str) -> str:
    """Where a sensor appears: the tag's path, for others with their key in place of `uwb`."""
    folder, slash, name = uwb_path.rpartition("/")
    return folder + slash + (name.replace("uwb", key) if "uwb" in name else f"{name}-{key}" if key != "uwb" else name)


async def plug_in(pty: PtyPort, others: str) -> None:
    """Open a device. Raises OSError; where another simulator holds its path it names `others`: options to give too."""
    try:
        await pty.open()
    except OSError as error:
        if error.errno != errno.EADDRINUSE:
            raise
        hint = f"end it, or choose another --uwb (and {others})"
        raise OSError(f"{pty.link} is held by another aritra sim: {hint}") from None


async def serve(
    setup: WorldSetup,
    seed: int,
    wires: LoopbackWires,
    on_truth: Callable[[GroundTruth], None],
    ready: Callable[[str], None],
) -> None:
    """Run until cancelled. `ready` is told once where the devices are. Raises OSError for a taken port or path."""
    world = World(replace(setup, boot_ns=time.monotonic_ns()), seed)
    server = MavlinkServer(world.rover, lambda: world.t_ns)
    ptys = {key: PtyPort(device_path(wires.uwb_path, key)) for key in devices_of(setup.vessel.sensors)}
    try:
        udp = await server.open_udp(wires.udp, wires.target)
        where = [f"MAVLink on udp {udp[0]}:{udp[1]}" + (f" to {_text(wires.target)}" if wires.target else "")]
        if wires.tcp:
            where.append(f"tcp {_text(await server.open_tcp(wires.tcp))}")
        for key, pty in ptys.items():
            await plug_in(pty, "--udp-to")
            where.append(f"{'UWB tag' if key == 'uwb' else key.upper()} on {device_path(wires.uwb_path, key)}")
        ready(", ".join(where))
        async with asyncio.TaskGroup() as group:
            for key, pty in ptys.items():
                group.create_task(_answer(world if key == "uwb" else None, pty))
            group.create_task(_advance(world, server, ptys, on_truth))
    finally:
        for pty in ptys.values():
            await pty.close()
        await server.close()


async def _advance(
    world: World, server: MavlinkServer, ptys: Mapping[str, PtyPort], on_truth: Callable[[GroundTruth], None]
) -> None:
    truth_due_ns = world.t_ns
    while True:
        behind = (time.monotonic_ns() - world.t_ns) // STEP_NS
        for _ in range(min(behind, CATCH_UP_STEPS)):
            outgoing = world.step()
            server.send(outgoing.mavlink)
            for key, data in {"uwb": outgoing.uwb, **outgoing.devices}.items():
                if data:
                    ptys[key].send(data)
            if world.t_ns >= truth_due_ns:
                truth_due_ns += TRUTH_NS
                on_truth(world.truth())
        await asyncio.sleep(max(0.0, (world.t_ns + STEP_NS - time.monotonic_ns()) * 1e-9))


async def _answer(tag: World | None, pty: PtyPort) -> None:
    """What the companion says to a device; while nobody has it open this waits. Only the tag answers."""
    while data := await pty.receive():
        if tag and (answer := tag.uwb(data)):
            pty.send(answer)


def _text(address: Address) -> str:
    return f"{address[0]}:{address[1]}"
