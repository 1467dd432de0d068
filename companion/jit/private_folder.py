"""A folder of files that nobody but this user (or root) can have written.

What lies in a cache of machine code is run. So before a file is read, folder and file must belong to this user or to
root, and nobody else may be able to write to them; both are looked at through the open descriptor, so that nothing can
be exchanged between the look and the reading. Where the folder lies does not matter then: whoever can rename it can
only put another one in its place that is not his.
"""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
import stat
from collections.abc import Iterator
from pathlib import Path

OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH


class NotPrivate(Exception):
    """Somebody else can have written this; the text names the path, what was found, and what to do."""


class PrivateFolder:
    """One folder. Every method raises OSError as the disk does, and NotPrivate where the folder is not private."""

    def __init__(self, path: Path):
        self.path = path

    def read(self, name: str) -> bytes:
        """Content of a file. Raises NotPrivate where the file itself is not, or is a symbolic link."""
        with self._open() as folder:
            try:
                file = os.open(name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, dir_fd=folder)
            except OSError as error:
                if error.errno == errno.ELOOP:
                    raise NotPrivate(f"{self.path / name}: is a symbolic link: delete it") from error
                raise
            with open(file, "rb") as stream:
                _demand_private(os.fstat(file), self.path / name)
                return stream.read()

    def write(self, name: str, data: bytes) -> None:
        """Write a file whole or not at all; the folder is made, for this user alone, where it is missing."""
        self.path.mkdir(parents=True, exist_ok=True, mode=0o700)
        passing = f".{name}.{secrets.token_hex(8)}"
        with self._open() as folder:
            file = os.open(passing, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600, dir_fd=folder)
            try:
                with open(file, "wb") as stream:
                    stream.write(data)
                os.rename(passing, name, src_dir_fd=folder, dst_dir_fd=folder)
            except OSError:
                with contextlib.suppress(OSError):
                    os.unlink(passing, dir_fd=folder)
                raise

    def demand_private(self) -> None:
        """Look at the folder alone."""
        with self._open():
            pass

    @contextlib.contextmanager
    def _open(self) -> Iterator[int]:
        folder = os.open(self.path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            _demand_private(os.fstat(folder), self.path)
            yield folder
        finally:
            os.close(folder)


def _demand_private(found: os.stat_result, path: Path) -> None:
    """Raises NotPrivate."""
    if found.st_uid not in (0, os.geteuid()):
        raise NotPrivate(f"{path}: belongs to user {found.st_uid}, not to {os.geteuid()} who runs this: delete it")
    if not (stat.S_ISDIR(found.st_mode) or stat.S_ISREG(found.st_mode)):
        raise NotPrivate(f"{path}: is neither folder nor file: delete it")
    if found.st_mode & OTHERS_WRITE:
        mode = stat.S_IMODE(found.st_mode)
        raise NotPrivate(f"{path}: others may write to it (mode {mode:o}): delete it, or chmod go-w")
