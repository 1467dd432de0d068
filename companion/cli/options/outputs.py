"""What a command writes: one spelling of the option, and never over what is there already."""

from __future__ import annotations

import argparse
import contextlib
import os
import shutil
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from companion.core.configuration.tables import ConfigError

PICTURES = (".png", ".pdf", ".svg")
AWAY = "exists already: choose another name, or move it away"


def output(text: str) -> Path:
    """A path to write to, as an argument: a name that can be one."""
    try:
        os.lstat(text)
    except FileNotFoundError:
        if not text:
            raise argparse.ArgumentTypeError("expected a path, found nothing") from None
    except (OSError, ValueError) as error:  # too long, within a file, a null byte
        why = error.strerror if isinstance(error, OSError) else str(error)
        raise argparse.ArgumentTypeError(f"{text}: {why}") from None
    return Path(text)


def picture(text: str) -> Path:
    """A picture to write, of a format that matplotlib has."""
    path = output(text)
    if path.suffix.lower() not in PICTURES:
        raise argparse.ArgumentTypeError(f"{text}: expected the name of a picture, {', '.join(PICTURES)}")
    return path


def add_out(p: Any, metavar: str, help: str, kind: Callable[[str], Path] = output, **more: Any) -> None:
    """Add `--out` with its short form `-o`."""
    p.add_argument("--out", "-o", type=kind, metavar=metavar, help=help, **more)


def new_file(path: Path | None, *, is_folder: bool = False) -> None:
    """Check, before any work is done, that a file (or a folder) is new and can be written. Raises ConfigError."""
    if path is None:
        return
    if os.path.lexists(path):
        raise ConfigError(f"{path}: {'is a folder; name a file in it' if path.is_dir() and not is_folder else AWAY}")
    if not path.parent.is_dir():
        raise ConfigError(f"{path}: there is no folder {path.parent}")
    if not os.access(path.parent, os.W_OK):
        raise ConfigError(f"{path}: nothing may be written to {path.parent}")


def new_in_folder(folder: Path, names: Iterable[str]) -> None:
    """Make a folder where there is none; none of `names` may be in it. Raises ConfigError."""
    for name in names:
        if os.path.lexists(folder / name):
            raise ConfigError(f"{folder / name}: {AWAY}")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise ConfigError(f"{folder}: is a file; name a folder") from None
    except OSError as error:
        raise ConfigError(f"{folder}: {error.strerror}") from None


@contextlib.contextmanager
def making(path: Path, *kinds: type[Exception]) -> Iterator[None]:
    """Around the writing of a new file or folder: where that ends early (a full disk, Ctrl-C), what was begun is
    removed, so that the next attempt has its place. Raises ConfigError that names it, for OSError and `kinds`.
    """
    if os.path.lexists(path):
        raise ConfigError(f"{path}: {AWAY}")
    try:
        yield
    except BaseException as error:
        with contextlib.suppress(OSError):
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        if isinstance(error, OSError):
            raise ConfigError(reason(error, path)) from None
        if isinstance(error, kinds):
            raise ConfigError(f"{path}: {error}") from None
        raise


def reason(error: OSError, path: Path) -> str:
    """What kept `path` from being written, in words."""
    if isinstance(error, FileExistsError):
        return f"{path}: {AWAY}"
    return f"{error.filename or path}: {error.strerror or error}"
