"""What attackers of the telemetry do: each returns (tries, accepted)."""

from __future__ import annotations

import json
import random
import secrets
import subprocess
import time
from collections.abc import Callable

import zenoh

from companion.core.telemetry import structs as shore
from companion.core.telemetry.order_gate import MAX_BYTES, WINDOW_S, read_outcome, seal
from companion.core.telemetry.order_sender import Sender
from tests.evidence.shore.secured_boat import BOAT, ZENOH, Range
from tests.support.zenoh_fixture import Console, config

SEED = 11
FLOOD_S = 10.0
WAIT_S = 0.5


def ask(session: zenoh.Session, payload: bytes, attachment: bytes | None, wait_s: float = WAIT_S) -> list[str]:
    """One order; the codes of its answers, `done` where it was obeyed anew."""
    replies = session.get(shore.command_key(BOAT), payload=payload, attachment=attachment, timeout=wait_s)
    answers = [read_outcome(bytes(r.ok.payload)) for r in replies if r.ok]
    return ["done" if a.status != "refused" and not a.repeated else a.code for a in answers]


def no_tls(at: Range) -> tuple[int, int]:
    plain = config("client", connect=[f"tcp/127.0.0.1:{at.port}"], **{"connect/timeout_ms": 1500})
    return 1, _comes_in(lambda: zenoh.open(plain).close())


def no_certificate(at: Range) -> tuple[int, int]:
    text = (at.folder / "shore.json5").read_text()
    lines = [x for x in text.splitlines() if "connect_certificate" not in x and "connect_private_key" not in x]
    file = at.folder / "none.json5"
    file.write_text("\n".join(lines).replace("enable_mtls: true", "enable_mtls: false"))
    made = config("client", connect=[f"tls/127.0.0.1:{at.port}"], file=file, **{"connect/timeout_ms": 1500})
    return 1, _comes_in(lambda: zenoh.open(made).close())


def wrong_ca(at: Range) -> tuple[int, int]:
    other = at.folder / "other"
    subprocess.run([ZENOH / "make-certificates", other, "127.0.0.1", "anna"], check=True, capture_output=True)

    def come() -> None:
        with at.person("anna", other):
            pass

    return 1, _comes_in(come)


def _comes_in(come: Callable[[], None]) -> int:
    try:
        come()
    except zenoh.ZError:
        return 0
    return 1


def wrong_user(at: Range) -> tuple[int, int]:
    """A certificate of ours, a name that the router's file does not know, and a stolen command key."""
    with at.person("stranger") as session:
        console = Console(session)
        time.sleep(2.0)
        seen = len(console.heard) + len(console.last_values()) + len(console.alive())
        return 4, seen + len(ask(session, *signed_order(at)))


def right_user_wrong_key(at: Range) -> tuple[int, int]:
    """The watcher orders (with the stolen command key); the operator publishes as the boat, answers for it, and
    listens to everything. `accepted`: what any of it reaches."""
    with at.person("watch") as watcher, at.person("anna") as anna, at.person("anna") as second:
        reached = len(ask(watcher, *signed_order(at)))
        heard: list[bytes] = []
        listens = watcher.declare_subscriber(shore.telemetry_key(BOAT, "*"), lambda s: heard.append(bytes(s.payload)))
        asked: list[zenoh.Query] = []
        everything: list[zenoh.Sample] = []
        held = [
            anna.declare_queryable(shore.command_key(BOAT), asked.append, complete=True),
            second.declare_subscriber(f"{shore.KEYSPACE}/**", everything.append),
            anna.liveliness().declare_token(shore.alive_key("ghost")),
        ]
        for _ in range(20):
            anna.put(shore.telemetry_key(BOAT, "mode"), b"forged")
        time.sleep(1.0)
        ghosts = [r for r in watcher.liveliness().get(shore.alive_key("ghost"), timeout=1.0) if r.ok]
        ask(second, *signed_order(at, stale=True))
        reached += heard.count(b"forged") + len(asked) + len(ghosts) + len(everything)
        del held, listens
        return 24, reached


