"""Telemetry over zenoh, in threads of its own: the control loop only leaves messages in a bounded queue.

    loop thread     see(message): append, or count as dropped; wake the thread once a tick, after the lease has gone
    thread          view.see -> encode -> AdvancedPublisher.put (congestion control DROP: a stopped shore costs 3 ms)
    zenoh's threads answer who asks for the last values; hand orders to `Answerer` (`order_receiver`)

A boat whose router cannot be reached is not slower, larger or chattier: zenoh tries again by itself, publications
without a reader go nowhere, each topic keeps `history_s` for whoever joins late or comes back, and it is told once.
"""

from __future__ import annotations

import contextlib
import re
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol

import zenoh
from zenoh import ext
from zenoh.handlers import Callback

from companion.boat.uplink.zenoh_session import Setting, configured, join_callbacks
from companion.core.configuration.run_file import TelemetryLink
from companion.core.messages import Alert, LoopTiming, Message
from companion.core.preflight.rows import Row
from companion.core.telemetry import structs as shore
from companion.core.telemetry.view import TelemetryView, wants

QUEUE = 2000
"""Messages that wait for the thread: some seconds of a run (assumed)."""
RETRY_S = 5.0
_OFTEN = {"period_init_ms": 500, "period_max_ms": 500, "period_increase_factor": 1.0}
"""Between a peer's attempts to reach the router; zenoh's own 1 to 4 s would be all that a boot may take. Assumed."""
LOOK_S = 1.0
"""Between looks at the connection, and at what is checked before the start."""
CLOSE_S = 2.0
"""How long the end of a run waits for zenoh; then the thread is left behind."""
RATED = {"state": 1.0, "thrusters": 1.0, "reference": 0.5, "horizon": 0.5}
"""Topic -> its share of the full rate; of the others `SPARSE` are kept at most."""
SPARSE = 200
MAX_MESSAGE = 1_000_000
"""Bytes; a longer message is dropped as it comes in. Zenoh's own limit is 1 GB, which a boat may not have (assumed)."""
HEARTBEAT_S = 1.0
"""Topics that are rarely published announce their last sample so often: a reader notices what it missed."""


class Answerer(Protocol):
    """Takes queries on the boat's command key. Called on a thread of zenoh's; must not wait."""

    def __call__(self, query: zenoh.Query) -> None:
        """Answer it, now or later, and drop it."""
        ...


def boat_name(link: TelemetryLink, vessel: str) -> str:
    """The boat's name in keys."""
    return link.boat or re.sub(r"[^A-Za-z0-9_.-]+", "-", vessel)[:40].strip("-") or "boat"


def config_of(link: TelemetryLink, folder: Path, *, where: str) -> zenoh.Config:
    """Zenoh's configuration: its own file, and over it mode and endpoints of the run file; no scouting, nothing long.

    Raises ConfigError that begins with `where`, the run file's name.
    """
    key = f"{where}: telemetry."
    settings = (
        Setting("mode", key + "mode", link.mode),
        Setting("connect/endpoints", key + "connect", list(link.connect)),
        Setting("connect/retry", key + "connect", _OFTEN),
        Setting("listen/endpoints", key + "listen", list(link.listen)),
        Setting("scouting/multicast/enabled", key + "connect", False),
        Setting("scouting/gossip/enabled", key + "connect", False),
        Setting("transport/link/rx/max_message_size", key + "config", MAX_MESSAGE),
        Setting("transport/shared_memory/enabled", key + "config", False),  # of a local program: 40 MB of ours
    )
    return configured(folder / link.config if link.config else None, key + "config", settings)


