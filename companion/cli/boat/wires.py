"""What commands that talk to the boat share: arguments that name the wires, their ports, the link's signature."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from companion.boat.load_run import EXAMPLES, RunSetup
from companion.boat.signing_key import load_key, load_timestamp
from companion.cli.options.files import run_file
from companion.core.configuration.tables import ConfigError
from drivers.devices import DEVICES, DeviceCodec, devices_of
from drivers.mavlink.signing import Signing
from drivers.ports.port import Port
from drivers.ports.url import PortUrlError, open_port_from_url


def add_wires(p: argparse.ArgumentParser) -> None:
    """`--mavlink`, `--uwb` and `--device`, which stand in for the run file's."""
    p.add_argument("--mavlink", metavar="URL", help="wire to the autopilot instead of the run file's")
    p.add_argument("--uwb", metavar="URL", help="wire to the UWB tag instead of the run file's")
    p.add_argument(
        "--device", type=device, action="append", default=[], metavar="NAME=URL",
        help="wire to another sensor of its own instead of the run file's",
    )  # fmt: skip


def add_config(p: argparse.ArgumentParser) -> None:
    """`--config`, the run file."""
    p.add_argument("--config", type=run_file, metavar="FILE", default=EXAMPLES / "aritra.toml", help="run file (TOML)")


def devices_of_run(args: argparse.Namespace, setup: RunSetup) -> dict[str, tuple[Port, DeviceCodec]]:
    """Port and codec of each sensor that has a wire of its own. Raises ConfigError."""
    run, sensors, given = setup.run, setup.pilot.vessel.sensors, dict(args.device)
    keys = devices_of(sensors)
    for key in given:
        if key not in keys or key == "uwb":
            others = ", ".join(k for k in keys if k != "uwb") or "none"
            raise ConfigError(f"--device: {key}: no such sensor with a wire of its own; the boat has {others}")
    if args.uwb is not None and "uwb" not in keys:
        raise ConfigError(f"--uwb: {setup.pilot.vessel.name} has no UWB tag: leave it out")
    wires: dict[str, tuple[Port, DeviceCodec]] = {}
    for key in keys:
        option, name = (args.uwb, "--uwb") if key == "uwb" else (given.get(key), f"--device {key}")
        port = _opened(option, name, run.wire(key) or "", f"{args.config}: {run.wire_table(key)}.url")
        wires[key] = port, DEVICES[key].codec(sensors, run.device_name(key))
    return wires


def device(text: str) -> tuple[str, str]:
    """NAME=URL of `--device`. Raises ArgumentTypeError."""
    name, equals, url = text.partition("=")
    if not (name and equals and url):
        raise argparse.ArgumentTypeError(f"{text!r}: expected NAME=URL, for example NAME=tcp:192.168.2.95:16171")
    return name, url


def port_of(args: argparse.Namespace, link: str, url: str) -> Port:
    """The port of a link: the command line's, or the run file's. Raises ConfigError."""
    return _opened(getattr(args, link), f"--{link}", url, f"{args.config}: {link}.url")


def _opened(option: str | None, name: str, url: str, key: str) -> Port:
    """The port of an option `name`, or, where it is not given, of the run file's `key`."""
    try:
        return open_port_from_url(url if option is None else option)
    except PortUrlError as error:
        raise ConfigError(f"{key if option is None else name}: {error}") from None


def signing_of(args: argparse.Namespace, setup: RunSetup, stamps: Path) -> Signing | None:
    """What signs the link to the autopilot, if the run file names a key; `stamps`: file of the last stamp.

    Raises ConfigError.
    """
    if (name := setup.run.mavlink.signing_key) is None:
        return None
    path = args.config.parent / name
    key = load_key(path, where=f"{args.config}: mavlink.signing_key")
    return Signing(key, time.time_ns, key_name=str(path), floor=load_timestamp(stamps))
