"""The physics side of ArduPilot's JSON interface, in lockstep with one firmware. Sans-I/O.

    receive(data, sender, now_ns) -> Answer | None      a datagram has come; what to send back, and the tag's bytes
    watch(now_ns)                                       a look at the clock: is the firmware silent, slow, fast?
    take_news() -> [str]                                what a person should be told since the last call

A state leaves only as the answer to a servo packet; without one the world stands still.

| frame count, against the last one | what it means | what happens |
|---|---|---|
| one more | the firmware took the last state | one step of 1 / frame rate |
| the same | the answer was lost: the firmware asks again after 1 s | the same answer, no step |
| the same, within `REPEAT_NS` | it had asked again before we came to answer | nothing |
| several more | frames were lost on the way | counted, one step |
| less | the firmware has started again, from 0 | the boat is put back to its start, one step |

Why nothing: one answer too many stays in the firmware's queue, and it would drive by states one frame old from then
on; after a minute in which this program was stopped, by sixty.

The first packet may have any count: the simulator may have been started again. The firmware then sees the time go
back, takes that for a reset of the physics and goes on.

One firmware at a time: another sender is taken only after `SILENT_NS` without the present one. That is longer than
the second after which a waiting firmware asks again, so a live one is never displaced.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from typing import Protocol

from sim.world.sitl.protocol import NotServos, PhysicsState, ServoPacket, decode, encode

SILENT_NS = 2_000_000_000
PACE_NS = 5_000_000_000
"""Over this long simulated and real time are compared; assumed."""
PACE_BAND = (0.9, 1.1)
"""Simulated per real seconds at which the companion, whose clock is real, may drive; assumed."""
REPEAT_NS = 500_000_000
"""Half of the second that the firmware waits: a repeat that comes earlier had been waiting in a queue."""
LONGEST_FRAME_NS = 50_000_000
"""Longest step: the firmware's clock stands still over a difference of 0.1 s or more."""
_S = 1_000_000_000


class Moves(Protocol):
    """What the backend asks of a world (`SitlPhysics`)."""

    def advance(self, outputs_us: tuple[int, ...], frame_ns: int) -> tuple[PhysicsState, bytes]:
        """One frame on with these outputs: the state then, and the UWB tag's bytes."""
        ...

    def restart(self) -> None:
        """Back to the start."""
        ...


@dataclass(frozen=True)
class Answer:
    """What follows from a servo packet. `stepped`: the world has moved on; `uwb`: what the tag has sent meanwhile."""

    data: bytes
    uwb: bytes = b""
    stepped: bool = False


@dataclass
class BackendCounters:
    """Since the start of the simulator. `missed`: frames that never came; `strangers`: datagrams of other senders."""

    steps: int = 0
    repeated: int = 0
    missed: int = 0
    restarts: int = 0
    strangers: int = 0
    garbage: int = 0


class JsonBackend:
    """One world for one firmware."""

    def __init__(self, physics: Moves):
        self._physics = physics
        self.counters = BackendCounters()
        self._news: list[str] = []
        self._sender: Hashable = None
        self._heard_ns = 0
        self._silent = False
        self._pace = "real"
        self._mark = 0, 0
        self._world_ns = 0
        self._count: int | None = None
        self._answer, self._answered_ns = b"", 0
        self._wrong: set[Hashable] = set()

    def receive(self, data: bytes, sender: Hashable, now_ns: int) -> Answer | None:
        """A datagram has come at `now_ns`. None: nothing to answer."""
        try:
            packet = decode(data)
        except NotServos as error:
            self.counters.garbage += 1
            self._once(("garbage", sender), f"ignored what {sender} sent: {error}")
            return None
        if not self._is_ours(sender, packet, now_ns):
            return None
        return self._follow(packet, now_ns)

    def watch(self, now_ns: int) -> None:
        """Say once that the firmware has fallen silent, and when it leaves or comes back to real time."""
        if self._sender is not None and not self._silent and now_ns - self._heard_ns >= SILENT_NS:
            self._silent = True
            self._news.append(f"firmware silent for {SILENT_NS / _S:.0f} s, the world waits for it")
        if self._sender is not None and not self._silent and now_ns - self._mark[0] >= PACE_NS:
            self._judge((self._world_ns - self._mark[1]) / (now_ns - self._mark[0]))
            self._mark = now_ns, self._world_ns

    def take_news(self) -> list[str]:
        """What has happened since the last call, as texts."""
        news, self._news = self._news, []
        return news

    def _is_ours(self, sender: Hashable, packet: ServoPacket, now_ns: int) -> bool:
        """Whether to listen to this sender; then it has been heard now."""
        gap_ns = now_ns - self._heard_ns
        if self._sender is None or (sender != self._sender and gap_ns >= SILENT_NS):
            rate, outputs = packet.frame_rate_hz, len(packet.pulses_us)
            self._news.append(f"firmware at {sender}: frame {packet.frame_count}, {rate} Hz, {outputs} outputs")
        elif sender != self._sender:
            self.counters.strangers += 1
            wait = f"{SILENT_NS / _S:.0f} s"
            self._once(("stranger", sender), f"firmware at {sender} waits until the first has been silent for {wait}")
            return False
        elif gap_ns >= SILENT_NS:
            self._news.append(f"firmware back after {gap_ns / _S:.1f} s")
        if sender != self._sender or gap_ns >= SILENT_NS:
            self._mark = now_ns, self._world_ns
        self._sender, self._heard_ns, self._silent = sender, now_ns, False
        return True

    def _follow(self, packet: ServoPacket, now_ns: int) -> Answer | None:
        last, count = self._count, packet.frame_count
        if count == last:
            self.counters.repeated += 1
            if now_ns - self._answered_ns < REPEAT_NS:
                return None
            self._answered_ns = now_ns
            return Answer(self._answer)
        if last is not None and count < last:
            self.counters.restarts += 1
            self._news.append(f"firmware started again (frame {count} after {last}): the boat is back at its start")
            self._physics.restart()
        elif last is not None and count > last + 1:
            self.counters.missed += count - last - 1
            self._news.append(f"frames missed: {count - last - 1} (now {count}), {self.counters.missed} in all")
        step_ns = frame_ns(packet.frame_rate_hz)
        state, uwb = self._physics.advance(packet.outputs_us, step_ns)
        self._world_ns += step_ns
        self._count, self._answer, self._answered_ns = count, encode(state), now_ns
        self.counters.steps += 1
        return Answer(self._answer, uwb, stepped=True)

    def _judge(self, pace: float) -> None:
        kind = "slow" if pace < PACE_BAND[0] else "fast" if pace > PACE_BAND[1] else "real"
        if kind != self._pace:
            cure = {
                "slow": "; the companion's clock is real, its estimate will be wrong: free the machine",
                "fast": "; for the companion's sake start the firmware with --speedup 1, or this with --speed 1",
                "real": "",
            }
            self._news.append(f"simulated time runs at {pace:.2f} of real time{cure[kind]}")
        self._pace = kind

    def _once(self, about: Hashable, text: str) -> None:
        if about not in self._wrong:
            self._wrong.add(about)
            self._news.append(text)


def frame_ns(frame_rate_hz: int) -> int:
    """Length of the step that a frame rate asks for, at most `LONGEST_FRAME_NS`.

    Rounded down: the firmware takes its next rate from 1 / step and cuts off the fraction, so that a step too long by
    a nanosecond would keep it below the rate that it is after (source).
    """
    return min(_S // frame_rate_hz, LONGEST_FRAME_NS) if frame_rate_hz else LONGEST_FRAME_NS
