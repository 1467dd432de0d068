"""The firmware's side of ArduPilot's JSON interface, as a process of its own that needs nothing of ours.

    python json_firmware.py PORT --program '[[2, [1500, 1500, 1500, 1500]], [10, [1700, 1700, 1700, 1700]]]'

sends servo packets to PORT and takes states, in lockstep, until its clock has reached the end of the program (rows of
[until s, pulses us]); then it prints what it has seen as JSON. It does as the firmware does, in its own words:

- it asks again with the same frame count when no answer has come for about a second (observed);
- it takes what stands between the last two line feeds received, and searches that text: a section's name, from there
  a key's name, and reads the number two characters after it (SIM_JSON.cpp);
- its clock goes on by the difference of timestamps where that is positive and below 0.1 s; a timestamp that goes back
  is a reset of the physics (observed);
- the frame rate that it asks for is 1 / the last difference, moved by at most 1 Hz towards its loop rate, the fraction
  cut off (SIM_JSON.cpp).
"""

from __future__ import annotations

import argparse
import json
import re
import socket
import struct
import time
from dataclasses import dataclass, field

NUMBER = r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)"
VECTOR = [re.compile(r"\[" + r",".join([NUMBER] * n)) for n in range(5)]
SCALAR = re.compile(NUMBER)
KEYS = [  # section, key, numbers, required
    ("", "timestamp", 1, True),
    ("imu", "gyro", 3, True),
    ("imu", "accel_body", 3, True),
    ("", "position", 3, True),
    ("", "attitude", 3, False),
    ("", "quaternion", 4, False),
    ("", "velocity", 3, True),
    *(("", f"rng_{i}", 1, False) for i in range(1, 7)),
    ("", "velocity_wind", 3, False),
    ("windvane", "direction", 1, False),
    ("windvane", "speed", 1, False),
    ("", "airspeed", 1, False),
    ("", "no_time_sync", 1, False),
    *(("rc", f"rc_{i}", 1, False) for i in range(1, 11)),
    ("battery", "voltage", 1, False),
    ("battery", "current", 1, False),
]


def parse(text):
    """What the firmware finds in a state: {key: number or list}; None where it would refuse the state."""
    found = {}
    for section, key, numbers, required in KEYS:
        at = text.find(section)
        at = text.find(key, at + len(section) + 1) if at >= 0 else at
        if at < 0:
            if required:
                return None
            continue
        match = (VECTOR[numbers] if numbers > 1 else SCALAR).match(text, at + len(key) + 2)
        if not match:
            return None
        values = [float(number) for number in match.groups()]
        found[key] = values if numbers > 1 else values[0]
    return found if "attitude" in found or "quaternion" in found else None


FLT_EPSILON = 1.1920929e-07


@dataclass
class Seen:
    """`trace`: states, one each 0.1 s of the firmware's clock; `rates`: frame rates asked for, each once, in order."""

    frames: int = 0
    resends: int = 0
    resets: int = 0
    refused_steps: int = 0
    refused_states: int = 0
    clock_s: float = 0.0
    rates: list[int] = field(default_factory=list)
    trace: list[dict] = field(default_factory=list)


class Firmware:
    """One instance that has just started. `lose(n)`: whether the n-th datagram, counted both ways, is lost."""

    def __init__(self, port, *, rate_hz=1200.0, loop_rate_hz=200.0, outputs=16, resend_s=1.0, lose=lambda n: False,
                 frame=0):  # fmt: skip
        self.seen, self.frame, self.state = Seen(), frame, None
        self.rate_hz, self._loop_rate_hz = rate_hz, loop_rate_hz
        self._outputs, self._resend_s, self._lose = outputs, resend_s, lose
        self._datagrams, self._buffer, self._last_s = 0, b"", 0.0
        self._address = ("127.0.0.1", port)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.settimeout(min(0.1, resend_s))

    def close(self):
        self._socket.close()

    def exchange(self, pulses_us):
        """One frame: pulses out, a state in. Waits as long as it takes."""
        rate = int(self.rate_hz)
        if rate not in self.seen.rates[-1:]:
            self.seen.rates.append(rate)
        self.send(pulses_us)
        sent_s = time.monotonic()
        while True:
            state = self._receive()
            if state is not None:
                return self._take(state)
            if time.monotonic() - sent_s > self._resend_s:
                self.seen.resends += 1
                self.send(pulses_us)
                sent_s = time.monotonic()

    def send(self, pulses_us):
        magic = {16: 18458, 32: 29569}[self._outputs]
        pulses = [*pulses_us, *[0] * (self._outputs - len(pulses_us))]
        packet = struct.pack(f"<HHI{self._outputs}H", magic, int(self.rate_hz), self.frame, *pulses)
        if not self._is_lost():
            self._socket.sendto(packet, self._address)

    def _receive(self):
        try:
            data = self._socket.recv(65000)
        except (TimeoutError, ConnectionRefusedError):
            return None
        if self._is_lost():
            return None
        self._buffer += data
        rows = self._buffer.split(b"\n")
        if len(rows) < 3:
            return None
        self._buffer = b"\n" + rows[-1]
        state = parse(rows[-2].decode("ascii"))
        self.seen.refused_states += state is None
        return state

    def _is_lost(self):
        self._datagrams += 1
        return self._lose(self._datagrams)

    def _take(self, state):
        step_s = state["timestamp"] - self._last_s
        self._last_s = state["timestamp"]
        if step_s < 0:
            self.seen.resets += 1
        elif not FLT_EPSILON < step_s < 0.1:  # the firmware's own is_positive()
            self.seen.refused_steps += 1
        else:
            self.seen.clock_s += step_s
            self.rate_hz = single(1 / step_s)
        self.rate_hz = min(max(self._loop_rate_hz, self.rate_hz - 1), self.rate_hz + 1)
        self.frame += 1
        self.seen.frames += 1
        self.state = state
        if not self.seen.trace or self.seen.clock_s - self.seen.trace[-1]["clock_s"] >= 0.1:
            self.seen.trace.append({"clock_s": self.seen.clock_s, **state})
        return state


def single(value):
    """Rounded to single precision."""
    return struct.unpack("<f", struct.pack("<f", value))[0]


def fly(firmware, program, pause=None):
    """Drive the program; `pause` = (at [s], for [s] of real time), once."""
    for until_s, pulses in program:
        while firmware.seen.clock_s < until_s:
            if pause and firmware.seen.clock_s >= pause[0]:
                time.sleep(pause[1])
                pause = None
            firmware.exchange(pulses)


def main():
    p = argparse.ArgumentParser()
    p.add_argument("port", type=int)
    p.add_argument("--program", type=json.loads, required=True)
    p.add_argument("--rate", type=float, default=1200.0)
    p.add_argument("--loop-rate", type=float, default=200.0)
    p.add_argument("--outputs", type=int, default=16)
    p.add_argument("--resend", type=float, default=1.0)
    p.add_argument("--lose-every", type=int, help="datagram, counted both ways")
    p.add_argument("--pause", type=float, nargs=2, metavar=("AT_S", "FOR_S"))
    args = p.parse_args()
    firmware = Firmware(
        args.port,
        rate_hz=args.rate,
        loop_rate_hz=args.loop_rate,
        outputs=args.outputs,
        resend_s=args.resend,
        lose=lambda n: bool(args.lose_every) and n % args.lose_every == 0,
    )
    fly(firmware, args.program, args.pause)
    print(json.dumps({**vars(firmware.seen), "state": firmware.state}), flush=True)


if __name__ == "__main__":
    main()
