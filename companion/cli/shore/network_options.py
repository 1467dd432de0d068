"""Options of every command of the shore: where boats are, the keys that orders are signed with, and who gives them."""

from __future__ import annotations

import argparse
import getpass
import re
import socket

from companion.cli.options.files import zenoh_file
from companion.core.configuration.tables import ConfigError

LOCAL = "tcp/127.0.0.1:7447"
"""Endpoint without `--connect`, `--listen` and `--config`: where `aritra demo --shore` on this machine connects."""


def add_network(p: argparse.ArgumentParser, default: str) -> None:
    """Add the options; `default`: what is done without an endpoint, for `--listen`'s help."""
    p.add_argument("--connect", action="append", default=[], metavar="ENDPOINT", help="zenoh router, tcp/HOST:7447")
    p.add_argument(
        "--listen", action="append", default=[], metavar="ENDPOINT",
        help=f"zenoh endpoint that boats connect to, no router needed ({default})",
    )  # fmt: skip
    p.add_argument(
        "--config", type=zenoh_file, metavar="FILE", help="zenoh's own file, for TLS: deploy/zenoh/shore.json5"
    )
    p.add_argument(
        "--command-key", action="append", default=[], metavar="[BOAT=]FILE",
        help="key that orders are signed with: for all boats, for one, or a folder that `aritra demo --shore` made",
    )  # fmt: skip
    p.add_argument("--name", default=default_name(), help="who gives the orders, in the boat's log (%(default)s)")


def default_name() -> str:
    """user@host, in the letters that an order may carry."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError):
        user = "shore"
    return re.sub(r"[^A-Za-z0-9_.@ -]+", "-", f"{user}@{socket.gethostname()}")[:40]


def sender_name(args: argparse.Namespace) -> str:
    """`--name`. Raises ConfigError for one that no order may carry."""
    if not re.fullmatch(r"[A-Za-z0-9_.@ -]{1,40}", args.name):
        raise ConfigError(f"--name: {args.name!r}: expected 1 to 40 letters, digits and _ . @ - or spaces")
    return args.name
