"""zenoh for boat and shore: its configuration from a file with settings over it, and the end of a session."""

from __future__ import annotations

import json
import re
import threading
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import zenoh

from companion.core.configuration.tables import ConfigError

ENDPOINT = "tcp/192.168.1.20:7447"
"""An example of one, for errors."""
CALLBACK_THREAD = "pyo3-closure"
"""What zenoh's Python package (1.10) calls its threads that run our callbacks."""
JOIN_S = 0.5
"""How long each of them is waited for."""
_NETWORK = re.compile(r"(?:tcp|udp|tls|quic)/[^?#]*?(?::([0-9]{1,5}))?(?:[?#].*)?")
"""An endpoint of these protocols, and its port."""


class Setting(NamedTuple):
    """One value over zenoh's own. `source`: what the user wrote it in, for errors: a key or an option."""

    key: str
    source: str
    value: object


def configured(file: Path | None, source: str, settings: Iterable[Setting]) -> zenoh.Config:
    """Zenoh's configuration: its own file, if there is one, and settings over it.

    Raises ConfigError that begins with the source of what is wrong; `source`: that of `file`.
    """
    try:
        config = zenoh.Config.from_file(str(file)) if file else zenoh.Config()
    except (zenoh.ZError, OSError) as error:
        raise ConfigError(f"{source}: {file}: {error}") from None
    for each in settings:
        if each.key.endswith("/endpoints") and isinstance(each.value, list):
            _check_ports(each.source, each.value)
        try:
            config.insert_json5(each.key, json.dumps(each.value))
        except zenoh.ZError as error:
            what = f"expected endpoints, such as {ENDPOINT}" if each.key.endswith("/endpoints") else error
            raise ConfigError(f"{each.source}: {each.value}: {what}") from None
    return config


def _check_ports(source: str, endpoints: Iterable[str]) -> None:
    """Zenoh takes an endpoint without a port, and tries in vain to connect for ever. Raises ConfigError."""
    for each in endpoints:
        if (found := _NETWORK.fullmatch(each)) and not (found[1] and int(found[1]) < 2**16):
            raise ConfigError(f"{source}: {each}: expected HOST:PORT in it, as in {ENDPOINT}")


def join_callbacks(before: set[threading.Thread]) -> None:
    """Wait for zenoh's threads that are not of `before`: one alive at the interpreter's end aborts the process."""
    for thread in set(threading.enumerate()) - before:
        if CALLBACK_THREAD in thread.name:
            thread.join(JOIN_S)
