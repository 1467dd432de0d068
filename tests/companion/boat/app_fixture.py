"""The App on memory ports and a stepped clock, the simulated world at the far end of its cables."""

from __future__ import annotations

import asyncio
import random
from collections import Counter
from itertools import groupby, pairwise

from pymavlink.dialects.v20 import ardupilotmega as wire

from companion.boat.app import App
from companion.boat.recorder import Recorder
from companion.core.messages import Alert, LinkStatus, OperatorCommand, Tick
from companion.logs.metadata import log_metadata
from drivers.mavlink.codec import MavlinkCodec
from drivers.uwb import uwb_codec
from sim.world.world import STEP_NS, World, WorldSetup
from tests.support.drive_fixture import START, nmpc, pilot, setup
from tests.support.stand_ins.memory_port import memory_pair
from tests.support.stand_ins.sim_clock import SimClock

S = 1_000_000_000
THRUSTERS = (9, 10, 11, 12)


class Bench:
    """`sent`: (t_ns, MAVLink message) that left the boat; `seen`: what the App's watcher saw."""

    def __init__(
        self, path, solver=None, seed=21, mind=None, codec=None, station=None, vision_hz=None, guard=None, begin_ns=S,
        **world,
    ):  # fmt: skip
        self.clock = SimClock(begin_ns)
        told = setup().pilot
        self.mind = mind or pilot()
        self.world = World(WorldSetup(told.vessel, told.site, start=START, boot_ns=begin_ns, **world), seed)
        self.recorder = Recorder(
            path, log_metadata("aritra", setup().files), self.clock.now_ns, wall_offset_ns=0, background=False
        )
        self.sent, self.seen, self.deaf, self.answering = [], [], False, True
        self.garbage = b""
        self.on_watch = None
        near, self.far = memory_pair("autopilot")
        tag, self.far_tag = memory_pair("tag")
        uwb = told.vessel.sensors.uwb
        self.codec = codec or MavlinkCodec()
        self.tag_codec = uwb_codec(uwb.wire_format, "tag", uwb.rate_Hz)
        self.app = App(
            self.mind, solver or nmpc(), mavlink=(near, self.codec),
            devices={"uwb": (tag, self.tag_codec)}, clock=self.clock, recorder=self.recorder, rng=random.Random(3),
            watch=self._watch,
            forward=station and station(self.clock), vision_hz=vision_hz,
            guard=guard and guard(self.codec),
        )  # fmt: skip
        self._parser = wire.MAVLink(None)
        self._parser.robust_parsing = True

    def scene(self, story):
        """Run `story(bench)` beside the App until it ends; what the App raised, or None. Closes the log."""

        async def play():
            running = asyncio.create_task(self.app.run())
            self.ends = ends = [asyncio.create_task(self._autopilot()), asyncio.create_task(self._tag())]
            self.running = running
            try:
                await story(self)
                self.app.stop()
                await self.run(3.0, until=running.done)
                assert running.done(), "the app did not end"
                return asyncio.CancelledError() if running.cancelled() else running.exception()
            finally:
                running.cancel()
                await asyncio.sleep(0)  # it lets go of the boat, for which this clock must not be waited for
                for task in (running, *ends):
                    task.cancel()
                await asyncio.gather(running, *ends, return_exceptions=True)

        with self.recorder:
            return asyncio.run(play())

    async def run(self, seconds, until=lambda: False):
        """Advance world and clock; whether `until` became true."""
        for _ in range(round(seconds * S / STEP_NS)):
            outgoing = self.world.step()
            if not self.deaf:
                for _, data in outgoing.mavlink:
                    self._give(self.far, data)
            self._give(self.far_tag, self.garbage or outgoing.uwb)
            await self.clock.advance(STEP_NS)
            if self.app.solving:
                await asyncio.sleep(0.0005)  # a solve in the thread has a moment, too
            if until():
                return True
        return False

    async def drive(self, limit_s=20.0):
        """Start and go on until under way."""
        self.app.command(OperatorCommand(t_ns=self.clock.now_ns(), command="start"))
        assert await self.run(limit_s, until=lambda: self.mode == "auto"), self.app.state.helm
        await self.run(1.0)

    @property
    def mode(self):
        return self.app.state.helm.mode

    @property
    def overrides(self):
        """(t_ns, channels 1-12 [us]) of every override on the wire."""
        found = [(t_ns, m) for t_ns, m in self.sent if m.get_type() == "RC_CHANNELS_OVERRIDE"]
        return [(t_ns, tuple(getattr(m, f"chan{n}_raw") for n in range(1, 13))) for t_ns, m in found]

    def of(self, kind):
        return [m for m in self.seen if isinstance(m, kind)]

    def links(self, name):
        """States of a link, each once as long as it lasts."""
        return [state for state, _ in groupby(m.state for m in self.of(LinkStatus) if m.link == name)]

    def alerts(self):
        return Counter(m.text for m in self.of(Alert))

    def leases_per_tick(self):
        """How many overrides lie between one tick and the next, all but the last."""
        starts = [m.t_ns for m in self.of(Tick)]
        when = [t_ns for t_ns, _ in self.overrides]
        return [sum(a <= t < b for t in when) for a, b in pairwise(starts)]

    # --- the far ends ------------------------------------------------------------------------------

    async def _autopilot(self):
        async for data in received(self.far):
            self.sent += [
                (self.clock.now_ns(), m) for m in self._parser.parse_buffer(data) or [] if m.get_type() != "BAD_DATA"
            ]
            if self.answering:
                self._give(self.far, self.world.mavlink(data, "boat"))

    async def _tag(self):
        async for data in received(self.far_tag):
            self._give(self.far_tag, self.world.uwb(data))

    def _give(self, port, data):
        if data and port.other.is_open and port.is_open and not port.has_ended:
            port.send(data)

    def _watch(self, message):
        self.seen.append(message)
        if self.on_watch:
            self.on_watch(message)


async def received(port):
    """Chunks from a port that is plugged in again whenever the other end leaves."""
    while True:
        await port.open()
        while data := await port.receive():
            yield data
        await port.close()
        await asyncio.sleep(0)


def neutral(channels):
    return channels == (1500,) * 4 + (65535,) * 4 + (1500,) * 4


def released(channels):
    return channels == (0,) * 4 + (65535,) * 4 + (65534,) * 4
