"""The companion's side of the MAVLink conversation, as a pure state machine: messages in, bytes to send out.

always            companion HEARTBEAT at 1 Hz; TIMESYNC questions are answered
signed, no key    said, unless the autopilot answers us all the same, as on USB
another autopilot said, once each: nothing is taken from it
autopilot heard   TIMESYNC questions at 4 Hz; AUTOPILOT_VERSION asked for until it comes;
                  wanted message intervals requested and kept (see `streams`); the filters of the inertial sensors
                  asked for, so that a log says how late their samples are
rebooted (its clock went back) or back after silence: everything is asked for again
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from companion.core.configuration.imu_filters import FILTER_PARAMETERS
from companion.core.messages import Alert, AutopilotInfo, Heartbeat, Message, TimeSync
from drivers.mavlink.codec import MavlinkCodec
from drivers.mavlink.parameter_reader import ParameterReader
from drivers.mavlink.signing import NO_KEY
from drivers.mavlink.streams import WANTED_HZ, Streams

HEARTBEAT_NS = 1_000_000_000
TIMESYNC_NS = 250_000_000
"""How soon a link that is late is seen to be (`companion.core.pilot.monitors.link_latency`); 28 bytes each way."""
SILENCE_NS = 5_000_000_000
"""Heartbeats come at 1 Hz; after this long without one the autopilot may have been another (assumed)."""
DEAF_NS, DEAF_AGAIN_NS = 2_000_000_000, 30_000_000_000
"""How long eight TIMESYNC questions may stay without an answer, and until it is said again; assumed."""
TWINS = (
    "two autopilots of one system id are heard as one, and both would be driven: give each its own SYSID_THISMAV "
    "(4.7: MAV_SYSID), and start again"
)
VERSION_RETRY_NS = 2_000_000_000
VERSION_RETRY_MAX_NS = 32_000_000_000


class MavlinkSession:
    """Session of one link. `codec`: the codec that made the messages; `wanted_hz`: message type -> rate.

    `begins`: how often the conversation began, as at the first heartbeat and after each reboot.
    """

    def __init__(self, codec: MavlinkCodec, wanted_hz: Mapping[str, float] = WANTED_HZ) -> None:
        self.autopilot: AutopilotInfo | None = None
        self.begins = 0
        self._codec = codec
        self._streams = Streams(wanted_hz)
        self._filters = ParameterReader(codec.encoder)
        self._alerts: list[Alert] = []
        self._heard_ns: int | None = None
        self._reboots = codec.clock.reboots
        self._answered, self._asked_ns = False, 0
        self._told_of: set[int] = set()
        self._told_twins = False
        self._heartbeat_due_ns: int | None = None
        self._timesync_due_ns = 0
        self._version_due_ns = 0
        self._version_retry_ns = VERSION_RETRY_NS

    def step(self, messages: Sequence[Message], t_ns: int) -> list[bytes]:
        """Frames to send at `t_ns` [ns]. Call it with every batch of messages, and at 10 Hz if none come."""
        out: list[bytes] = []
        if self._codec.signing:
            self._alerts += self._codec.signing.alerts(t_ns)
        for message in messages:
            if isinstance(message, Heartbeat):
                self._hear(t_ns)
            elif isinstance(message, AutopilotInfo):
                self.autopilot = message
            elif isinstance(message, TimeSync):
                self._answered = self._answered or message.tc1_ns != 0
                out += [] if message.tc1_ns else [self._codec.timesync_answer(message, t_ns)]
        self._tell_strangers(t_ns)
        if self._codec.clock.reboots != self._reboots:
            self._reboots = self._codec.clock.reboots
            self._rebooted(t_ns)
        if self.is_deaf and t_ns - self._asked_ns > DEAF_NS:
            self._asked_ns = t_ns + DEAF_AGAIN_NS
            self._alerts.append(Alert(t_ns=t_ns, level="error", text=NO_KEY))
        if self._heartbeat_due_ns is None or t_ns >= self._heartbeat_due_ns:
            self._heartbeat_due_ns = t_ns + HEARTBEAT_NS
            out.append(self._codec.encoder.heartbeat())
        if self._heard_ns is not None and t_ns - self._heard_ns <= SILENCE_NS:
            out += self._converse(t_ns) + self._filters.step(messages, t_ns)
        return out

    @property
    def is_deaf(self) -> bool:
        """Whether the autopilot signs what it says, we have no key, and it has answered none of our TIMESYNC."""
        return self._codec.signed and self._codec.signing is None and not self._answered and self.begins > 0

    def take_alerts(self) -> list[Alert]:
        """Alerts since the last call."""
        alerts, self._alerts = self._alerts, []
        return alerts

    def _tell_strangers(self, t_ns: int) -> None:
        ours = self._codec.target[0] if self._codec.target else 0
        for system in sorted(self._codec.strangers - self._told_of):
            self._told_of.add(system)
            if self._codec.named:
                found = f"an autopilot of system {system} is heard, which is not ours (mavlink.autopilot_system_id"
                self._alert(t_ns, f"{found} = {ours}): nothing of it is taken, and nothing is sent to it")
                continue
            found = f"autopilots of systems {ours} and {system} are heard: this run keeps to {ours}, which spoke first"
            todo = "if that is not yours, stop, and name yours in the run file: mavlink.autopilot_system_id"
            self._alerts.append(Alert(t_ns=t_ns, level="error", text=f"{found}; {todo}"))

    def _hear(self, t_ns: int) -> None:
        if self._heard_ns is None or t_ns - self._heard_ns > SILENCE_NS:
            self._begin(t_ns)
        self._heard_ns = t_ns

    def _rebooted(self, t_ns: int) -> None:
        if not self._codec.clock.twins:
            self._alert(t_ns, "the autopilot has rebooted: its settings for this link are asked for again")
            self._begin(t_ns)
        elif not self._told_twins:
            self._told_twins = True
            self._alerts.append(Alert(t_ns=t_ns, level="error", text=TWINS))

    def _begin(self, t_ns: int) -> None:
        self.autopilot = None
        self.begins += 1
        self._streams.restart()
        self._filters.ask(FILTER_PARAMETERS)
        self._timesync_due_ns = self._version_due_ns = self._asked_ns = t_ns
        self._answered = False
        self._version_retry_ns = VERSION_RETRY_NS

    def _converse(self, t_ns: int) -> list[bytes]:
        codec = self._codec
        out: list[bytes] = []
        if t_ns >= self._timesync_due_ns:
            self._timesync_due_ns = t_ns + TIMESYNC_NS
            out.append(codec.timesync_question(t_ns))
        if self.autopilot is None and t_ns >= self._version_due_ns:
            self._version_due_ns = t_ns + self._version_retry_ns
            self._version_retry_ns = min(2 * self._version_retry_ns, VERSION_RETRY_MAX_NS)
            out.append(codec.encoder.request_message("AUTOPILOT_VERSION"))
        requests, warnings = self._streams.step(codec.counters.from_target, t_ns)
        out += [codec.encoder.set_message_interval(r.name, r.rate_hz) for r in requests]
        for text in warnings:
            self._alert(t_ns, text)
        return out

    def _alert(self, t_ns: int, text: str) -> None:
        self._alerts.append(Alert(t_ns=t_ns, level="warning", text=text))
