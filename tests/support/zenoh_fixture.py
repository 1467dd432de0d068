"""Zenoh in tests: routers and consoles on explicit loopback ports, nothing listens elsewhere, nothing scouts."""

from __future__ import annotations

import contextlib
import json
import socket
import time

import zenoh

from companion.core.telemetry import structs as shore
from companion.shore.subscriber import listen


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def config(mode, *, connect=(), listen=(), file=None, **more):
    made = zenoh.Config.from_file(str(file)) if file else zenoh.Config()
    told = {
        "mode": mode,
        "connect/endpoints": list(connect),
        "listen/endpoints": list(listen),
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        **more,
    }
    for key, value in told.items():
        made.insert_json5(key, json.dumps(value))
    return made


def router(port):
    return zenoh.open(config("router", listen=[f"tcp/127.0.0.1:{port}"]))


class Console:
    """A shore: what it heard, in the order of arrival and each once, as (topic, struct)."""

    def __init__(self, session, boat="*"):
        self.session, self.heard, self.sender = session, [], None
        self._known, self._alive = set(), set()
        self._held = listen(session, self._hear, boat=boat, reach=self._reach)

    def _hear(self, sample):
        topic = str(sample.key_expr).rsplit("/", 1)[1]
        data = bytes(sample.payload)
        told = shore.decode(topic, data)
        if data not in self._known:
            self._known.add(data)
            self.heard.append((topic, told))
        if self.sender:
            self.sender.hear(told.run, told.t_ns)

    def _reach(self, boat, there):
        (self._alive.add if there else self._alive.discard)(shore.alive_key(boat))

    def of(self, topic):
        return [told for name, told in list(self.heard) if name == topic]

    def last_values(self, boat="*"):
        replies = self.session.get(shore.telemetry_key(boat, "*"), timeout=5.0)
        return {str(r.ok.key_expr).rsplit("/", 1)[1]: bytes(r.ok.payload) for r in replies if r.ok}

    def alive(self):
        """Keys of the boats that are in reach."""
        return set(self._alive)


@contextlib.contextmanager
def console(port, **options):
    with zenoh.open(config("client", connect=[f"tcp/127.0.0.1:{port}"])) as session:
        yield Console(session, **options)


def wait_for(condition, seconds=20.0, what=lambda: ""):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if result := condition():
            return result
        time.sleep(0.02)
    raise AssertionError(f"not within {seconds} s: {what()}")