def signed_order(at: Range, *, stale: bool = False, command="start") -> tuple[bytes, bytes]:
    """An order whose signature is right; `stale`: of another run, so that it is refused for that."""
    sender = Sender(BOAT, secrets.token_hex(8), "mallory", at.key, time.monotonic_ns)
    sender.hear("another" if stale else at.run, time.monotonic_ns())
    payload, sealed = sender.order(command)
    assert sealed
    return payload, sealed


def no_command_key(at: Range) -> tuple[int, int]:
    payload, sealed = signed_order(at)
    with at.person("anna") as session:
        tries = [None, b"", bytes(32), sealed[:-1], seal(at.key, "other", payload), seal(b"guess", BOAT, payload)]
        told = [code for forged in tries for code in ask(session, payload, forged)]
        assert told == ["unsigned"] * len(tries), told
    return len(tries), 0


def replayed(at: Range) -> tuple[int, int]:
    """A stop (harmless: the boat is idle) is overheard, with the signature: at once, later, in another run, too old."""
    sender = Sender(BOAT, secrets.token_hex(8), "anna", at.key, time.monotonic_ns)
    sender.hear(at.run, time.monotonic_ns())
    first, second, hold = sender.order("stop"), sender.order("stop"), sender.order("hold")
    with at.person("anna") as session:
        assert ask(session, *first) == ["done"]
        again = ask(session, *first)
        assert ask(session, *second) == ["done"]
        again += ask(session, *first)
        time.sleep(WINDOW_S + 1.0)
        again += ask(session, *hold) + ask(session, *signed_order(at, stale=True))
    assert again == ["ok", "replayed", "late", "wrong_run"], again
    return len(again), again.count("done")


def malformed(at: Range, n: int) -> tuple[int, int]:
    """Fuzzed payloads with the right signature: bytes at random, and honest orders with bytes or fields changed."""
    rng, accepted = random.Random(SEED), 0
    with at.person("anna") as session:
        for k in range(n):
            payload = _fuzzed(rng, signed_order(at, stale=True)[0], k)
            accepted += ask(session, payload, seal(at.key, BOAT, payload)).count("done")
    return n, accepted


WRONG = [None, True, -1, 1 << 70, 1e400, float("nan"), "", "x" * 5000, "\0", [], {}, [[[[]]]], "start"]


def _fuzzed(rng: random.Random, honest: bytes, k: int) -> bytes:
    if k % 3 == 0:
        return rng.randbytes(rng.randrange(300))
    if k % 3 == 1:
        data = bytearray(honest)
        for _ in range(rng.randrange(1, 6)):
            data[rng.randrange(len(data))] = rng.randrange(256)
        return bytes(data[: rng.randrange(1, len(data) + 1)] if rng.random() < 0.3 else data)
    order = json.loads(honest)
    key = rng.choice([*order, "mission", "extra"])
    if rng.random() < 0.2:
        order.pop(key, None)
    else:
        order[key] = rng.choice(WRONG)
    return json.dumps(order).encode() if rng.random() < 0.9 else b"[" * rng.randrange(1, 60_000)


def oversize(at: Range) -> tuple[int, int]:
    sizes = [MAX_BYTES + 1, 1_000_000, 20_000_000]
    with at.person("anna") as session:
        told = []
        for size in sizes:
            payload = b"x" * size
            told += ask(session, payload, seal(at.key, BOAT, payload), 10.0)
            told += ask(session, b"{}", payload, 10.0)
    return 2 * len(sizes), told.count("done")


def flood(at: Range) -> tuple[int, int]:
    """Unsigned orders as fast as they go, and nobody waits for the answers."""
    end, tries, done = time.monotonic() + FLOOD_S, 0, []

    def hear(reply: zenoh.Reply) -> None:
        if reply.ok and b'"done"' in bytes(reply.ok.payload):
            done.append(reply)

    with at.person("anna") as session:
        while time.monotonic() < end:
            session.get(shore.command_key(BOAT), hear, payload=b"x" * 300, attachment=bytes(32), timeout=5.0)
            tries += 1
        time.sleep(2.0)
    return tries, len(done)
