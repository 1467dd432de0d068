"""Wires that can go wrong, between `aritra run` and `aritra sim`: MAVLink over UDP, UWB over a pseudo terminal.

    wire = Wire(companion_port)      the simulator sends to `wire.port`, the companion listens on `companion_port`
    wire.fault = garbled(seed)       from now on; `clean` ends it
    wire.sent                        every override that the companion sent: (arrival [ns], 18 channels)

A fault maps a datagram to what arrives instead: pairs of a delay [s] and bytes.
"""

from __future__ import annotations

import contextlib
import heapq
import itertools
import os
import random
import select
import socket
import termios
import threading
import time
import tty
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Literal

from pymavlink.dialects.v20 import ardupilotmega as dialect

Way = Literal["to_autopilot", "to_companion"]
Arrivals = Iterable[tuple[float, bytes]]
Fault = Callable[[Way, bytes], Arrivals]
POLL_S = 0.005


def clean(way: Way, data: bytes) -> Arrivals:
    """As it was."""
    return ((0.0, data),)


def silent(*ways: Way) -> Fault:
    """Nothing passes these ways; without any: neither way."""
    return lambda way, data: () if way in (ways or ("to_autopilot", "to_companion")) else clean(way, data)


def garbled(seed: int, per_byte: float = 0.01) -> Fault:
    """Each byte is another one with this chance: about every second frame is broken at 0.01."""
    rng = random.Random(seed)

    def fault(way: Way, data: bytes) -> Arrivals:
        return ((0.0, bytes(rng.randrange(256) if rng.random() < per_byte else byte for byte in data)),)

    return fault


def duplicated(way: Way, data: bytes) -> Arrivals:
    """Twice, the second time 30 ms later."""
    return (0.0, data), (0.03, data)


def reordered(seed: int, spread_s: float = 0.25) -> Fault:
    """Each datagram is late by another time, up to `spread_s`: newer ones overtake older ones."""
    rng = random.Random(seed)
    return lambda way, data: ((rng.uniform(0, spread_s), data),)


def delayed(seconds: float) -> Fault:
    """All late by this."""
    return lambda way, data: ((seconds, data),)


def attitude_not_a_number() -> Fault:
    """Every ATTITUDE says not-a-number six times, with a right checksum; all else passes."""
    parser, mav, nan = dialect.MAVLink(None), dialect.MAVLink(None, srcSystem=1, srcComponent=1), float("nan")
    parser.robust_parsing = True

    def fault(way: Way, data: bytes) -> Arrivals:
        if way == "to_autopilot":
            return clean(way, data)
        frames = []
        for message in parser.parse_buffer(data) or ():
            frame = message.get_msgbuf()
            if message.get_type() == "ATTITUDE":
                mav.seq = message.get_seq()
                frame = dialect.MAVLink_attitude_message(message.time_boot_ms, *[nan] * 6).pack(mav)
            frames.append(bytes(frame))
        return ((0.0, b"".join(frames)),)

    return fault


