"""From the sticks of a page to signed samples for the boat that was given to it. Pure: time and boats are arguments.

    page, 20 a second        StickPlace over the WebSocket, stamped by the page on the console's clock as it knows it
    console                  is this page the one that took the sticks? is it fresh? -> signed, for the boat's own clock
    boat                     `core.telemetry.sticks`, and the pilot's dead man

The stamp is that of the hands, all the way: what stood in a queue, of the browser, of TCP, of the radio, is old when it
arrives, and moves nothing. A page knows the console's clock by its frames, which were under way for a while: it errs to
the old side. When a page leaves, the console says at once that nobody holds the sticks any more.
"""

from __future__ import annotations

from typing import NamedTuple

from companion.core.telemetry.order_sender import Place, SealedOrder
from companion.shore.console.answers import Boats
from companion.shore.console.orders import SentOrder
from companion.shore.console.requests import StickPlace

FRESH_MS, AHEAD_MS = 300.0, 50.0
"""How old a place of the sticks may be when it comes in, and how far ahead of the console's clock (assumed)."""


class SticksTaken(NamedTuple):
    """Who drives a boat: a page, by the number of its order, and the run of the boat's program that took it."""

    page: str
    order: int
    run: str


class SticksDesk:
    """Which page drives which boat. `late`: places of sticks that came too late to be sent."""

    def __init__(self, boats: Boats) -> None:
        self.late = 0
        self._boats = boats
        self._taken: dict[str, SticksTaken] = {}

    def note(self, order: SentOrder, page: str | None) -> None:
        """Word of an order of `page`: `manual`, once the boat has it, gives the sticks to that page; any other that
        drives or stops takes them from everybody, as soon as it is given.
        """
        known = self._taken.get(order.boat)
        if order.command == "load_mission" or (known and known.order > order.number):
            return
        if order.command != "manual":
            self._taken.pop(order.boat, None)
        elif page and order.state == "answered" and order.outcome and order.outcome.status != "refused":
            self._taken[order.boat] = SticksTaken(page, order.number, order.outcome.run)

    def drives(self, page: str, boat: str) -> bool:
        """Whether a page has the sticks of a boat."""
        return (known := self._taken.get(boat)) is not None and known.page == page

    def sealed(self, place: StickPlace, now_ms: float) -> SealedOrder | None:
        """The signed sample; None: not this page's boat, too late, or nothing that could be signed."""
        if not self.drives(place.page, place.boat):
            return None
        if not -AHEAD_MS <= now_ms - place.t_ms <= FRESH_MS:
            self.late += 1
            return None
        return self._seal(place, now_ms - min(place.t_ms, now_ms))

    def let_go(self, page: str, boat: str) -> SealedOrder | None:
        """The sample that says that nobody holds the sticks, for a page that has left."""
        if not self.drives(page, boat):
            return None
        return self._seal(StickPlace(page=page, boat=boat, t_ms=0.0, held=False, surge=0.0, sway=0.0, yaw=0.0), 0.0)

    def _seal(self, place: StickPlace, age_ms: float) -> SealedOrder | None:
        sender, now = self._boats.sender(place.boat), self._boats.place(place.boat)
        if isinstance(sender, str) or now is None or now.run != self._taken[place.boat].run:
            return None
        at = Place(now.run, now.t_ns - round(age_ms * 1e6))
        return sender.sticks(at, held=place.held, surge=place.surge, sway=place.sway, yaw=place.yaw)
