"""`aritra check`: the pre-flight table. Only reads and requests; never arms, overrides or sets a parameter."""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
from pathlib import Path

import msgspec
from rich.console import Console
from rich.table import Table
from rich.text import Text

from companion.boat.clock import BoatClock
from companion.boat.load_run import RunSetup, load_setup
from companion.boat.preflight import Listener, all_rows, disk_state
from companion.boat.signing_key import STAMP_FILE
from companion.cli.boat.wires import add_config, add_wires, devices_of_run, port_of, signing_of
from companion.cli.options.values import seconds
from companion.core.preflight.rows import Level, Row, worst
from drivers.devices import DeviceCodec
from drivers.mavlink.codec import MavlinkCodec
from drivers.ports.port import Port

FINE, REFUSED = 0, 1
LISTEN_S = 5.0
STYLES: dict[Level, str] = {"ok": "green", "warning": "yellow", "refuse": "bold red"}


def add_parser(commands) -> None:
    """Add `check` to the command line."""
    p = commands.add_parser(
        "check",
        help="before the boat moves: wires, sensors, and whether it stops when the companion dies",
        description="A table of what is found, what is needed and what to do. Propellers off or boat moored: nothing "
        "is armed, overridden or set. Exit code 0: start (with the warnings read); 1: do not start; 2: bad input.",
        example="aritra check --config deploy/aritra.toml --all",
    )
    add_config(p)
    add_wires(p)
    p.add_argument(
        "--listen-s", type=seconds(0.01, 3600.0), default=LISTEN_S, metavar="S", help="how long to listen (default: 5)"
    )
    p.add_argument("--all", action="store_true", help="explain also what is in order")
    p.add_argument("--json", action="store_true", help="the rows as JSON instead of a table")
    p.set_defaults(function=check)


def check(args: argparse.Namespace, console: Console | None = None) -> int:
    """Listen, judge and print; the exit code."""
    setup = load_setup(args.config)
    mavlink = port_of(args, "mavlink", setup.run.mavlink.url)
    devices = devices_of_run(args, setup)
    console, errors = console or Console(), Console(stderr=True)
    rows = asyncio.run(_look(args, setup, mavlink, devices, errors))
    level = worst(rows)
    if args.json:
        report = {"verdict": level, "rows": msgspec.to_builtins(rows)}
        sys.stdout.write(json.dumps(report, indent=2) + "\n")
    else:
        show(rows, console, explain_all=args.all)
    return REFUSED if level == "refuse" else FINE


async def _look(
    args: argparse.Namespace,
    setup: RunSetup,
    mavlink: Port,
    devices: dict[str, tuple[Port, DeviceCodec]],
    errors: Console,
) -> list[Row]:
    folder = args.config.parent / setup.run.log.folder if setup.run.log.folder else Path()
    link = setup.run.mavlink
    signing = signing_of(args, setup, folder / STAMP_FILE)
    ours = link.autopilot_system_id
    codec = MavlinkCodec(link.system_id, link.component_id, target_system=ours, signing=signing)
    with errors.status("opening the wires") as status:
        listener = Listener(
            setup,
            mavlink=(mavlink, codec),
            devices=devices,
            clock=BoatClock(),
            say=status.update,
        )
        observed, parameters = await listener.run(args.listen_s, disk_state(folder, setup.run.log.quota_MB))
    return all_rows(setup, observed, parameters)


def show(rows: list[Row], console: Console, *, explain_all: bool = False) -> None:
    """The table; below it a sentence for every row that is not in order, and the verdict."""
    table = Table(box=None, pad_edge=False)
    for head in ("", "area", "what", "found", "needed"):
        table.add_column(head, overflow="fold")
    for row in rows:
        table.add_row(
            Text(row.level, style=STYLES[row.level]), row.area, Text(row.name), Text(row.found), Text(row.needed)
        )
    console.print(table)
    explained = [row for row in rows if explain_all or row.level != "ok"]
    for row in sorted(explained, key=lambda row: ("refuse", "warning", "ok").index(row.level)):
        console.print()
        console.print(Text(f"{row.level}: {row.name} = {row.found}", style=STYLES[row.level]))
        console.print(Text(f"  {row.why}"))
        if row.fix:
            console.print(Text(f"  -> {row.fix}"))
    console.print()
    console.print(_verdict(rows))


def _verdict(rows: list[Row]) -> Text:
    level = worst(rows)
    count = sum(row.level == level for row in rows)
    s = "s" if count > 1 else ""
    texts = {
        "ok": f"ready: {len(rows)} rows, all in order",
        "warning": f"ready, with {count} warning{s} to read",
        "refuse": f"DO NOT START: {count} row{s} refuse{'' if s else 's'}",
    }
    return Text(texts[level], style=STYLES[level])
