"""Kinds of values on the command line: each says what was found, and which range was expected."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Sequence
from typing import Any

LAST_PORT = 65535
Kind = Callable[[str], Any]
DIGITS = 18
"""More digits than any whole number here needs; Python itself refuses to read 4300."""


def number(low: float, high: float, what: str = "a number") -> Callable[[str], float]:
    """A finite number from `low` to `high`, both included. `what` it is, with its unit."""

    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text!r}: expected {what}, {low:g} to {high:g}")
        return value

    return read


def whole(low: int, high: int, what: str = "a whole number") -> Callable[[str], int]:
    """A whole number from `low` (0 at least) to `high`, both included."""

    def read(text: str) -> int:
        value = int(text) if text.isascii() and text.isdigit() and len(text) <= DIGITS else -1
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text!r}: expected {what}, {low} to {high}")
        return value

    return read


def seconds(low: float, high: float) -> Callable[[str], float]:
    """A time [s]."""
    return number(low, high, "a number of seconds")


share = number(0.0, 1.0, "a share")
seed = whole(0, 2**32 - 1, "a seed, a whole number")
port = whole(0, LAST_PORT, "a port")
angle_deg = number(-360.0, 360.0, "an angle [deg]")


def address(text: str) -> tuple[str, int]:
    """HOST:PORT."""
    host, colon, digits = text.rpartition(":")
    try:
        return host, whole(1, LAST_PORT)(digits if colon and host else "")
    except argparse.ArgumentTypeError:
        raise argparse.ArgumentTypeError(f"{text!r}: expected HOST:PORT, the port 1 to {LAST_PORT}") from None


class Each(argparse.Action):
    """An option with several values, each of a kind of its own: `action=Each, kinds=(number(0, 60), angle_deg)`."""

    def __init__(self, option_strings: Sequence[str], dest: str, kinds: Sequence[Kind], **more: Any) -> None:
        super().__init__(option_strings, dest, nargs=len(kinds), **more)
        self._kinds = kinds

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, option_string: Any = None
    ) -> None:
        """Check and keep the values."""
        try:
            found = tuple(kind(text) for kind, text in zip(self._kinds, values, strict=True))
        except argparse.ArgumentTypeError as error:
            raise argparse.ArgumentError(self, str(error)) from None
        setattr(namespace, self.dest, found)
