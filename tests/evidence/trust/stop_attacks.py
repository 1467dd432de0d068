"""Who and what may stand between STOP and the boat: a program of its own, `python -m ... ZENOH_PORT WEB_PORT RUN`.

It reads names of attacks from its input, answers `ready` once they go on, ends them at `end`, and answers how many
stops and other orders the twins (honest programs of the same name and key) have obeyed, and how many there were.
"""

from __future__ import annotations

import contextlib
import secrets
import socket
import sys
import threading
import time
from collections.abc import Callable

import msgspec
import zenoh

from companion.core.telemetry import structs as shore
from companion.core.telemetry.order_gate import OrderGate, OrderOutcome
from tests.support.console_fixture import S, answer_as_a_boat, mode, state
from tests.support.zenoh_fixture import config

BOAT, RUN = "aritra", "0123456789ab"
KEY = bytes(range(7, 39))
HOUR_NS = 3600 * S
FLOOD_S, ORDERS, SAMPLES = 0.01, 10, 50
"""A flood: so many unsigned orders to the boat, or samples of a thousand names, so often: 1,000 and 5,000 a second."""
SLOW = 400
"""Half-sent requests; the console's limits are 32 and 128."""


class Twin:
    """A second program of the boat's name and key, with another clock: speaks ten times a second, obeys."""

    def __init__(self, session: zenoh.Session, key: bytes, ahead_ns: int) -> None:
        self.run, self.ahead_ns, self.obeyed = secrets.token_hex(6), ahead_ns, []
        self._gate, self._session = OrderGate(BOAT, self.run, key), session
        self._held = [
            session.liveliness().declare_token(shore.alive_key(BOAT)),
            session.declare_queryable(shore.command_key(BOAT), self._answer, complete=True),
        ]

    def _answer(self, query: zenoh.Query) -> None:
        answer_as_a_boat(query, self._gate, time.monotonic_ns() + self.ahead_ns, self.obeyed)

    def speak(self) -> None:
        told = state(1, run=self.run, t_ns=max(time.monotonic_ns() + self.ahead_ns, 0))
        self._session.put(shore.telemetry_key(BOAT, "state"), shore.encode(told))

    def end(self) -> None:
        for each in self._held:
            each.undeclare()


class Attacker:
    """Attacks, in threads."""

    def __init__(self, port: int, web: int, key: bytes, run: str) -> None:
        self.session = zenoh.open(config("client", connect=[f"tcp/127.0.0.1:{port}"]))
        self.web, self.key, self.run = web, key, run
        self._going = False
        self._threads: list[threading.Thread] = []
        self._twins: list[Twin] = []
        self._held: list = []

    def begin(self, names: str) -> None:
        self._going = True
        for name in names.split(","):
            getattr(self, name.strip().replace(" ", "_"))()

    def end(self) -> str:
        self._going = False
        for thread in self._threads:
            thread.join(5)
        for each in self._held:
            with contextlib.suppress(OSError, zenoh.ZError):
                (each.close if isinstance(each, socket.socket) else each.undeclare)()
        obeyed = [command for twin in self._twins for command in twin.obeyed]
        stops, twins = obeyed.count("stop"), len(self._twins)
        for twin in self._twins:
            twin.end()
        self._threads, self._held, self._twins = [], [], []
        return f"{stops} {len(obeyed) - stops} {twins}"

    def _forge(self, run: str, ahead_ns: int, *, boat: str = BOAT) -> None:
        told = state(1, run=run, t_ns=max(time.monotonic_ns() + ahead_ns, 0))
        self.session.put(shore.telemetry_key(boat, "state"), shore.encode(told))
        self.session.put(shore.telemetry_key(boat, "mode"), shore.encode(mode(1, run=run)))

    def _again(self, act: Callable[[], None], pause_s: float) -> None:
        def work() -> None:
            while self._going:
                act()
                time.sleep(pause_s)

        thread = threading.Thread(target=work, daemon=True)
        self._threads.append(thread)
        thread.start()

    # --- the attacks -------------------------------------------------------------------------------

    def nothing(self) -> None:
        """So that there is something to compare with."""

    def twin_an_hour_behind(self) -> None:
        self._with_twin(-HOUR_NS)

    def twin_an_hour_ahead(self) -> None:
        self._with_twin(HOUR_NS)

    def _with_twin(self, ahead_ns: int) -> None:
        twin = Twin(self.session, self.key, ahead_ns)
        self._twins.append(twin)
        self._again(twin.speak, 0.1)

    def guest_that_went(self) -> None:
        guest = Twin(self.session, self.key, HOUR_NS)
        for _ in range(3):
            guest.speak()
        guest.end()

    def one_sample_of_another_run(self) -> None:
        self._forge("forged", 0)

    def one_sample_an_hour_ahead(self) -> None:
        self._forge(self.run, HOUR_NS)

    def clock_an_hour_behind(self) -> None:
        self._again(lambda: self._forge(self.run, -HOUR_NS), 0.05)

    def clock_an_hour_ahead(self) -> None:
        self._again(lambda: self._forge(self.run, HOUR_NS), 0.05)

    def run_after_run(self) -> None:
        self._again(lambda: self._forge(secrets.token_hex(6), HOUR_NS), 0.01)

    def answers_without_the_key(self) -> None:
        done = OrderOutcome(run=self.run, t_ns=time.monotonic_ns(), status="done", code="ok", text="stop: has it")
        data = msgspec.json.encode(done)

        def answer(query: zenoh.Query) -> None:
            with query:
                for _ in range(50):
                    query.reply(shore.command_key(BOAT), data, attachment=bytes(32))

        self._held.append(self.session.declare_queryable(shore.command_key(BOAT), answer, complete=True))

    def questions_kept(self) -> None:
        kept: list[zenoh.Query] = []
        self._held.append(self.session.declare_queryable(shore.command_key(BOAT), kept.append, complete=True))

    def flood_of_orders(self) -> None:
        key = shore.command_key(BOAT)

        def act() -> None:
            for _ in range(ORDERS):
                self.session.get(key, lambda reply: None, payload=b"x" * 300, attachment=bytes(32), timeout=1.0)

        self._again(act, FLOOD_S)

    def flood_of_samples(self) -> None:
        data = shore.encode(state(1, run="flood"))

        def act() -> None:
            for _ in range(SAMPLES):
                self.session.put(shore.telemetry_key(f"spoof-{secrets.randbelow(1000)}", "state"), data)

        self._again(act, FLOOD_S)

    def requests_half_sent(self) -> None:
        for _ in range(SLOW):
            line = socket.create_connection(("127.0.0.1", self.web), timeout=5)
            line.sendall(b"POST /stop HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Slow: ")
            self._held.append(line)


ATTACKS = (
    "nothing", "twin an hour behind", "twin an hour ahead", "guest that went", "one sample of another run",
    "one sample an hour ahead", "clock an hour behind", "clock an hour ahead", "run after run",
    "answers without the key", "questions kept", "flood of orders", "flood of samples", "requests half sent",
)  # fmt: skip


def main(port: str, web: str, run: str) -> None:
    """Attacks by name, until the input ends."""
    attacker = Attacker(int(port), int(web), KEY, run)
    print("ready", flush=True)
    for line in sys.stdin:
        if line.strip() == "end":
            print(attacker.end(), flush=True)
        else:
            attacker.begin(line.strip())
            time.sleep(0.1)
            print("ready", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
