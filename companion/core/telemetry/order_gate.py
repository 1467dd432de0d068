"""Orders from shore: what they look like, how they are signed, and which of them the boat believes.

An order is a zenoh query on `aritra/<boat>/command`: its payload an `Order` as JSON; the reply is an `OrderOutcome`.
Where the boat has a key, the attachment of the one and of the other is

    HMAC-SHA256(key, "aritra-order-1"  0 boat 0 order)
    HMAC-SHA256(key, "aritra-answer-1" 0 boat 0 SHA-256(order) reply)

Against replays an order names the run of the boat's program, an instant on **the boat's own clock** (nobody's wall
clock has to be right), its sender's session and a counter that only goes up. Believed is what is signed, of this run,
newer than the session's last, and at most 5 s old. A stop may be a minute old, for late by a bad radio it is still
right to stop, and older than another order of its session; an order to drive that was made out before a stop that the
boat has taken, by whomever, is refused. Who repeats an order word for word, because no answer came, gets the same
answer again, and nothing is done twice.

Every answer tells run and clock, to `hello` and to what is refused as well. Signed, and to this very order, it cannot
be made up or kept from before: so a sender whose idea of run or clock is wrong, by a lost radio or by a stranger's
telemetry, learns both from the refusal and makes its stop out anew (`order_sender`). Nothing else is asked of a stop.
"""

from __future__ import annotations

import hashlib
import hmac
from typing import Annotated, Literal

import msgspec

from companion.core.telemetry.shore_message import VERSION

MAX_BYTES = 65_536
"""Longer payloads are refused unread: a mission of 500 waypoints takes half of it (assumed)."""
WINDOW_S, STOP_WINDOW_S = 5.0, 60.0
"""How old an order may be; assumed: one that was held up for longer was meant for another situation."""
AHEAD_S = 1.0
"""How far a sender's idea of the boat's clock may be ahead of it (assumed)."""
SESSIONS = 32
"""Senders remembered at a time."""
STOPS = 256
"""Stops remembered at a time, so that none is obeyed twice; beyond that they are (assumed)."""

Command = Literal["start", "hold", "stop", "manual", "load_mission"]
Word = Literal["start", "hold", "stop", "manual", "load_mission", "hello"]
Status = Literal["done", "waiting", "refused"]
Code = Literal[
    "ok", "waiting", "malformed", "too_long", "version", "unsigned", "wrong_run", "replayed", "late", "crowded",
    "busy", "bad_mission", "not_now",
]  # fmt: skip
Name = Annotated[str, msgspec.Meta(min_length=1, max_length=40, pattern=r"^[A-Za-z0-9_.@ -]+\Z")]
LATEST_NS = (1 << 63) - 1
Instant = Annotated[int, msgspec.Meta(ge=0, le=LATEST_NS)]


class MissionFile(msgspec.Struct, frozen=True, kw_only=True):
    """A mission as a file: its name, whose ending says the format (.toml .plan .waypoints .geojson), and its text."""

    name: Annotated[str, msgspec.Meta(min_length=1, max_length=100)]
    text: str


class Order(msgspec.Struct, frozen=True, kw_only=True):
    """What the shore wants.

    `start`: drive the mission, or go on with it where it was left (arms); `hold`: keep station (arms); `stop`: neutral;
    `manual`: this session's sticks drive (arms; see `sticks`);
    `load_mission`: `mission` from now on; `hello`: asks who is there, and does nothing. `sender`: a person or program,
    in words, for the log. `t_ns`: the boat's clock as the sender believes it to be. `session`: random, one a sender's
    program run; `counter` goes up. `heard`: runs that the sender heard under the boat's name; counts where it is fresh.
    """

    v: int = VERSION
    run: str
    t_ns: Instant
    session: Annotated[str, msgspec.Meta(min_length=8, max_length=64)]
    counter: Instant
    sender: Name
    command: Word
    mission: MissionFile | None = None
    heard: Annotated[tuple[Annotated[str, msgspec.Meta(max_length=64)], ...], msgspec.Meta(max_length=8)] = ()


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


