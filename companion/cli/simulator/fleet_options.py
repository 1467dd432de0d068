"""Options for several boats, shared by `aritra demo` and `aritra sim`."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path

from companion.boat.load_run import RunSetup
from companion.boat.uplink.zenoh_session import Setting, configured
from companion.cli.simulator.fleet import SHORE, FleetBoat, FleetWires, default_name, fleet, names_of

PORTS = 10
"""Between the ports of two boats: ArduPilot's own step from one instance to the next."""


def add_fleet_arguments(p: argparse.ArgumentParser) -> argparse._ArgumentGroup:
    """Add the options for boats and shore; returns the group, for further options of the command."""
    f = p.add_argument_group("fleet", "docs/telemetry.md says what shore sees of several boats")
    f.add_argument(
        "--boats", metavar="N|NAME,...", help="several boats, each in a world of its own; OUT/NAME is theirs"
    )
    f.add_argument(
        "--shore",
        nargs="?",
        const=SHORE,
        metavar="ENDPOINT",
        help=f"telemetry to a zenoh router there ({SHORE}), and orders from it: signed, with the key in OUT",
    )
    return f


def folders_of(args: argparse.Namespace, setup: RunSetup) -> dict[str, Path]:
    """Folder of each boat by its name; empty: one boat, as the run file says. Raises ConfigError."""
    if args.shore:
        configured(None, "--shore", [Setting("connect/endpoints", "--shore", [args.shore])])
    if args.boats is not None:
        return {name: args.out / name for name in names_of(args.boats, default_name(setup))}
    return {default_name(setup): args.out} if args.shore else {}


def boats_of(args: argparse.Namespace, setup: RunSetup, wires: Mapping[str, FleetWires]) -> list[FleetBoat]:
    """The boats of the options, with a run file each; none: one boat, as the run file says. Raises ConfigError."""
    return fleet(folders_of(args, setup), setup, args.config, args.shore, wires)


def place_of(path: str, name: str) -> str:
    """The path of one boat from a path for all: `-NAME` before the suffix."""
    common = Path(path)
    return str(common.with_name(f"{common.stem}-{name}{common.suffix}"))
