"""Files that a command reads, looked at while the command line is parsed: there, readable, of the right kind.

A file that is of another kind for certain is named as what it is; what only its reader can know, its reader says.
"""

from __future__ import annotations

import argparse
import stat
from collections.abc import Callable, Collection
from pathlib import Path

from companion.core.configuration import file_kinds as kinds
from companion.core.configuration.tables import TEXT, ConfigError
from companion.logs.part_files import log_parts

OTHERS = (*kinds.EXAMPLES, "a picture", "a PDF file", "a ZIP archive", "a program", "an HTML page", "a JSON file")
"""What no log is."""


def head_of(path: Path) -> bytes:
    """The first bytes of a regular file. Raises ArgumentTypeError."""
    try:
        if path.is_dir():
            raise argparse.ArgumentTypeError(f"{path}: is a folder, not a file")
        if not stat.S_ISREG(path.stat().st_mode):
            raise argparse.ArgumentTypeError(f"{path}: is no regular file")
        with path.open("rb") as file:
            return file.read(kinds.HEAD_BYTES)
    except (OSError, ValueError) as error:  # ValueError: a null byte in the name
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise argparse.ArgumentTypeError(f"{path}: {reason}") from None


def _file(wanted: str, refused: Callable[[str], bool], example: str = "") -> Callable[[str], Path]:
    """An argument that is `wanted`; `refused`: kinds of file that it is not."""

    def read(text: str) -> Path:
        path = Path(text)
        head = head_of(path)
        if not head and len(log_parts(path)) == 1:  # a power cut may leave the first part of a log empty
            raise argparse.ArgumentTypeError(f"{path}: is empty")
        kind = kinds.kind_of_file(head)
        if kind and refused(kind):
            hint = f", for example {example}" if example else ""
            raise argparse.ArgumentTypeError(f"{path}: is {kind}; expected {wanted}{hint}")
        return path

    return read


def _ours(kind: str, *also: str) -> Callable[[str], Path]:
    return _file(kind, lambda found: found not in (kind, *also), kinds.EXAMPLES[kind])


def _log(wanted: str, other_than: Collection[str]) -> Callable[[str], Path]:
    return _file(wanted, lambda found: found in other_than)


run_file = _ours(kinds.RUN)
vessel_file = _ours(kinds.VESSEL)
site_file = _ours(kinds.SITE)
mission_file = _ours(kinds.MISSION, "a GeoJSON file")
excitation_file = _ours(kinds.EXCITATION)
campaign_file = _ours(kinds.CAMPAIGN)
any_log = _log("a log (.mcap, .csv, .parquet, .bin, .tlog)", OTHERS)
aritra_log = _log("a log of `aritra run` (.mcap)", (*OTHERS, "an ArduPilot log (.bin)", "a telemetry log (.tlog)",
                                                   "a Parquet table", "a compressed file"))  # fmt: skip
truth_log = _log("the simulator's own log (truth.mcap)", (*OTHERS, "an ArduPilot log (.bin)", "a Parquet table",
                                                          "a telemetry log (.tlog)", "a compressed file"))  # fmt: skip


log_beside = _file("a UWB log (.mcap, or lines of text)", lambda found: found in (*OTHERS, kinds.BINARY, kinds.UTF16))

zenoh_file = _file("zenoh's own file (.json5)", lambda found: found != "a JSON file", "deploy/zenoh/shore.json5")


def python_file(text: str) -> Path:
    """A Python source."""
    path = Path(text)
    head_of(path)
    if path.suffix != ".py":
        raise argparse.ArgumentTypeError(f"{path}: expected Python source (.py)")
    return path


def text_of(path: Path) -> str:
    """Text of a UTF-8 file. Raises ConfigError where it is not one, OSError."""
    try:
        return path.read_text(encoding=TEXT)
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: is not UTF-8 text") from None
