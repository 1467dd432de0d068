"""`aritra sim`: the simulated autopilot, UWB tag, hull and weather, in real time on real wires."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import signal
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

from companion.commands.sim_autopilot import add_autopilot_arguments, autopilot
from companion.commands.sim_firmware import add_firmware_arguments, check_options
from companion.core.config import ConfigError
from companion.log_metadata import log_metadata
from companion.recorder import Recorder
from companion.setup import EXAMPLES, Setup, load_setup


def add_parser(commands) -> None:
    """Add `sim` to the command line."""
    p = commands.add_parser(
        "sim",
        help="simulate the boat on its own wires: MAVLink over UDP, UWB over a pty",
        description="A simulated boat in real time, until interrupted. `aritra run` cannot tell it from a real one.",
    )
    p.add_argument("--config", type=Path, default=EXAMPLES / "aritra.toml", help="run file (TOML)")
    p.add_argument("--udp-to", default="127.0.0.1:14551", metavar="HOST:PORT", help="where MAVLink is sent")
    p.add_argument("--tcp", metavar="HOST:PORT", help="also serve MAVLink over TCP (for MAVProxy, MAVSDK, QGC)")
    p.add_argument("--uwb", default="/tmp/aritra-uwb", metavar="PATH", help="where the UWB tag appears")
    p.add_argument("--truth", type=Path, help="MCAP log of what really happened")
    add_world_arguments(p)
    add_autopilot_arguments(p)
    add_firmware_arguments(p)
    p.set_defaults(function=sim)


def add_world_arguments(p: argparse.ArgumentParser) -> None:
    """What world to simulate; shared with `demo`."""
    w = p.add_argument_group("world")
    w.add_argument("--seed", type=_seed, default=1, help="of noise, biases, weather and mismatch")
    w.add_argument("--start", type=float, nargs=3, default=(8.0, 8.0, 20.0), metavar=("N", "E", "DEG"))
    w.add_argument("--current", type=float, nargs=2, default=(0.0, 0.0), metavar=("M/S", "DEG"), help="towards")
    w.add_argument("--wind", type=float, nargs=2, default=(0.0, 0.0), metavar=("M/S", "DEG"), help="from")
    w.add_argument("--gusts", type=float, default=0.2, help="standard deviation of wind speed, share")
    w.add_argument("--waves", type=float, default=0.0, metavar="M", help="significant height")
    w.add_argument("--mismatch", type=float, default=0.0, metavar="SHARE", help="plant off its vessel file by up to")
    w.add_argument("--nlos", type=float, default=0.0, metavar="SHARE", help="of UWB ranges that read far")
    w.add_argument("--dropout", type=float, default=0.0, metavar="SHARE", help="of UWB ranges that are missing")


def world_arguments(args: argparse.Namespace) -> list[str]:
    """The world's options as a command line, to hand them on to a process of its own."""
    words: list[str] = ["--seed", str(args.seed)]
    for name in ("start", "current", "wind"):
        words += [f"--{name}", *map(str, getattr(args, name))]
    for name in ("gusts", "waves", "mismatch", "nlos", "dropout"):
        words += [f"--{name}", str(getattr(args, name))]
    return words


def world_setup(args: argparse.Namespace, setup: Setup):
    """The world that the command line asks for, with the run file's boat and site."""
    import numpy as np  # noqa: PLC0415  (the command line imports the simulator only when it is asked for)

    from sim.world.environment import Weather  # noqa: PLC0415
    from sim.world.sensors import UwbFaults  # noqa: PLC0415
    from sim.world.world import WorldSetup  # noqa: PLC0415

    north, east, heading = args.start
    return WorldSetup(
        setup.pilot.vessel,
        setup.pilot.site,
        start=(north, east, float(np.deg2rad(heading))),
        weather=Weather(
            V_c_m_s=args.current[0],
            beta_c_deg=args.current[1],
            V_w_m_s=args.wind[0],
            beta_w_deg=args.wind[1],
            gustiness=args.gusts,
            H_s_m=args.waves,
        ),
        mismatch=args.mismatch,
        faults=UwbFaults(dropout=args.dropout, nlos=args.nlos),
    )


def sim(args: argparse.Namespace) -> int:
    """Run until interrupted; the exit code."""
    from sim.world.json_loopback import JsonWires, serve_firmware  # noqa: PLC0415  (only when it is asked for)
    from sim.world.loopback import Wires, serve  # noqa: PLC0415

    setup = load_setup(args.config)
    check_options(args)
    world = world_setup(args, setup)
    if args.ardupilot_json is None:
        world = replace(world, **autopilot(args, setup.pilot.vessel))
        wires = Wires(target=_address(args.udp_to), tcp=_address(args.tcp) if args.tcp else None, uwb_path=args.uwb)
        served = partial(serve, world, args.seed, wires)
    else:
        firmware = JsonWires(_address(args.ardupilot_json), args.uwb, args.speed)
        served = partial(serve_firmware, world, args.seed, firmware)
    with contextlib.ExitStack() as stack:
        record = lambda message: None  # noqa: E731
        if args.truth:
            offset_ns = time.time_ns() - time.monotonic_ns()
            metadata = log_metadata(setup.pilot.vessel.name, setup.files)
            try:
                log = Recorder(args.truth, metadata, time.monotonic_ns, wall_offset_ns=offset_ns)
            except OSError as error:
                print(f"aritra sim: {args.truth}: {error.strerror}", file=sys.stderr)
                return 2
            record = stack.enter_context(log).record
        return asyncio.run(_serve(served(record, _say)))


async def _serve(world) -> int:
    """Until SIGINT or SIGTERM."""
    task = asyncio.ensure_future(world)
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


def _say(where: str) -> None:
    print(f"simulator: {where}", flush=True)


def _address(text: str) -> tuple[str, int]:
    host, colon, port = text.rpartition(":")
    if not colon or not port.isdigit() or int(port) > 65535:
        raise ConfigError(f"{text!r}: expected HOST:PORT")
    return host, int(port)


def _seed(text: str) -> int:
    if not text.isdigit():
        raise argparse.ArgumentTypeError(f"{text!r}: expected a whole number from 0")
    return int(text)
