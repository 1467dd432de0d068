"""Several boats on one machine: their names, and a run file for each, made from a common one.

A boat's folder gets `aritra.toml`, complete and with absolute paths, so that the boat can be run by hand as well, and
where orders from shore are to be signed `command.key`, another for every boat. No boat sees another: each has a world
of its own.
"""

from __future__ import annotations

import contextlib
import os
import re
import secrets
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from msgspec.structs import replace

from companion.boat.load_run import RunSetup
from companion.boat.uplink.telemetry import boat_name
from companion.cli.options.run_file_text import absolute, toml_of
from companion.cli.options.values import DIGITS
from companion.core.configuration.run_file import RunFile, TelemetryLink
from companion.core.configuration.tables import ConfigError

SHORE = "tcp/127.0.0.1:7447"
"""Where a shore on the same machine is looked for: zenoh's own port."""
MOST = 100
KEY_FILE, RUN_FILE = "command.key", "aritra.toml"
KEY_BYTES = 32
HEADER = "# Written by aritra for boat {name}, from {source}; the next start of the fleet writes it anew.\n"
_NAME = re.compile(r"[A-Za-z0-9_.-]{1,40}")


@dataclass(frozen=True)
class FleetWires:
    """Where a boat's devices are. `mavlink`: URL as in a run file; `uwb`: path of the tag, other sensors beside it."""

    mavlink: str
    uwb: str


@dataclass(frozen=True)
class FleetBoat:
    """One of a fleet. `name`: in keys and in what is printed; `folder`: for its run file, logs and results."""

    name: str
    folder: Path
    config: Path


def names_of(text: str, one: str) -> tuple[str, ...]:
    """Boats' names of `--boats`: a number of them, called after `one`, or their names, separated by commas.

    Raises ConfigError.
    """
    if text.isdecimal():
        if len(text) > DIGITS or not 1 <= int(text) <= MOST:
            raise ConfigError(f"--boats: {text}: expected 1 to {MOST}")
        return tuple(f"{one}-{k}" for k in range(1, int(text) + 1))
    names = tuple(name.strip() for name in text.split(","))
    for name in names:
        if not _NAME.fullmatch(name) or set(name) == {"."}:
            raise ConfigError(f"--boats: {name!r}: expected 1 to 40 letters, digits or _.-, or a number of boats")
        if names.count(name) > 1:
            raise ConfigError(f"--boats: {name!r} is there twice: on shore the two would be one, and share its orders")
    return names


def fleet(
    folders: Mapping[str, Path], setup: RunSetup, config: Path, shore: str | None, wires: Mapping[str, FleetWires]
) -> list[FleetBoat]:
    """Make folders, run files and keys of the boats. `folders`, `wires` (others than the run file's): by name.

    `shore`: endpoint that telemetry goes to, instead of the run file's. Raises ConfigError.
    """
    if setup.run.forward and len(folders) > 1:
        raise ConfigError(f"{config}: forward: several boats cannot share one ground station's port: leave it out")
    return [_boat(name, setup.run, config, folder, shore, wires.get(name)) for name, folder in folders.items()]


def device_urls(keys: Iterable[str], uwb_path: str) -> dict[str, str]:
    """Where the simulated sensors of these keys are, as URLs of a run file."""
    from sim.world.loopback import device_path

    return {key: f"serial:{device_path(uwb_path, key)}:115200" for key in keys}


def default_name(setup: RunSetup) -> str:
    """Name of a single boat."""
    return boat_name(setup.run.telemetry or TelemetryLink(connect=(SHORE,)), setup.pilot.vessel.name)


def _boat(
    name: str, run: RunFile, config: Path, folder: Path, shore: str | None, wires: FleetWires | None
) -> FleetBoat:
    boat = FleetBoat(name, folder, folder / RUN_FILE)
    run = absolute(run, config.parent)
    telemetry = _telemetry(run.telemetry, name, shore, where=str(config))
    if wires:
        urls = device_urls(("uwb", *run.devices), wires.uwb)
        run = replace(
            run,
            mavlink=replace(run.mavlink, url=wires.mavlink),
            uwb=run.uwb and replace(run.uwb, url=urls["uwb"]),
            devices={key: replace(wire, url=urls[key]) for key, wire in run.devices.items()},
        )
    run = replace(run, telemetry=telemetry, log=replace(run.log, folder=str(folder.resolve())))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if telemetry and telemetry.command_key == KEY_FILE:
            _make_key(folder / KEY_FILE)
        boat.config.write_text(HEADER.format(name=name, source=config) + toml_of(run), encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{error.filename or folder}: {error.strerror}") from None
    return boat


def _telemetry(link: TelemetryLink | None, name: str, shore: str | None, *, where: str) -> TelemetryLink | None:
    """The run file's with the boat's own name; without one, to `shore` with signed orders."""
    if link is None:
        return TelemetryLink(connect=(shore,), boat=name, commands=True, command_key=KEY_FILE) if shore else None
    if shore:
        return replace(link, connect=(shore,), listen=(), boat=name)
    if link.listen:
        raise ConfigError(f"{where}: telemetry.listen: boats of a fleet connect to a router (--shore ENDPOINT)")
    return replace(link, boat=name)


def _make_key(path: Path) -> None:
    """Write a key that only its owner may read; an existing one is kept, as shore may have it already."""
    with contextlib.suppress(FileExistsError):
        file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(file, "wb") as opened:
            opened.write(secrets.token_bytes(KEY_BYTES))
