"""Bugs that are put into the shell: each breaks one part of a bench. `patch`: pytest's MonkeyPatch."""

from __future__ import annotations

from companion.core.messages import Tick
from drivers.mavlink.session import MavlinkSession


def fail_in_watch(bench, patch):
    def watch(message):
        if isinstance(message, Tick):
            raise ValueError("a bug in what watches")

    bench.on_watch = watch


def fail_in_encoder(bench, patch):
    def override(lease):
        raise ValueError("a bug in a driver")

    bench.codec.encoder.override = override


def fail_in_session(bench, patch):
    def step(session, messages, t_ns):
        raise ValueError("a bug in the session")

    patch.setattr(MavlinkSession, "step", step)


def fail_in_tag(bench, patch):
    def feed(data, t_ns):
        raise ValueError("a bug in a codec")

    bench.tag_codec.feed = feed


def fail_in_codec(bench, patch):
    def feed(data, t_ns):
        raise ValueError("a bug in the autopilot's codec")

    bench.codec.feed = feed


def fail_in_log_of_what_is_sent(bench, patch):
    def record_raw(link, direction, data):
        if direction == "tx":
            raise ValueError("a bug in the recorder")

    bench.recorder.record_raw = record_raw


def fail_in_log_of_what_is_heard(bench, patch):
    def record_raw(link, direction, data):
        if direction == "rx":
            raise ValueError("a bug in the recorder")

    bench.recorder.record_raw = record_raw


def fail_in_port(bench, patch):
    near, send, failures = bench.far.other, bench.far.other.send, [ValueError("a bug in the port")]

    def broken(data):
        if failures:
            raise failures.pop()
        send(data)

    patch.setattr(near, "send", broken)


def fail_in_receiving(bench, patch):
    """The link ends, and with it its port."""
    near, receive, failures = bench.far.other, bench.far.other.receive, [ValueError("a bug in the port")]

    async def broken():
        data = await receive()
        if failures:
            raise failures.pop()
        return data

    patch.setattr(near, "receive", broken)


IN_THE_SHELL = [
    (fail_in_watch, False), (fail_in_encoder, True), (fail_in_session, False), (fail_in_tag, False),
    (fail_in_codec, True), (fail_in_log_of_what_is_sent, True), (fail_in_log_of_what_is_heard, True),
    (fail_in_port, True), (fail_in_receiving, True),
]  # fmt: skip
"""Fault, and whether the boat drives when it comes."""
