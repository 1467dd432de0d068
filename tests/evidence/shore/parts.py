"""Evidence for shore: see the boat, live and afterwards."""

from __future__ import annotations

import importlib
from collections.abc import Iterator

from tests.evidence.line import Line


def boat(full: bool) -> Iterator[Line]:
    """Boat: what telemetry costs it, and a router that stands still while it is driven from shore"""
    yield from _parts("boat", full)


def network(full: bool) -> Iterator[Line]:
    """Network: shore stopped, killed, absent; loss, delay, an outage; --full: eight rounds"""
    yield from _lines("network", full)


def starts(full: bool) -> Iterator[Line]:
    """Starts: router, console and boat in every order, and the router anew; --full: fifty times"""
    yield from _lines("starts", full)


def security(full: bool) -> Iterator[Line]:
    """Security: who may not, cannot; what strangers send moves and stops nothing; --full: 30 000 fuzzed orders"""
    yield from _lines("security", full)


def console(full: bool) -> Iterator[Line]:
    """Console: headless Chromium against a running demo, and fifty boats"""
    yield from _parts("console", full)


def _lines(part: str, full: bool) -> Iterator[Line]:
    yield from importlib.import_module(f"tests.evidence.shore.{part}").lines(full)


def _parts(part: str, full: bool) -> Iterator[Line]:
    for each in importlib.import_module(f"tests.evidence.shore.{part}").PARTS:
        print(f" {each.__doc__.strip()}", flush=True)
        yield from each(full)


PARTS = (boat, network, starts, security, console)
