"""Evidence for the locks of telemetry: who may not, cannot; nothing that strangers send moves or stops the boat.

A real companion on a simulator, the router with deploy/zenoh/router.json5 as it is, certificates from its script. The
attackers stand in this process. In the end one honest order is obeyed: the door was there all the time.
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import secrets
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import zenoh

from companion.boat.load_run import EXAMPLES
from companion.core.messages import LoopTiming, OperatorCommand, ProcessStats
from companion.core.telemetry import structs as shore
from companion.core.telemetry.orders import MAX_BYTES, WINDOW_S, Sender, read_outcome, seal
from companion.logs.log_file import LogFile
from companion.python_child import aritra
from tests.evidence.line import Line, at_least, at_most, exactly, information
from tests.support.zenoh_fixture import Console, config, free_port, wait_for

ROOT = Path(__file__).resolve().parents[3]

ZENOH = EXAMPLES / "zenoh"
BOAT = "aritra"
DENIALS = "warn,zenoh::net::routing::interceptor::access_control=trace"
SEED = 11
FUZZED, FULL_FUZZED = 3000, 30_000
FLOOD_S = 10.0
WAIT_S = 0.5


class Range:
    """Companion, simulator and router, and what an attacker may have: `key`, the boat's command key."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.port, self._stack = folder, free_port(), contextlib.ExitStack()
        self.key, self.log = secrets.token_bytes(32), folder / "run.mcap"
        self.out, self.router_out = folder / "run.txt", folder / "router.txt"

    def __enter__(self) -> Range:
        with self._stack:
            self._certificates()
            router = [sys.executable, ZENOH / "router.py", self.folder / "router.json5"]
            self.router = self._popen(router, self.router_out, RUST_LOG=DENIALS)
            wait_for(lambda: "router" in self.router_out.read_text(), 20, self.router_out.read_text)
            udp, tag = free_port(), self.folder / "tag"
            program = aritra()
            self._popen([*program, "sim", "--udp-to", f"127.0.0.1:{udp}", "--uwb", tag], self.folder / "sim.txt")
            wires = ["--mavlink", f"udpin:127.0.0.1:{udp}", "--uwb", f"serial:{tag}:115200", "--log", self.log]
            self.boat = self._popen([*program, "run", "--config", self._run_file(), *wires], self.out)
            wait_for(lambda: "state estimate healthy" in self.out.read_text(), 180, self.out.read_text)
            wait_for(lambda: "is connected" in self.out.read_text(), 20, self.out.read_text)
            self._stack = self._stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    @contextlib.contextmanager
    def person(self, name: str, pki: Path | None = None, **more: object) -> Iterator[zenoh.Session]:
        """A session with the certificate of `name`; of another authority's folder: `pki`."""
        text = (self.folder / "shore.json5").read_text()
        file = self.folder / f"person-{secrets.token_hex(4)}.json5"
        file.write_text(text.replace(f"{self.folder}/anna.", f"{pki or self.folder}/{name}."))
        made = config(
            "client", connect=[f"tls/127.0.0.1:{self.port}"], file=file, **{"connect/timeout_ms": 1500, **more}
        )
        with zenoh.open(made) as session:
            yield session

    def whole(self) -> bool:
        """Neither companion nor router has ended."""
        return self.boat.poll() is None and self.router.poll() is None

    def _certificates(self) -> None:
        names = [BOAT, "anna", "watch", "stranger"]
        subprocess.run([ZENOH / "make-certificates", self.folder, "127.0.0.1", *names], check=True, capture_output=True)
        for file in ("boat", "shore", "router"):
            text = (ZENOH / f"{file}.json5").read_text().replace("0.0.0.0:7447", f"127.0.0.1:{self.port}")
            for place in ("/etc/aritra/zenoh", "pki"):
                text = text.replace(f'"{place}/', f'"{self.folder}/')
            (self.folder / f"{file}.json5").write_text(text.replace("/boat.", f"/{BOAT}."))

    def _run_file(self) -> Path:
        text = (EXAMPLES / "aritra.toml").read_text()
        for name in ("boats", "sites", "missions"):
            text = text.replace(f'"{name}/', f'"{EXAMPLES}/{name}/')
        key, file = self.folder / "command.key", self.folder / "run.toml"
        key.write_bytes(self.key)
        key.chmod(0o600)
        link = f'connect = ["tls/127.0.0.1:{self.port}"]\nconfig = "boat.json5"\n'
        file.write_text(f'{text}\n[telemetry]\n{link}commands = true\ncommand_key = "command.key"\n')
        return file

    def _popen(self, words: list, out: Path, **more: str) -> subprocess.Popen:
        file = self._stack.enter_context(out.open("w"))
        child = subprocess.Popen(
            list(map(str, words)), stdout=file, stderr=subprocess.STDOUT, env=os.environ | more | {"NO_COLOR": "1"}
        )
        self._stack.callback(_end, child)
        return child


def _end(child: subprocess.Popen) -> None:
    child.send_signal(signal.SIGINT)
    try:
        child.wait(20)
    except subprocess.TimeoutExpired:
        child.kill()
        child.wait()


# --- what attackers do: each returns (tries, accepted) ----------------------------------------------


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
        return 4, seen + len(ask(session, *_signed(at)))


def right_user_wrong_key(at: Range) -> tuple[int, int]:
    """The watcher orders (with the stolen command key); the operator publishes as the boat, answers for it, and
    listens to everything. `accepted`: what any of it reaches."""
    with at.person("watch") as watcher, at.person("anna") as anna, at.person("anna") as second:
        reached = len(ask(watcher, *_signed(at)))
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
        ask(second, *_signed(at, stale=True))
        reached += heard.count(b"forged") + len(asked) + len(ghosts) + len(everything)
        del held, listens
        return 24, reached


