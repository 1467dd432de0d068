"""What commands that talk to the boat share: arguments that name the wires, their ports, the link's signature."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from companion.boat.load_run import EXAMPLES, RunSetup
from companion.boat.signing_key import load_key, load_timestamp
from companion.cli.options.files import run_file
from companion.core.configuration.tables import ConfigError
from drivers.mavlink.signing import Signing
from drivers.ports.port import Port
from drivers.ports.url import PortUrlError, open_port_from_url


def add_wires(p: argparse.ArgumentParser) -> None:
    """`--mavlink` and `--uwb`, which stand in for the run file's."""
    p.add_argument("--mavlink", metavar="URL", help="wire to the autopilot instead of the run file's")
    p.add_argument("--uwb", metavar="URL", help="wire to the UWB tag instead of the run file's")


def add_config(p: argparse.ArgumentParser) -> None:
    """`--config`, the run file."""
    p.add_argument("--config", type=run_file, metavar="FILE", default=EXAMPLES / "aritra.toml", help="run file (TOML)")


def port_of(args: argparse.Namespace, link: str, url: str) -> Port:
    """The port of a link: the command line's, or the run file's. Raises ConfigError."""
    option = getattr(args, link)
    try:
        return open_port_from_url(option or url)
    except PortUrlError as error:
        raise ConfigError(f"--{link}: {error}" if option else f"{args.config}: {link}.url: {error}") from None


def signing_of(args: argparse.Namespace, setup: RunSetup, stamps: Path) -> Signing | None:
    """What signs the link to the autopilot, if the run file names a key; `stamps`: file of the last stamp.

    Raises ConfigError.
    """
    if (name := setup.run.mavlink.signing_key) is None:
        return None
    path = args.config.parent / name
    key = load_key(path, where=f"{args.config}: mavlink.signing_key")
    return Signing(key, time.time_ns, key_name=str(path), floor=load_timestamp(stamps))
