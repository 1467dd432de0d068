"""`aritra stop`: stop boats from a terminal, over zenoh. Docs: docs/shore.md."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import re
import socket
import sys
from typing import TextIO

from companion.cli.shore.key_files import KeyFiles
from companion.cli.shore.network_options import LOCAL, add_network, sender_name
from companion.core.configuration.tables import ConfigError
from companion.shore.console.orders import SentOrder
from companion.shore.console.store import NAME

ELSEWHERE = "boats on other computers: --connect tcp/CONSOLE:7447, or --listen tcp/0.0.0.0:7447 in a console's place"


def add_parser(commands) -> None:
    """Add `stop` to the command line."""
    p = commands.add_parser(
        "stop",
        help="stop boats from here, without a browser",
        description="Sends a signed STOP to each BOAT, or to all that are in reach, and repeats it until the boat "
        "answers or 10 s are over. Thrusters go to neutral and stay there until somebody gives the boat another order. "
        "Works beside `aritra shore` and through it. Exit code 0: every boat has it; 1: one has not (no answer, no "
        "key, refused), or none is there.",
        example="aritra stop --command-key out/demo/",
    )
    p.add_argument(
        "boat", nargs="*", type=_boat, metavar="BOAT", help="names of boats (default: all that are in reach)"
    )
    add_network(p, f"default: by {LOCAL} through the console or router of this computer, else in its place")
    p.set_defaults(function=stop)


def _boat(text: str) -> str:
    if not re.match(NAME, text):
        raise argparse.ArgumentTypeError(f"{text!r}: expected a boat's name, 1 to 40 letters, digits and _ . -")
    return text


def stop(args: argparse.Namespace) -> int:
    """Give the stop, print what came of it for each boat; the exit code."""
    from companion.shore.console.keys import Keys
    from companion.shore.console.zenoh_client import ZenohClient, config_of
    from companion.shore.stop_boats import OTHERS_S, SEARCH_S, NobodyThereError, stop_boats

    if not args.command_key:
        raise ConfigError("--command-key is missing: a boat obeys whoever has its key (docs/telemetry.md#orders)")
    keys = Keys(KeyFiles(args.command_key).find, sender_name(args))
    connect, listen = args.connect, args.listen
    if not (connect or listen or args.config):
        connect, listen = ([LOCAL], []) if _answers(LOCAL) else ([], [LOCAL])
    client = ZenohClient(config_of(args.config, connect, listen))
    _say(f"STOP to {', '.join(args.boat) or 'all boats in reach'}, {client.where}", sys.stderr)
    others_s = OTHERS_S if connect else SEARCH_S
    try:
        orders = asyncio.run(stop_boats(client, keys, args.boat, _print, others_s=others_s))
    except NobodyThereError as error:
        print(f"aritra stop: {error}: no stop was sent; {ELSEWHERE}", file=sys.stderr)
        return 1
    return 0 if all(_has_it(order) for order in orders) else 1


def _answers(endpoint: str) -> bool:
    """Whether a program listens at this TCP endpoint of zenoh."""
    host, port = endpoint.removeprefix("tcp/").rsplit(":", 1)
    try:
        socket.create_connection((host, int(port)), timeout=1.0).close()
    except OSError:
        return False
    return True


def _has_it(order: SentOrder) -> bool:
    """Whether every program of the boat's name that was found has the stop."""
    return order.outcome is not None and order.outcome.status != "refused" and not order.missing


def _print(order: SentOrder) -> None:
    line = f"NOT STOPPED: {order.why}"
    if order.outcome is not None:
        state = "NOT STOPPED" if order.outcome.status == "refused" else "PARTLY STOPPED" if order.missing else "stopped"
        line = f"{state} after {order.after_ms:.0f} ms: {order.outcome.text}. {order.why}".strip()
    _say(f"{order.boat}: {line}", sys.stdout)


def _say(text: str, out: TextIO) -> None:
    """A terminal that is gone, a full disk or `| head -1` keeps no boat from its stop."""
    with contextlib.suppress(OSError, ValueError):
        print(text, file=out, flush=True)
