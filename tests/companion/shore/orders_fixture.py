"""Boats that answer orders without a network, and what a console knows of them."""

import asyncio
from dataclasses import dataclass, field

import msgspec

from companion.core.telemetry.order_gate import OrderGate, OrderOutcome, OrderRefused, Repeated, read_outcome
from companion.core.telemetry.order_sender import Place, Sender
from companion.shore.console import orders as module
from companion.shore.console.answers import OrderAnswer
from companion.shore.console.orders import Orders

S = 1_000_000_000
KEY = bytes(range(32))


def impatient(monkeypatch, command, seconds=0.1):
    monkeypatch.setitem(module.PATIENCE_S, command, seconds)


class Boat:
    """A program that answers as a boat does. `deaf`: to the first so many; `slow`: they are on their way meanwhile;
    `away_s`: how long an order takes to it.
    """

    away_s = 0.0

    def __init__(self, run="run", *, key=KEY, deaf=0, slow=0, now_ns=1_000 * S):
        self.gate, self.run, self.deaf, self.slow, self.now_ns = OrderGate("b", run, key), run, deaf, slow, now_ns
        self.heard, self.obeyed, self.met = [], [], set()

    def answer(self, payload, attachment):
        """Reply and seal, or None."""
        self.heard.append((payload, attachment))
        if self.deaf:
            self.deaf -= 1
            return None
        reply = self.reply(payload, attachment)
        if reply is None:
            return None
        return reply, self.gate.answer_seal(payload, reply) if self.gate.proves(payload, attachment) else None

    def reply(self, payload, attachment):
        try:
            order = self.gate.judge(payload, attachment, self.now_ns)
        except Repeated as again:
            if again.outcome is None or self.slow:
                self.slow -= 1
                return self.outcome("waiting", "busy", "on its way", repeated=True)
            return msgspec.json.encode(msgspec.structs.replace(again.outcome, repeated=True))
        except OrderRefused as no:
            return self.outcome("refused", no.code, no.text)
        self.met |= set(order.heard) - {self.run}
        if order.command == "hello":
            return self.outcome("done", "ok", "here")
        self.obeyed.append(order)
        reply = self.outcome("done", "ok", f"{order.command}: the pilot has it")
        self.gate.finish(order, read_outcome(reply))
        return None if self.slow else reply

    def outcome(self, status, code, text, repeated=False):
        told = {"status": status, "code": code, "text": text, "repeated": repeated}
        return msgspec.json.encode(OrderOutcome(run=self.run, t_ns=self.now_ns, **told))

    @property
    def commands(self):
        return [order.command for order in self.obeyed]


class Stranger:
    """Answers everything with `done`, without the key; `never`: or takes the question and says nothing."""

    away_s = 0.0

    def __init__(self, never=False):
        self.never = never

    def answer(self, payload, attachment):
        if self.never:
            return None
        done = OrderOutcome(run="evil", t_ns=5, status="done", code="ok", text="stop: the pilot has it")
        return msgspec.json.encode(done), bytes(32)


@dataclass
class Water:
    """All programs of the name `b`, and what the console's store says of them."""

    programs: list = field(default_factory=lambda: [Boat()])
    key: bytes | str = KEY
    by_telemetry: Place | None = field(default_factory=lambda: Place("run", 1_000 * S))
    runs_heard: tuple = ("run",)

    def __post_init__(self):
        self.maker = self.key if isinstance(self.key, str) else Sender("b", "session-1", "anna", self.key, lambda: 0)
        self.told = []
        self.orders = Orders(self, self.ask, lambda given: self.told.append(msgspec.structs.replace(given)))

    def sender(self, boat):
        return self.maker

    def place(self, boat):
        return self.by_telemetry

    def runs(self, boat):
        return self.runs_heard

    async def ask(self, boat, order, timeout_s, believe):
        assert boat == "b" and 0 < timeout_s <= module.ANSWER_S
        sent = [asyncio.ensure_future(self.reach(program, order)) for program in self.programs]
        for program in sent:
            answered = await asyncio.shield(program)  # what is under way arrives, whoever waits for its answer
            if answered is None:
                continue
            reply, sealed = answered
            believed = believe(order.payload, reply, sealed)
            yield OrderAnswer(believed or read_outcome(reply), proven=believed is not None)

    @staticmethod
    async def reach(program, order):
        await asyncio.sleep(program.away_s)
        return program.answer(*order)

    def give(self, command="stop", mission=None):
        return asyncio.run(self.orders.give("b", command, mission))
