"""`aritra provision`: put a wiring's parameters and script on the autopilot, or fetch its logs."""

from __future__ import annotations

import argparse

from companion.cli.boat.wires import add_config
from companion.cli.options.outputs import output

WIRINGS = ("gate", "scaled", "omni")


def add_parser(commands) -> None:
    """Add `provision` to the command line."""
    p = commands.add_parser(
        "provision",
        help="set up the autopilot for a wiring, or download its logs",
        description="Shows what would change, asks, writes, reads back. Refuses while armed. "
        "Exit code 0: done, or nothing to do; 1: not done, or only in part, and then not restarted; 2: bad input.",
        example="aritra provision --wiring gate --mavlink serial:/dev/ttyACM0:115200 --dry-run",
    )
    what = p.add_mutually_exclusive_group(required=True)
    what.add_argument("--wiring", choices=WIRINGS, help="parameter file of deploy/ardupilot (recommended: gate)")
    what.add_argument("--logs", type=output, metavar="DIR", help="download all dataflash logs into a folder")
    add_config(p)
    p.add_argument("--mavlink", metavar="URL", help="wire to the autopilot instead of the run file's")
    p.add_argument("--unsigned", action="store_true", help="do not sign, though the run file names a key (USB port)")
    p.add_argument("--dry-run", action="store_true", help="show the difference, change nothing")
    p.add_argument("--yes", action="store_true", help="do not ask")
    p.add_argument(
        "--reboot",
        action="store_true",
        help="restart the autopilot afterwards, which the gate needs; not after a step that failed",
    )
    p.set_defaults(function=provision)


def provision(args: argparse.Namespace) -> int:
    """Connect and do it; the exit code."""
    from companion.cli.boat.provisioning import provision as work

    return work(args)
