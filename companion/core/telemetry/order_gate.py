"""Orders from shore: what they look like, how they are signed, and which of them the boat believes.

An order is a zenoh query on `aritra/<boat>/command`: its payload an `Order` as JSON, its attachment

    HMAC-SHA256(key, "aritra-order-1" 0 boat 0 payload)

where the boat has a key; the reply is an `OrderOutcome`. Against replays an order names the run of the boat's program,
an instant on **the boat's own clock** (from telemetry; nobody's wall clock has to be right), its sender's session
and a counter that only goes up. Believed is what is signed, of this run, newer than the session's last, and at most
5 s old; a stop at most a minute: late by a bad radio it is still right to stop. Who repeats an order word for word,
because no answer came, gets the same answer again, and nothing is done twice.
"""

from __future__ import annotations

import hashlib
import hmac
from collections.abc import Callable
from typing import Annotated, Literal

import msgspec

from companion.core.telemetry.shore_message import VERSION

MAX_BYTES = 65_536
"""Longer payloads are refused unread: a mission of 500 waypoints takes half of it (assumed)."""
WINDOW_S, STOP_WINDOW_S = 5.0, 60.0
"""How old an order may be; assumed: one that was held up for longer was meant for another situation."""
AHEAD_S = 1.0
"""How far a sender's idea of the boat's clock may be ahead of it (assumed)."""
DRIFT = 1e-3
"""More than two clocks run apart; so what was once believed of the boat's is doubted in time (assumed)."""
SESSIONS = 32
"""Senders remembered at a time."""

Command = Literal["start", "hold", "stop", "load_mission"]
Status = Literal["done", "waiting", "refused"]
Code = Literal[
    "ok", "waiting", "malformed", "too_long", "version", "unsigned", "wrong_run", "replayed", "late", "crowded",
    "busy", "bad_mission", "not_now",
]  # fmt: skip
Name = Annotated[str, msgspec.Meta(min_length=1, max_length=40, pattern=r"^[A-Za-z0-9_.@ -]+\Z")]
Instant = Annotated[int, msgspec.Meta(ge=0, le=(1 << 63) - 1)]


class MissionFile(msgspec.Struct, frozen=True, kw_only=True):
    """A mission as a file: its name, whose ending says the format (.toml .plan .waypoints .geojson), and its text."""

    name: Annotated[str, msgspec.Meta(min_length=1, max_length=100)]
    text: str


class Order(msgspec.Struct, frozen=True, kw_only=True):
    """What the shore wants.

    `start`: drive the mission, or go on with it where it was left (arms); `hold`: keep station (arms); `stop`: neutral;
    `load_mission`: `mission` from now on. `sender`: a person or program, in words, for the log. `t_ns`: the boat's
    clock as the sender believes it to be. `session`: random, one a sender's program run; `counter` goes up.
    """

    v: int = VERSION
    run: str
    t_ns: Instant
    session: Annotated[str, msgspec.Meta(min_length=8, max_length=64)]
    counter: Instant
    sender: Name
    command: Command
    mission: MissionFile | None = None


class OrderOutcome(msgspec.Struct, frozen=True, kw_only=True):
    """The boat's answer. `done`: the pilot has it; `waiting`: it begins when the autopilot has been checked.

    `code`: the reason for programs, `text` for people; `mode`, `why`: the boat's afterwards, null where refused unread.
    `run`, `t_ns`: as in telemetry. `repeated`: the answer that an earlier, equal order got.
    """

    v: int = VERSION
    run: str
    t_ns: int
    status: Status
    code: Code
    text: str
    mode: str | None = None
    why: str | None = None
    repeated: bool = False


class OrderRefused(Exception):
    """An order that is not obeyed: code and text of its OrderOutcome."""

    def __init__(self, code: Code, text: str) -> None:
        super().__init__(text)
        self.code: Code = code
        self.text = text


class Repeated(Exception):
    """The same order again. `outcome`: what came of it; None: that is not known yet."""

    def __init__(self, outcome: OrderOutcome | None) -> None:
        super().__init__("repeated")
        self.outcome = outcome


def seal(key: bytes, boat: str, payload: bytes) -> bytes:
    """Signature of an order, 32 bytes."""
    return hmac.digest(key, b"\0".join((b"aritra-order-1", boat.encode(), payload)), "sha256")


def read_outcome(data: bytes) -> OrderOutcome:
    """JSON -> OrderOutcome. Raises ValueError."""
    try:
        return msgspec.json.decode(data, type=OrderOutcome)
    except msgspec.MsgspecError as error:
        raise ValueError(f"not an outcome: {error}") from None