def _signed(at: Range, *, stale: bool = False, command="start") -> tuple[bytes, bytes]:
    """An order whose signature is right; `stale`: of another run, so that it is refused for that."""
    sender = Sender(BOAT, secrets.token_hex(8), "mallory", at.key, time.monotonic_ns)
    sender.hear("another" if stale else at.run, time.monotonic_ns())
    payload, sealed = sender.order(command)
    assert sealed
    return payload, sealed


def no_command_key(at: Range) -> tuple[int, int]:
    payload, sealed = _signed(at)
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
        again += ask(session, *hold) + ask(session, *_signed(at, stale=True))
    assert again == ["ok", "replayed", "late", "wrong_run"], again
    return len(again), again.count("done")


def malformed(at: Range, n: int) -> tuple[int, int]:
    """Fuzzed payloads with the right signature: bytes at random, and honest orders with bytes or fields changed."""
    rng, accepted = random.Random(SEED), 0
    with at.person("anna") as session:
        for k in range(n):
            payload = _fuzzed(rng, _signed(at, stale=True)[0], k)
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


# --- the table --------------------------------------------------------------------------------------

ROWS: tuple[tuple[str, Callable, str, str], ...] = (
    ("no TLS", no_tls, "router", "InvalidContentType"),
    ("no certificate", no_certificate, "router", "peer sent no certificates"),
    ("certificate of another authority", wrong_ca, "router", "invalid peer certificate"),
    ("wrong user: certificate of ours, name unknown", wrong_user, "router", "did not match any configured ACL subject"),
    ("right user, wrong key expression", right_user_wrong_key, "router", "is unauthorized to"),
    ("operator without the boat's command key", no_command_key, "boat", "not signed with this boat's command key"),
    ("replayed orders, rightly signed", replayed, "boat", "order from shore refused: counter"),
    ("malformed payloads by fuzzing, rightly signed", malformed, "boat", "order from shore refused: not an order"),
    ("oversize payloads, to 20 MB", oversize, "boat", "order from shore refused: longer than"),
    ("flood of unsigned orders", flood, "boat", "not signed with this boat's command key ("),
)
"""What, who does it, in whose log it is, and the words there."""


def lines(full: bool) -> Iterator[Line]:
    with tempfile.TemporaryDirectory(prefix="aritra-") as folder, Range(Path(folder)) as at:
        with at.person("watch") as session:
            at.run = shore.decode("about", Console(session).last_values()["about"]).run
        print(f"  {'attack':<48} {'tries':>7} {'accepted':>8}  {'crashed':<7}  logged")
        windows: dict[str, tuple[int, int]] = {}
        for what, attack, place, words in ROWS:
            out = at.out if place == "boat" else at.router_out
            before = _count(out, words)
            begun_ns = time.monotonic_ns()
            n = (FULL_FUZZED if full else FUZZED,) if attack is malformed else ()
            tries, accepted = attack(at, *n)
            time.sleep(WAIT_S)
            ended_ns, logged, whole = time.monotonic_ns(), _count(out, words) - before, at.whole()
            print(f"  {what:<48} {tries:>7} {accepted:>8}  {'no' if whole else 'YES':<7}  {place}: {logged} lines")
            yield exactly(f"accepted: {what}", accepted, 0)
            yield at_least("  lines of log, and nothing crashed", logged if whole else 0, 1, "", place)
            windows[what] = begun_ns, ended_ns
            if attack is flood:
                rate = tries / FLOOD_S
        with at.person("anna") as session:
            yield exactly("one honest start is obeyed", ask(session, *_signed(at), 5.0).count("done"), 1)
        _end(at.boat)
        yield exactly("the companion's exit code", at.boat.returncode, 0)
        yield from _unmoved(at.log, windows, rate)


def _unmoved(log: Path, windows: dict[str, tuple[int, int]], rate: float) -> Iterator[Line]:
    """What the pilot was given, and how the loop fared in the flood, and the memory in all attacks."""
    messages = list(LogFile(log).messages(OperatorCommand, LoopTiming, ProcessStats))
    given = [m.command for m in messages if isinstance(m, OperatorCommand)]
    # two stops of the one who is overheard, the honest start, and the stop with which a run ends
    yield exactly("the pilot was given exactly stop, stop, start, stop", given == ["stop", "stop", "start", "stop"], 1)
    late = [m for m in messages if isinstance(m, LoopTiming)]
    (begin, _), *_, flooded = windows.values()
    during = [m.lateness_ms for m in late if flooded[0] < m.t_ns < flooded[1]]
    before = [m.lateness_ms for m in late if m.t_ns < flooded[0]][-len(during) :]
    note = f"{rate:.0f} orders a second; p99 {np.percentile(before, 99):.2f} ms in the {len(before) / 10:.0f} s before"
    yield information("lateness p99 in the flood", float(np.percentile(during, 99)), "ms", note)
    yield at_least("ticks a second in the flood", len(during) / (flooded[1] - flooded[0]) * 1e9, 9.8)
    rss = [(m.t_ns, m.rss_mb) for m in messages if isinstance(m, ProcessStats)]
    at = [min(rss, key=lambda x: abs(x[0] - t_ns))[1] for t_ns in (begin, *(w[1] for w in windows.values()))]
    note = "MB before, and after each attack: " + " ".join(f"{x:.0f}" for x in at)
    yield at_most("memory after all attacks more than before", at[-1] - at[0], 30.0, "MB", note)


def _count(file: Path, words: str) -> int:
    return file.read_text(errors="replace").count(words)
