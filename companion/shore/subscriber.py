"""Subscription to boats: what they publish, and the cache of what was published before or during a loss.

    live    AdvancedSubscriber with recovery: notices by sequence numbers what it missed, and asks the boat for it
    kept    each time a boat comes into reach (its liveliness token appears): one `get` of its publishers' caches

Not the AdvancedSubscriber's own `history`: up to zenoh-ext 1.10 it delivers a live sample that comes before the first
old one, and then drops all older ones as out of date. At 10 Hz that cost 3 of 120 consoles their history of a topic, on
a loopback, and a few of those that were opened just after an outage; so, 0 of 100 (measured).
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable

import zenoh
from zenoh import ext
from zenoh.handlers import Callback

from companion.core.telemetry import structs as shore

KEPT_S = 20.0
"""Timeout of a query of a boat's cache [s]: about 1 MB over a slow radio; assumed."""


def listen(
    session: zenoh.Session,
    on_sample: Callable[[zenoh.Sample], None],
    *,
    boat: str = "*",
    topic: str = "*",
    reach: Callable[[str, bool], None] = lambda boat, is_alive: None,
) -> list[object]:
    """Subscribe to all boats while the returned object lives. Both functions are called on zenoh's threads.

    `on_sample`: samples come in any order, and some twice (same `run` and `t_ns`). `reach`: a boat appeared or
    disappeared. Ask for liveliness in no other way in this session: zenoh 1.10 often answers a `get` with nothing
    where a subscriber has just asked for the same (112 of 120, measured), but always notifies a subscriber.
    """
    key = shore.telemetry_key(boat, topic)
    recovery = ext.RecoveryConfig(heartbeat=True, periodic_queries=None)
    live = ext.declare_advanced_subscriber(session, key, Callback(on_sample), recovery=recovery)

    def kept(reply: zenoh.Reply) -> None:
        if reply.ok:
            on_sample(reply.ok)

    def in_reach(token: zenoh.Sample) -> None:
        name, is_alive = str(token.key_expr).split("/")[1], token.kind == zenoh.SampleKind.PUT
        reach(name, is_alive)
        if is_alive:
            with contextlib.suppress(zenoh.ZError, RuntimeError):  # the session closes
                session.get(
                    f"{shore.telemetry_key(name, topic)}/@adv/pub/**",
                    Callback(kept),
                    target=zenoh.QueryTarget.ALL,
                    consolidation=zenoh.ConsolidationMode.NONE,
                    accept_replies=zenoh.ReplyKeyExpr.ANY,
                    timeout=KEPT_S,
                )

    tokens = session.liveliness().declare_subscriber(shore.alive_key(boat), Callback(in_reach), history=True)
    return [live, tokens]
