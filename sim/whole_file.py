"""Files that are there whole or not at all."""

from __future__ import annotations

import errno
import os
from collections.abc import Mapping
from pathlib import Path


def write_whole(path: Path, data: bytes) -> None:
    """The file as a whole or not at all, also when the power fails. Raises OSError naming it, also of a full disk."""
    part = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with part.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, path)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None
    finally:
        part.unlink(missing_ok=True)


def write_all_or_none(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write `files`, data by name, into `folder`: all of them or, where that ends early (a full disk, Ctrl-C), none, so
    that the same command can be given again. Raises OSError naming the file, also where one is there already.
    """
    for path in (folder / name for name in files):
        if path.exists():
            raise FileExistsError(errno.EEXIST, "exists by now", str(path))
    try:
        for name, data in files.items():
            write_whole(folder / name, data)
    except BaseException:
        for name in files:
            (folder / name).unlink(missing_ok=True)
        raise