def seal_answer(key: bytes, boat: str, order: bytes, reply: bytes) -> bytes:
    """Signature of the reply to an order (its payload), 32 bytes."""
    asked = hashlib.sha256(order).digest()
    return hmac.digest(key, b"\0".join((b"aritra-answer-1", boat.encode(), asked + reply)), "sha256")


def read_outcome(data: bytes) -> OrderOutcome:
    """JSON -> OrderOutcome. Raises ValueError."""
    try:
        return msgspec.json.decode(data, type=OrderOutcome)
    except msgspec.MsgspecError as error:
        raise ValueError(f"not an outcome: {error}") from None


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
        self._stops: dict[bytes, int] = {}
        self._stopped_ns = 0
        self._decoder = msgspec.json.Decoder(Order)

    @property
    def signed(self) -> bool:
        """Whether orders need a signature."""
        return self._key is not None

    def proves(self, payload: bytes, attachment: bytes | None) -> bool:
        """Whether an order is signed as it must be here."""
        if self._key is None:
            return True
        return hmac.compare_digest(attachment or b"", seal(self._key, self.boat, payload))

    def answer_seal(self, order: bytes, reply: bytes) -> bytes | None:
        """Attachment of the reply to an order that `proves`: a stranger must not get one for an order of another's."""
        return None if self._key is None else seal_answer(self._key, self.boat, order, reply)

    def judge(self, payload: bytes, attachment: bytes | None, now_ns: int) -> Order:
        """The order in `payload`, believed. Raises OrderRefused or Repeated."""
        order = self._read(payload, attachment)
        if order.command == "hello":
            fresh = order.run == self.run and -AHEAD_S <= (now_ns - order.t_ns) * 1e-9 <= WINDOW_S
            return order if fresh else msgspec.structs.replace(order, heard=())
        if order.run != self.run:
            unheard = "its sender had not heard of this run of the boat's program yet, and is told of it now"
            another = "meant for another run of the boat's program: it was started anew since"
            raise OrderRefused("wrong_run", another if order.run else unheard)
        digest = hashlib.sha256(payload).digest()
        known = self._sessions.get(order.session)
        if known and known.counter == order.counter and known.digest == digest:
            raise Repeated(known.outcome)
        if known and order.counter <= known.counter and (order.command != "stop" or digest in self._stops):
            raise OrderRefused(
                "replayed", f"counter {order.counter}, and {known.counter} of this session was heard already"
            )
        age_s, window_s = (now_ns - order.t_ns) * 1e-9, STOP_WINDOW_S if order.command == "stop" else WINDOW_S
        if not -AHEAD_S <= age_s <= window_s:
            raise OrderRefused("late", f"{age_s:.1f} s old by the boat's clock, at most {window_s:g} s are believed")
        if order.t_ns < self._stopped_ns and order.command in ("start", "hold", "manual"):
            raise OrderRefused("late", "given before a STOP that the boat has: give it again if it is still wanted")
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
        if not self.proves(payload, attachment):
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
        if order.command == "stop":
            self._stopped_ns = max(self._stopped_ns, order.t_ns)
            self._stops = {d: t_ns for d, t_ns in self._stops.items() if now_ns - t_ns <= keep_ns}
            if len(self._stops) < STOPS:
                self._stops[digest] = now_ns
            if (known := self._sessions.get(order.session)) and known.counter > order.counter:
                return  # what that session said later has been heard already, and stays heard
        if order.session not in self._sessions and len(self._sessions) >= SESSIONS:
            if order.command == "stop":
                return  # to stop twice does no harm
            raise OrderRefused("crowded", f"more than {SESSIONS} senders within a minute")
        self._sessions[order.session] = _Session(order.counter, digest, now_ns)