class Telemetry:
    """One run's. `published`, `published_bytes`: payloads given to zenoh; `dropped`: messages without room."""

    def __init__(self, boat: str, link: TelemetryLink, config: zenoh.Config, view: TelemetryView) -> None:
        self.published = self.published_bytes = self.dropped = 0
        self.refused: Callable[[], int] = lambda: 0
        self._boat, self._link, self._config, self._view = boat, link, config, view
        self._queue: deque[Message] = deque()
        self._wake, self._ended = threading.Event(), False
        self._last: dict[str, bytes] = {}
        self._told: set[str] = set()
        self._tell: Callable[[Alert], None] = lambda alert: None
        self._rows: Callable[[], Sequence[Row]] = tuple
        self._answer: Answerer | None = None
        self._hear: Callable[[bytes], None] = lambda data: None
        self._steer: Callable[[zenoh.Sample], None] | None = None
        self._thread = threading.Thread(target=self._work, name="telemetry", daemon=True)

    def start(
        self,
        tell: Callable[[Alert], None],
        rows: Callable[[], Sequence[Row]],
        answer: Answerer | None = None,
        hear: Callable[[bytes], None] = lambda data: None,
        steer: Callable[[zenoh.Sample], None] | None = None,
    ) -> None:
        """Begin. `tell`: takes an alert, on our thread; `rows`: the pre-flight rows known; `answer`: of orders;
        `hear`: takes modes that somebody else publishes under our name, `steer`: sticks, on threads of zenoh's.
        """
        self._tell, self._rows, self._answer, self._hear = tell, rows, answer, hear
        self._steer = steer
        self._thread.start()

    def see(self, message: Message) -> None:
        """Note one message, on the loop's thread. Never waits."""
        if not wants(message):
            return
        if len(self._queue) >= QUEUE:
            self.dropped += 1
        else:
            self._queue.append(message)
        if isinstance(message, LoopTiming | Alert):
            self._wake.set()

    def close(self) -> None:
        """Publish the rest of the queue, and end; waits for CLOSE_S at most."""
        self._ended = True
        self._wake.set()
        if self._thread.is_alive():
            self._thread.join(CLOSE_S)

    # --- the thread --------------------------------------------------------------------------------

    def _work(self) -> None:
        before = set(threading.enumerate())
        while not self._ended:
            try:
                with zenoh.open(self._config) as session:
                    self._serve(session)
                join_callbacks(before)
            except Exception as error:  # whatever it is, the boat goes on
                self._say("warning", f"telemetry: {error}; trying again every {RETRY_S:g} s")
                self._wait_until(time.monotonic() + RETRY_S)

    def _serve(self, session: zenoh.Session) -> None:
        publishers = {topic: self._publisher(session, topic) for topic in shore.TOPICS}
        everything = shore.telemetry_key(self._boat, "*")
        held = [
            session.liveliness().declare_token(shore.alive_key(self._boat)),
            session.declare_queryable(everything, self._tell_last, complete=True),
            session.declare_subscriber(
                shore.telemetry_key(self._boat, "mode"),
                Callback(self._heard),
                allowed_origin=zenoh.Locality.REMOTE,
            ),
        ]
        if self._answer:
            held.append(session.declare_queryable(shore.command_key(self._boat), self._answer, complete=True))
        if self._steer:
            held.append(session.declare_subscriber(shore.sticks_key(self._boat), Callback(self._steer)))
        self._publish(publishers, self._view.begin(time.monotonic_ns()))
        rows: Sequence[Row] = ()
        look_s, connected = 0.0, None
        while True:
            ended = self._ended
            self._wake.wait(LOOK_S)
            self._wake.clear()
            self._empty(publishers)
            if ended:
                return self._publish(publishers, self._view.end(time.monotonic_ns()))
            if (now_s := time.monotonic()) >= look_s:
                look_s = now_s + LOOK_S
                connected = self._look(session, connected)
                if (known := self._rows()) and known is not rows:
                    rows = known
                    self._publish(publishers, [self._view.checks(known, time.monotonic_ns())])

    def _publisher(self, session: zenoh.Session, topic: str) -> ext.AdvancedPublisher:
        """Drops rather than waits; keeps its history for late joiners and for after an outage."""
        rate_hz = self._link.rate_Hz * RATED.get(topic, 0.0)
        kept = round(rate_hz * self._link.history_s) if rate_hz else SPARSE
        once = topic in ("about", "path", "checks")
        beat_s = HEARTBEAT_S if once or topic == "alert" else None
        return ext.declare_advanced_publisher(
            session,
            shore.telemetry_key(self._boat, topic),
            encoding=_encoding(topic),
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.DATA_HIGH if topic in ("mode", "alert") else zenoh.Priority.DATA,
            cache=ext.CacheConfig(max_samples=1 if once else max(kept, 1)),
            sample_miss_detection=ext.MissDetectionConfig(heartbeat=beat_s, sporadic_heartbeat=None),
            publisher_detection=True,
        )

    def _empty(self, publishers: dict[str, ext.AdvancedPublisher]) -> None:
        """Everything in the queue through the view."""
        self._view.dropped, self._view.refused = self.dropped, self.refused()
        with contextlib.suppress(IndexError):
            while True:
                message = self._queue.popleft()
                try:
                    self._publish(publishers, self._view.see(message))
                except Exception as error:  # one message is not worth the others
                    self.dropped += 1
                    self._say("warning", f"telemetry: {type(message).__name__} not published: {error}")

    def _publish(self, publishers: dict[str, ext.AdvancedPublisher], messages: Sequence[shore.ShoreMessage]) -> None:
        for each in messages:
            topic, data = shore.topic_of(each), shore.encode(each)
            self._last[topic] = data
            publishers[topic].put(data)
            self.published += 1
            self.published_bytes += len(data)

    def _look(self, session: zenoh.Session, connected: bool | None) -> bool:
        """Alert, once each: nobody connected yet, connected, connection lost."""
        reachable = bool(session.info.routers_zid() or session.info.peers_zid())
        where = ", ".join((*self._link.connect, *self._link.listen))
        if reachable and not connected:
            self._say("info", f"telemetry: {self._boat} is connected ({where})")
        elif connected and not reachable:
            self._say("info", f"telemetry: the connection is lost ({where}); the boat goes on, zenoh tries again")
        elif connected is None and not reachable:
            self._say("info", f"telemetry: nobody at {where} yet; the boat goes on, zenoh tries again")
        return reachable

    def _say(self, level, text: str) -> None:
        if text not in self._told:
            self._told.add(text)
            self._tell(Alert(t_ns=time.monotonic_ns(), level=level, text=text))

    def _wait_until(self, end_s: float) -> None:
        """Without a session: drop what is queued until `end_s`."""
        while not self._ended and time.monotonic() < end_s:
            self._wake.wait(LOOK_S)
            self._wake.clear()
            self.dropped += len(self._queue)
            self._queue.clear()

    # --- zenoh's threads ---------------------------------------------------------------------------

    def _heard(self, sample: zenoh.Sample) -> None:
        """A mode under our name, from somebody else."""
        self._hear(bytes(sample.payload))

    def _tell_last(self, query: zenoh.Query) -> None:
        """The last value of each topic that is asked for."""
        with contextlib.suppress(zenoh.ZError), query:
            for topic, data in list(self._last.items()):
                key = shore.telemetry_key(self._boat, topic)
                if query.key_expr.intersects(key):
                    query.reply(key, data, encoding=_encoding(topic))


def _encoding(topic: str) -> zenoh.Encoding:
    return zenoh.Encoding.APPLICATION_JSON.with_schema(f"aritra.{topic}.{shore.VERSION}")