class Wire:
    """The MAVLink wire. `companion_port`: where the companion listens."""

    def __init__(self, companion_port: int):
        self.fault: Fault = clean
        self.sent: list[tuple[int, tuple[int, ...]]] = []
        self._to_sim = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._to_sim.bind(("127.0.0.1", 0))
        self._to_companion = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._to_companion.bind(("127.0.0.1", 0))
        self._companion = ("127.0.0.1", companion_port)
        self._sim: Any = None
        self._parser = dialect.MAVLink(None)
        self._parser.robust_parsing = True
        self._under_way: list[tuple[float, int, Way, bytes]] = []
        self._number = itertools.count()
        self._ended = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    @property
    def port(self) -> int:
        """Where the simulator should send."""
        return self._to_sim.getsockname()[1]

    def close(self) -> None:
        """End it."""
        self._ended = True
        self._thread.join(5)
        self._to_sim.close()
        self._to_companion.close()

    def _run(self) -> None:
        while not self._ended:
            ready, _, _ = select.select([self._to_sim, self._to_companion], [], [], POLL_S)
            for each in ready:
                with contextlib.suppress(OSError):
                    data, address = each.recvfrom(65536)
                    if each is self._to_sim:
                        self._sim = address
                        self._take("to_companion", data)
                    else:
                        self._note(data)
                        self._take("to_autopilot", data)
            while self._under_way and self._under_way[0][0] <= time.monotonic():
                _, _, way, data = heapq.heappop(self._under_way)
                self._hand_on(way, data)

    def _take(self, way: Way, data: bytes) -> None:
        for delay_s, arrives in self.fault(way, data):
            if delay_s:
                heapq.heappush(self._under_way, (time.monotonic() + delay_s, next(self._number), way, arrives))
            else:
                self._hand_on(way, arrives)

    def _hand_on(self, way: Way, data: bytes) -> None:
        with contextlib.suppress(OSError):
            if way == "to_companion":
                self._to_companion.sendto(data, self._companion)
            elif self._sim:
                self._to_sim.sendto(data, self._sim)

    def _note(self, data: bytes) -> None:
        now_ns = time.monotonic_ns()
        for message in self._parser.parse_buffer(data) or ():
            if message.get_type() == "RC_CHANNELS_OVERRIDE":
                channels = tuple(getattr(message, f"chan{n}_raw") for n in range(1, 19))
                self.sent.append((now_ns, channels))


class TagWire:
    """The UWB wire: the simulator's terminal `source` appears again as `path`, with `fault` between.

    Before the source is there, nothing comes. `fault` maps bytes of the tag to what arrives.
    """

    def __init__(self, source: Path, path: Path):
        self.fault: Callable[[bytes], Arrivals] = lambda data: ((0.0, data),)
        self._source, self._path = source, path
        self._master, slave = os.openpty()
        tty.setraw(slave)
        self._slave = slave  # kept open: a companion that closes the port does not end the line
        path.symlink_to(os.ttyname(slave))
        self._tag: int | None = None
        self._under_way: list[tuple[float, int, bytes]] = []
        self._number = itertools.count()
        self._ended = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Unplug it."""
        self._ended = True
        self._thread.join(5)
        self._path.unlink(missing_ok=True)
        for each in (self._master, self._slave, self._tag):
            if each is not None:
                os.close(each)

    def _run(self) -> None:
        while not self._ended:
            if self._tag is None:
                self._open()
            watched = [self._master] + ([self._tag] if self._tag is not None else [])
            for each in select.select(watched, [], [], POLL_S)[0]:
                with contextlib.suppress(OSError):
                    data = os.read(each, 4096)
                    if each == self._tag:
                        self._arrive(data)
                    elif self._tag is not None:
                        os.write(self._tag, data)
            while self._under_way and self._under_way[0][0] <= time.monotonic():
                os.write(self._master, heapq.heappop(self._under_way)[2])

    def _open(self) -> None:
        with contextlib.suppress(OSError, termios.error):
            tag = os.open(self._source, os.O_RDWR | os.O_NOCTTY)
            tty.setraw(tag)
            self._tag = tag

    def _arrive(self, data: bytes) -> None:
        for delay_s, arrives in self.fault(data):
            heapq.heappush(self._under_way, (time.monotonic() + delay_s, next(self._number), arrives))


def babble(seed: int) -> Callable[[bytes], Arrivals]:
    """Random bytes in place of what came."""
    rng = random.Random(seed)
    return lambda data: ((0.0, rng.randbytes(len(data))),)


def held_back(seconds: float) -> Callable[[bytes], Arrivals]:
    """Nothing for so long, then all of it at once, then as before: a tag whose clock stood still."""
    until = time.monotonic() + seconds
    return lambda data: ((max(0.0, until - time.monotonic()), data),)
