"""The signing key's file and the file that remembers the last time stamp: read with care, reported without the key.

A key file holds 32 raw bytes, 64 hexadecimal digits, or a passphrase of which the SHA-256 is the key, as Mission
Planner, MAVProxy and QGroundControl make it. 32 bytes that are all printable are a passphrase.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import os
import re
import stat
from collections.abc import Callable
from pathlib import Path

from companion.boat.clock import Clock
from companion.core.configuration.tables import ConfigError
from companion.core.messages import Alert
from drivers.mavlink.signing import KEY_BYTES, Signing, SigningKey

MAX_FILE_BYTES = 4096
STAMP_FILE = "mavlink-signing-timestamp"
KEEP_NS = 10_000_000_000
"""Between writes of the time stamp: what a crash forgets, the autopilot's next message teaches (assumed)."""
_HEX = re.compile(r"[0-9a-fA-F]+")
_AROUND = re.compile(r"[\s\"':,-]")
_HEX_DIGITS, _LIKE_HEX = 2 * KEY_BYTES, 48


def load_key(path: Path, *, where: str) -> SigningKey:
    """The key in `path`. Raises ConfigError that begins with `where` (file and key of the run file)."""
    secret = load_secret(path, where=where)
    try:
        return SigningKey(secret)
    except ValueError as error:
        raise ConfigError(f"{where}: {path}: {error}") from None


def load_secret(path: Path, *, where: str) -> bytes:
    """The 32 bytes that the file at `path` means, for a key that is not MAVLink's. Raises like `load_key`."""
    if _HEX.fullmatch(path.name) and len(path.name) >= _LIKE_HEX:
        raise ConfigError(f"{where}: this is a key, not the name of a file: write it into a file and name that")
    try:
        with path.open("rb") as file:
            status = os.fstat(file.fileno())
            if not stat.S_ISREG(status.st_mode):
                raise ConfigError(f"{where}: {path}: expected a file")
            if status.st_mode & 0o077:
                raise ConfigError(f"{where}: {path}: others than its owner may read or change it: chmod 600 {path}")
            content = file.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        raise ConfigError(f"{where}: {path}: {error.strerror}") from None
    try:
        return _secret(content)
    except ValueError as error:
        raise ConfigError(f"{where}: {path}: {error}") from None


def _secret(content: bytes) -> bytes:
    """The 32 bytes that a key file means. ValueError, without any of its content."""
    try:
        text = content.decode().removesuffix("\n").removesuffix("\r")
    except UnicodeDecodeError:
        text = ""
    printable = bool(text) and text.isprintable()
    if len(content) == KEY_BYTES and not printable:
        return content
    if not printable or len(content) > MAX_FILE_BYTES:
        raise ValueError(
            f"expected {KEY_BYTES} raw bytes, {_HEX_DIGITS} hexadecimal digits or a passphrase on one line"
        )
    if _HEX.fullmatch(text) and len(text) >= _LIKE_HEX:
        if len(text) != _HEX_DIGITS:
            raise ValueError(f"{len(text)} hexadecimal digits, expected {_HEX_DIGITS}")
        return bytes.fromhex(text)
    bare = _AROUND.sub("", text).removeprefix("0x")
    if _HEX.fullmatch(bare) and len(bare) == _HEX_DIGITS:  # as a passphrase it would be another key, in silence
        raise ValueError(f"{_HEX_DIGITS} hexadecimal digits with more around or between them: leave only the digits")
    return hashlib.sha256(text.encode()).digest()


def load_timestamp(path: Path) -> int:
    """The time stamp that `store_timestamp` wrote; 0 without a readable file."""
    try:
        return int(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return 0


def store_timestamp(path: Path, timestamp: int) -> None:
    """Replace the file whole. Waits for the disk; raises OSError."""
    new = path.with_suffix(".new")
    new.write_text(f"{timestamp}\n", encoding="utf-8")
    new.replace(path)


async def keep_timestamp(path: Path, signing: Signing, clock: Clock, tell: Callable[[Alert], None]) -> None:
    """Store the time stamp every 10 s, in a thread, until cancelled; one alert of a disk that refuses."""
    reported = False
    try:
        while True:
            try:
                await asyncio.to_thread(store_timestamp, path, signing.timestamp)
            except OSError as error:
                text = f"{path}: {error.strerror}: after a restart with a wrong clock old signatures would be believed"
                if not reported:
                    tell(Alert(t_ns=clock.now_ns(), level="warning", text=text))
                reported = True
            await clock.sleep_until(clock.now_ns() + KEEP_NS)
    finally:
        with contextlib.suppress(OSError):
            store_timestamp(path, signing.timestamp)
