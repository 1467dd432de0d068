"""Drive to a point: a mission of one waypoint and its start, as orders that go one after the other.

    hold (where a mission is driven)  ->  load_mission  ->  start

Each goes when the boat has done the one before. The start is left out where one before it was not done, where anybody
gave the boat another order meanwhile, and when it took too long; it goes to the run that took the mission, for another
one would drive its own.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

from companion.core.telemetry.order_gate import Command, MissionFile
from companion.shore.console.orders import Orders, SentOrder

TOGETHER_S = 10.0
"""How long after the click a start may still be given: who clicked is still looking (assumed)."""
LEAVING: tuple[Command, ...] = ("hold", "load_mission", "start")
"""What is sent to a boat that drives a mission; to another: all but the first."""


async def drive_there(orders: Orders, first: SentOrder, mission: MissionFile, commands: Sequence[Command]) -> None:
    """Give `commands`, of which `first` is begun already. What was not done is told with the order."""
    end_s, order, run = time.monotonic() + TOGETHER_S, first, None
    for command in commands:
        if order.command != command:
            order = orders.begin(first.boat, command)
        await orders.send(order, mission if command == "load_mission" else None, run)
        if command == commands[-1]:
            return
        if why := _broken_off(orders, order, end_s):
            return orders.end(orders.begin(first.boat, commands[-1]), "not_sent", why)
        run = order.outcome.run if order.outcome else None


def _broken_off(orders: Orders, order: SentOrder, end_s: float) -> str:
    """Why nothing comes after this order; empty: what comes next may go."""
    if orders.newest(order.boat) is not order:
        return "another order was given to the boat meanwhile"
    if order.state != "answered" or order.outcome is None or order.outcome.status != "done":
        return f"{order.command} was not done"
    if time.monotonic() > end_s:
        return f"it took longer than {TOGETHER_S:g} s"
    return ""
