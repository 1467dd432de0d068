"""Evidence for safety: what the thrusters do whatever happens."""

from __future__ import annotations

import importlib
from collections.abc import Iterator

from tests.evidence.line import Line


def kill(full: bool) -> Iterator[Line]:
    """Kill matrix: real processes, one fault at a time; --full: all rows"""
    yield from _lines("kill", full)


def boot(full: bool) -> Iterator[Line]:
    """Boot order: simulator, companion, UWB tag and shore in ten orders"""
    yield from _lines("boot", full)


def faults(full: bool) -> Iterator[Line]:
    """Faults: chains of random faults"""
    yield from _lines("faults", full)


def fuzz(full: bool) -> Iterator[Line]:
    """Fuzz: what comes in over the wires"""
    yield from _lines("fuzz", full)


def soak(full: bool) -> Iterator[Line]:
    """Soak: long runs"""
    yield from _lines("soak", full)


def _lines(part: str, full: bool) -> Iterator[Line]:
    yield from importlib.import_module(f"tests.evidence.safe.{part}").lines(full)


PARTS = (kill, boot, faults, fuzz, soak)