class Sender:
    """The shore's side: makes orders. `key`: None where the boat has none; `local_ns`: a monotonic clock."""

    def __init__(self, boat: str, session: str, sender: str, key: bytes | None, local_ns: Callable[[], int]) -> None:
        self._boat, self._session, self._sender, self._key, self._local_ns = boat, session, sender, key, local_ns
        self._counter = 0
        self._run: str | None = None
        self._ahead_ns = self._heard_ns = 0

    def hear(self, run: str, t_ns: int) -> None:
        """Note `run` and `t_ns` of telemetry: what came quickest says what time the boat has."""
        now = self._local_ns()
        kept_ns = self._ahead_ns - round(DRIFT * (now - self._heard_ns))
        self._ahead_ns = t_ns - now if run != self._run else max(t_ns - now, kept_ns)
        self._run, self._heard_ns = run, now

    def order(self, command: Command, mission: MissionFile | None = None) -> tuple[bytes, bytes | None]:
        """Payload and attachment of a new order. Raises ValueError before any telemetry was heard."""
        if self._run is None:
            raise ValueError("no telemetry heard yet: which run of the boat, and what time it has, is not known")
        self._counter += 1
        order = Order(
            run=self._run,
            t_ns=max(self._local_ns() + self._ahead_ns, 0),
            session=self._session,
            counter=self._counter,
            sender=self._sender,
            command=command,
            mission=mission,
        )
        payload = msgspec.json.encode(order)
        return payload, None if self._key is None else seal(self._key, self._boat, payload)


class _Session:
    """What is remembered of a sender: its last order, and what came of it."""

    def __init__(self, counter: int, digest: bytes, seen_ns: int) -> None:
        self.counter, self.digest, self.seen_ns = counter, digest, seen_ns
        self.outcome: OrderOutcome | None = None


class OrderGate:
    """Which orders are believed. `key`: None: unsigned ones, too; then who may send is the router's to decide."""

    def __init__(self, boat: str, run: str, key: bytes | None) -> None:
        self.boat, self.run, self._key = boat, run, key
        self._sessions: dict[str, _Session] = {}
        self._decoder = msgspec.json.Decoder(Order)

    @property
    def signed(self) -> bool:
        """Whether orders need a signature."""
        return self._key is not None

    def judge(self, payload: bytes, attachment: bytes | None, now_ns: int) -> Order:
        """The order in `payload`, believed. Raises OrderRefused or Repeated."""
        order = self._read(payload, attachment)
        if order.run != self.run:
            raise OrderRefused("wrong_run", "meant for another run of the boat's program: it was started anew since")
        digest = hashlib.sha256(payload).digest()
        known = self._sessions.get(order.session)
        if known and known.counter == order.counter and known.digest == digest:
            raise Repeated(known.outcome)
        if known and order.counter <= known.counter:
            raise OrderRefused(
                "replayed", f"counter {order.counter}, and {known.counter} of this session was heard already"
            )
        age_s, window_s = (now_ns - order.t_ns) * 1e-9, STOP_WINDOW_S if order.command == "stop" else WINDOW_S
        if not -AHEAD_S <= age_s <= window_s:
            raise OrderRefused("late", f"{age_s:.1f} s old by the boat's clock, at most {window_s:g} s are believed")
        self._remember(order, digest, now_ns)
        return order

    def finish(self, order: Order, outcome: OrderOutcome) -> None:
        """What came of an order, for whoever asks again."""
        known = self._sessions.get(order.session)
        if known and known.counter == order.counter:
            known.outcome = outcome

    def _read(self, payload: bytes, attachment: bytes | None) -> Order:
        if len(payload) > MAX_BYTES:
            raise OrderRefused("too_long", f"longer than {MAX_BYTES} bytes")
        if self._key is not None and not hmac.compare_digest(attachment or b"", seal(self._key, self.boat, payload)):
            raise OrderRefused("unsigned", "not signed with this boat's command key")
        try:
            order = self._decoder.decode(payload)
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
            raise OrderRefused("malformed", f"not an order: {str(error)[:200]}") from None
        if order.v > VERSION:
            raise OrderRefused("version", f"version {order.v}, the boat knows {VERSION}")
        if (order.mission is not None) != (order.command == "load_mission"):
            raise OrderRefused("malformed", "not an order: `mission` belongs to load_mission, and to nothing else")
        return order

    def _remember(self, order: Order, digest: bytes, now_ns: int) -> None:
        """Senders are forgotten once nothing that they sent could be believed again."""
        keep_ns = round((STOP_WINDOW_S + AHEAD_S) * 1e9)
        self._sessions = {name: s for name, s in self._sessions.items() if now_ns - s.seen_ns <= keep_ns}
        if order.session not in self._sessions and len(self._sessions) >= SESSIONS:
            if order.command == "stop":
                return  # to stop twice does no harm
            raise OrderRefused("crowded", f"more than {SESSIONS} senders within a minute")
        self._sessions[order.session] = _Session(order.counter, digest, now_ns)
