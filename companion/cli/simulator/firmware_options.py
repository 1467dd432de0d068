"""`aritra sim --ardupilot-json`: the boat for a real ArduPilot in software instead of the simulated one."""

from __future__ import annotations

import argparse

from companion.cli.options.values import address, number
from companion.core.configuration.tables import ConfigError

ADDRESS = "127.0.0.1:9002"
"""Where a firmware started with `--model JSON:127.0.0.1` sends."""
OF_OUR_AUTOPILOT = ("udp_to", "tcp", "boats", "shore", "wiring", "param", "receiver", "firmware", "serial")
"""Options that say nothing to a firmware of its own."""


def add_firmware_arguments(p: argparse.ArgumentParser) -> None:
    """Which firmware to serve. Call after the options of `OF_OUR_AUTOPILOT` have been added."""
    f = p.add_argument_group("a real ArduPilot", "docs/sitl.md says how to start it")
    f.add_argument(
        "--ardupilot-json",
        nargs="?",
        type=address,
        const=address(ADDRESS),
        metavar="HOST:PORT",
        help=f"no simulated autopilot: be the physics of an ArduPilot in software, which sends here ({ADDRESS})",
    )
    f.add_argument("--speed", type=number(0.1, 1000.0), metavar="X", help="hold the firmware back to X times real time")
    p.set_defaults(unset={name: p.get_default(name) for name in OF_OUR_AUTOPILOT})


def check_options(args: argparse.Namespace) -> None:
    """Raises ConfigError for options that do not go together."""
    if args.ardupilot_json is None:
        if args.speed is not None:
            raise ConfigError("--speed: goes with --ardupilot-json; the simulated autopilot runs in real time")
        return
    for name, unset in args.unset.items():
        if getattr(args, name) != unset:
            option = "--" + name.replace("_", "-")
            raise ConfigError(f"{option}: is for the simulated autopilot; leave it out, or --ardupilot-json")
