"""`aritra sim`: the simulated autopilot, UWB tag, hull and weather, in real time on real wires."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import signal
import sys
import time
from collections.abc import Callable, Coroutine, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from companion.boat.load_run import EXAMPLES, RunSetup, load_setup
from companion.boat.recorder import Recorder
from companion.cli.options import outputs
from companion.cli.options.files import run_file
from companion.cli.options.values import LAST_PORT, address
from companion.cli.simulator.autopilot_options import add_autopilot_arguments, autopilot
from companion.cli.simulator.firmware_options import add_firmware_arguments, check_options
from companion.cli.simulator.fleet import FleetBoat, FleetWires
from companion.cli.simulator.fleet_options import PORTS, add_fleet_arguments, boats_of, folders_of, place_of
from companion.cli.simulator.world_options import add_world_arguments, world_setup
from companion.core.configuration.tables import ConfigError
from companion.core.messages import Message
from companion.logs.metadata import log_metadata

World = Callable[[], Coroutine[Any, Any, None]]
"""One boat on its wires, yet to run."""


def add_parser(commands) -> None:
    """Add `sim` to the command line."""
    p = commands.add_parser(
        "sim",
        help="simulate the boat on its own wires: MAVLink over UDP, UWB over a pty",
        description="A simulated boat in real time, until interrupted. `aritra run` cannot tell it from a real one. "
        "With --boats several: each boat's ports lie 10 above the one's before it, its name is in its paths. Exit code "
        "0: ended by Ctrl-C; 1: a port or --uwb is taken, or a wire broke; 2: bad input.",
        example="aritra sim --wind 5 270 --dropout 0.1 --truth truth.mcap",
    )
    p.add_argument("--config", type=run_file, metavar="FILE", default=EXAMPLES / "aritra.toml", help="run file (TOML)")
    p.add_argument(
        "--udp-to",
        type=address,
        default=("127.0.0.1", 14551),
        metavar="HOST:PORT",
        help="where MAVLink is sent (default: 127.0.0.1:14551)",
    )
    p.add_argument(
        "--tcp", type=address, metavar="HOST:PORT", help="also serve MAVLink over TCP (for MAVProxy, MAVSDK, QGC)"
    )
    p.add_argument(
        "--uwb",
        default="/tmp/aritra-uwb",
        metavar="PATH",
        help="where the UWB tag appears; other sensors with a wire beside it",
    )
    p.add_argument("--truth", type=outputs.output, metavar="LOG", help="MCAP log of what really happened")
    add_world_arguments(p)
    outputs.add_out(p, "DIR", "folder for run files that --boats, --shore make", default=Path("out/sim"))
    add_fleet_arguments(p)
    add_autopilot_arguments(p)
    add_firmware_arguments(p)
    p.set_defaults(function=sim)


def sim(args: argparse.Namespace) -> int:
    """Run until interrupted; the exit code."""
    setup = load_setup(args.config)
    check_options(args)
    each = _fleet(args, setup)
    with contextlib.ExitStack() as stack:
        worlds = []
        for one in each or [args]:
            record = lambda message: None  # noqa: E731 - a stand-in for a method
            if one.truth:
                try:
                    record = stack.enter_context(_truth_log(one.truth, setup)).record
                except OSError as error:
                    print(f"aritra sim: {outputs.reason(error, one.truth)}", file=sys.stderr)
                    return 2
            worlds.append(_world(one, setup, record))
        return asyncio.run(_serve(worlds))


def _fleet(args: argparse.Namespace, setup: RunSetup) -> list[argparse.Namespace]:
    """Each boat's own options, `boat` among them; empty: one boat."""
    endpoints = {}
    for k, name in enumerate(folders_of(args, setup)):
        own = argparse.Namespace(**vars(args) | {"seed": args.seed + k})
        if args.boats is not None:
            own.udp_to = _address_of("--udp-to", args.udp_to, k)
            own.uwb = place_of(args.uwb, name)
            own.truth = args.truth and Path(place_of(str(args.truth), name))
            own.tcp = args.tcp and _address_of("--tcp", args.tcp, k)
        endpoints[name] = own
    wires = {name: FleetWires("udpin:{}:{}".format(*own.udp_to), own.uwb) for name, own in endpoints.items()}
    for boat in boats_of(args, setup, wires):
        endpoints[boat.name].boat = boat
    return list(endpoints.values())


def _address_of(option: str, first: tuple[str, int], k: int) -> tuple[str, int]:
    """Of boat k, from the address that is given for the first one. Raises ConfigError."""
    host, port = first
    if port + k * PORTS > LAST_PORT:
        raise ConfigError(f"{option}: {host}:{port}: boat {k + 1} would need port {port + k * PORTS}: take a lower one")
    return host, port + k * PORTS


def _truth_log(path: Path, setup: RunSetup) -> Recorder:
    offset_ns = time.time_ns() - time.monotonic_ns()
    metadata = log_metadata(setup.pilot.vessel.name, setup.files)
    return Recorder(path, metadata, time.monotonic_ns, wall_offset_ns=offset_ns)


def _world(args: argparse.Namespace, setup: RunSetup, record: Callable[[Message], None]) -> World:
    from sim.world.loopback import LoopbackWires, serve
    from sim.world.sitl.loopback import JsonWires, serve_firmware

    world, say = world_setup(args, setup), partial(_say, getattr(args, "boat", None))
    if args.ardupilot_json is not None:
        firmware = JsonWires(args.ardupilot_json, args.uwb, args.speed)
        return partial(serve_firmware, world, args.seed, firmware, record, say)
    world = replace(world, **autopilot(args, setup.pilot.vessel))
    wires = LoopbackWires(target=args.udp_to, tcp=args.tcp, uwb_path=args.uwb)
    return partial(serve, world, args.seed, wires, record, say)


async def _serve(worlds: Sequence[World]) -> int:
    """Until SIGINT or SIGTERM."""
    task = asyncio.gather(*(world() for world in worlds))
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, task.cancel)
    try:
        await task
    except asyncio.CancelledError:
        return 0
    except (OSError, ValueError) as error:
        print(f"aritra sim: {error}", file=sys.stderr)
        return 1
    return 0


def _say(boat: FleetBoat | None, where: str) -> None:
    if boat is None:
        print(f"simulator: {where}", flush=True)
    else:
        print(f"simulator: {boat.name}: {where}; aritra run --start --config {boat.config}", flush=True)
