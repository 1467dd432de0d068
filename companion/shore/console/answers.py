"""What comes back of an order, and how it is asked for: the interface between orders and the network."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from typing import NamedTuple, Protocol

from companion.core.telemetry.order_gate import OrderOutcome
from companion.core.telemetry.order_sender import Place, SealedOrder, Sender

Believe = Callable[[bytes, bytes, bytes | None], OrderOutcome | None]
"""believe(order, reply, attachment): the boat's answer, or None: not signed by it. Called on any thread."""


class OrderAnswer(NamedTuple):
    """One answer. `proven`: by the boat's key, where it has one; others are anybody's."""

    outcome: OrderOutcome
    proven: bool


class Ask(Protocol):
    """Puts an order to all programs that answer under a boat's name."""

    def __call__(self, boat: str, order: SealedOrder, timeout_s: float, believe: Believe) -> AsyncIterator[OrderAnswer]:
        """Their answers as they come, until all have answered or time is up."""
        ...


class Boats(Protocol):
    """What is known of boats, by name."""

    def sender(self, boat: str) -> Sender | str:
        """The maker of its orders, or why there is none."""
        ...

    def place(self, boat: str) -> Place | None:
        """Run and clock by its telemetry; None: not known."""
        ...

    def runs(self, boat: str) -> tuple[str, ...]:
        """Runs that its telemetry shows at present."""
        ...
