"""MAVLink bytes <-> messages of `companion.core.messages`, for one autopilot. Sans-I/O.

    bytes -> Framer -> (counters, target, clock) -> DECODERS -> messages
    messages -> MavlinkEncoder -> bytes

Never raises on any bytes. Only the target (system, component) is listened to; the first autopilot heartbeat
chooses it where none is given, for good: other autopilots are `strangers`. `t_ns` of a message is the autopilot's own
stamp converted by the clock offset, or the time of arrival where there is no stamp or no offset yet; `t_rx_ns` is the
arrival.

Rates of an Attitude are those of the gyros: the AHRS's own correction (AHRS.omegaI) is taken out. Without a position it
follows the boat's acceleration.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from msgspec.structs import replace

from companion.core.messages import Attitude, ImuSample, Message, ServoOutput, StatusText, TimeSync
from drivers.mavlink.decode import (
    DECODERS,
    FIX,
    FIX_STAMPS,
    STAMPS,
    gyro_drift,
    is_autopilot,
    motor_outputs,
    pulses,
)
from drivers.mavlink.encode import MavlinkEncoder
from drivers.mavlink.framing import Framer
from drivers.mavlink.imu_source import IMU_PREFERENCE, ImuSelector
from drivers.mavlink.signing import Signing, is_signed
from drivers.mavlink.statustext import ChunkJoiner, Text
from drivers.mavlink.timesync import MAX_AGE_NS, SENSED_AGE_NS, ClockOffset

AUTOPILOT_COMPONENT = 1
"""MAV_COMP_ID_AUTOPILOT1."""
SENSED = frozenset({"ATTITUDE", *IMU_PREFERENCE, *FIX_STAMPS})
"""Of these a stamp that repeats itself tells nothing new: a frozen stream would count as live. ArduPilot sends a
receiver's last fix for 4 s after it was unplugged (source: AP_GPS), and each as often as it is asked for one.
"""
_SERVO_PORTS = 2


@dataclass(slots=True)
class MavlinkCounters:
    """What came in, by message type. Faults on the wire are counted by the framer: see `MavlinkCodec.framer`.

    received  every frame with a good checksum, from anyone
    ignored   those of them that are not from the target, or are answers to someone else
    invalid   those with NaN or infinity in a field that is used, or an impossible number
    repeated  those of a sensor that carry the stamp of the one before: told once, a frozen sensor is a silent one
    lost      gaps in the sequence numbers, per (system, component)
    """

    received: Counter[str] = field(default_factory=Counter)
    ignored: Counter[str] = field(default_factory=Counter)
    invalid: Counter[str] = field(default_factory=Counter)
    repeated: Counter[str] = field(default_factory=Counter)
    lost: Counter[tuple[int, int]] = field(default_factory=Counter)

    def from_target(self, name: str) -> int:
        """Frames of type `name` from the target."""
        return self.received[name] - self.ignored[name]


class MavlinkCodec:
    """Codec of the companion `system`/`component` towards one autopilot.

    `target_system`: None takes the first autopilot heard. `imu_preference`: see `ImuSelector`.
    `signing`: signs what the encoder makes, and what it does not accept is as if it had never come.
    Public parts: `counters`, `framer` (wire faults), `clock`, `encoder`, `imu`, `target`, `signing`.
    `signed`: the target signs what it says; `named`: the target was given; `strangers`: systems of other autopilots;
    `understood`: sound frames so far, of anyone, refused ones included.
    """

    def __init__(
        self,
        system: int = 1,
        component: int = 191,
        target_system: int | None = None,
        target_component: int = AUTOPILOT_COMPONENT,
        clock: ClockOffset | None = None,
        imu_preference: Sequence[str] = IMU_PREFERENCE,
        signing: Signing | None = None,
    ) -> None:
        self.counters = MavlinkCounters()
        self.framer = Framer()
        self.clock = clock or ClockOffset()
        self.encoder = MavlinkEncoder(system, component, target_system or 0, target_component, signing)
        self.signing = signing
        self.signed = False
        self.understood = 0
        self.imu = ImuSelector(imu_preference)
        self.target = None if target_system is None else (target_system, target_component)
        self.named = target_system is not None
        self.strangers: set[int] = set()
        self._own = (system, component)
        self._seq: dict[tuple[int, int], int] = {}
        self._texts = ChunkJoiner()
        self._servo_ports: dict[int, tuple[int, ...]] = {}
        self._stamps: dict[str, int] = {}
        self._gyro_drift_rad_s = 0.0, 0.0, 0.0

    def feed(self, data: bytes, t_ns: int) -> list[Message]:
        """Messages that `data`, arrived at `t_ns` [ns], completes. b"" only lets waiting texts expire."""
        out: list[Message] = _texts(self._texts.expire(t_ns), t_ns)
        for m in self.framer.feed(data, t_ns):
            self.understood += 1
            if self.signing and not self.signing.accepts(m):
                continue
            self._count(m)
            if not self._from_target(m):
                self.counters.ignored[m.get_type()] += 1
                continue
            self.signed = self.signed or is_signed(m)
            for message in self._decode(m, t_ns):
                if _finite(message):
                    out.append(message)
                else:
                    self.counters.invalid[m.get_type()] += 1
        return out

    @property
    def ambiguous(self) -> bool:
        """Whether several autopilots are heard, and nobody has said which is ours."""
        return bool(self.strangers) and not self.named

    def timesync_question(self, t_ns: int) -> bytes:
        """TIMESYNC question sent at `t_ns`, remembered so that its answer is known."""
        return self.encoder.timesync(0, self.clock.question(t_ns))

    def timesync_answer(self, question: TimeSync, t_ns: int) -> bytes:
        """Answer to the autopilot's question; tc1 = 0 would make it a question."""
        return self.encoder.timesync(t_ns or 1, question.ts1_ns)

    def _count(self, m: Any) -> None:
        self.counters.received[m.get_type()] += 1
        sender, seq = (m.get_srcSystem(), m.get_srcComponent()), m.get_seq()
        gap = (seq - self._seq.get(sender, seq - 1) - 1) % 256
        if gap < 128:  # more: the frame is late, not 128 or more lost
            self.counters.lost[sender] += gap
        self._seq[sender] = seq

    def _from_target(self, m: Any) -> bool:
        sender = (m.get_srcSystem(), m.get_srcComponent())
        if m.get_type() == "HEARTBEAT" and is_autopilot(m):
            if self.target is None:
                self.target = sender
                self.encoder.target_system, self.encoder.target_component = sender
            elif sender[0] != self.target[0]:
                self.strangers.add(sender[0])
        if sender != self.target:
            return False
        addressee = (getattr(m, "target_system", 0), getattr(m, "target_component", 0))
        return all(to in (0, own) for to, own in zip(addressee, self._own, strict=True))

    def _decode(self, m: Any, t_rx_ns: int) -> list[Message]:
        name, t_ns = m.get_type(), t_rx_ns
        stamp = STAMPS.get(name) or FIX_STAMPS.get(name)
        if stamp and getattr(m, "fix_type", FIX) >= FIX:
            source, unit_ns, wrap_ns = stamp
            if name in SENSED and self._repeats(name, getattr(m, source)):
                return []
            clock, oldest_ns = name if name in STAMPS else None, SENSED_AGE_NS if name in SENSED else MAX_AGE_NS
            t_ns = self.clock.to_companion(clock, getattr(m, source) * unit_ns, t_rx_ns, wrap_ns, oldest_ns)
        if name == "STATUSTEXT":
            return _texts(self._texts.add(m.severity, m._text_raw, m.id, m.chunk_seq, t_rx_ns), t_rx_ns)
        if name == "SERVO_OUTPUT_RAW":
            return self._servo_output(m, t_ns)
        if name == "AHRS":
            self._take_gyro_drift(m)
        if name not in DECODERS:
            return []
        message = DECODERS[name](m, t_ns, t_rx_ns)
        if isinstance(message, Attitude):
            message = self._gyro_rates(message)
        messages = [] if message is None or not self._wanted(name, message, t_rx_ns) else [message]
        if name == "SYS_STATUS" and (outputs := motor_outputs(m, t_ns)):
            messages.append(outputs)
        return messages

    def _take_gyro_drift(self, m: Any) -> None:
        drift_rad_s = gyro_drift(m)
        if all(map(math.isfinite, drift_rad_s)):
            self._gyro_drift_rad_s = drift_rad_s
        else:
            self.counters.invalid[m.get_type()] += 1

    def _gyro_rates(self, attitude: Attitude) -> Attitude:
        p, q, r = self._gyro_drift_rad_s
        return replace(
            attitude, p_rad_s=attitude.p_rad_s - p, q_rad_s=attitude.q_rad_s - q, r_rad_s=attitude.r_rad_s - r
        )

    def _wanted(self, name: str, message: Message, t_rx_ns: int) -> bool:
        """Not another IMU's than the chosen one, and not the answer to somebody else's TIMESYNC."""
        if isinstance(message, ImuSample):
            return self.imu.passes(name, t_rx_ns)
        if not isinstance(message, TimeSync) or not message.tc1_ns:
            return True
        ours = self.clock.is_ours(message.ts1_ns)
        self.clock.answer(message.tc1_ns, message.ts1_ns, t_rx_ns)
        self.counters.ignored[name] += not ours
        return ours

    def _repeats(self, name: str, stamp: int) -> bool:
        """Whether a sensor's stamp is that of its last message; 0 is no stamp."""
        before, self._stamps[name] = self._stamps.get(name), stamp
        again = stamp != 0 and stamp == before
        self.counters.repeated[name] += again
        return again

    def _servo_output(self, m: Any, t_ns: int) -> list[Message]:
        """Port 0 holds outputs 1-16, port 1 outputs 17-32; told together, at each port 0."""
        if m.port >= _SERVO_PORTS:
            self.counters.invalid[m.get_type()] += 1
            return []
        self._servo_ports[m.port] = pulses(m, "servo{}_raw", 16)
        if m.port:
            return []
        return [ServoOutput(t_ns=t_ns, pwm_us=self._servo_ports[0] + self._servo_ports.get(1, ()))]


def _texts(texts: list[Text], t_ns: int) -> list[Message]:
    return [StatusText(t_ns=t_ns, severity=text.severity, text=text.text) for text in texts]


def _finite(message: Message) -> bool:
    values = (getattr(message, name) for name in message.__struct_fields__)
    return all(math.isfinite(v) for v in values if isinstance(v, float))
