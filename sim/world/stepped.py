"""Boat and world in one process on a stepped clock: the same bytes as in real time, as fast as they compute.

    world bytes -> codecs -> messages -> pilot.step -> outputs -> codec -> bytes -> world

A plan arrives `PLAN_NS` after its tick, as if it had been solved that fast. Nothing else is simplified: what the
pilot sees has gone through the wire formats. `record` is told what the boat's own program writes into its log.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from typing import Any, Literal, Protocol

from msgspec.structs import replace

from companion.boat.tick_timing import TickTiming
from companion.core.messages import (
    GroundTruth,
    Message,
    OperatorCommand,
    OverrideLease,
    PlanDeadline,
    PlanResult,
    SolveRequest,
    StepMark,
    VehicleRequest,
)
from companion.core.pilot.pilot import Pilot
from drivers.devices import DEVICES, devices_of
from drivers.mavlink.codec import MavlinkCodec
from drivers.mavlink.session import MavlinkSession
from drivers.mavlink.streams import wanted_hz
from sim.world.world import STEP_NS, Outgoing

PEER = "companion"
PLAN_NS = 10_000_000
SESSION_STEPS = 10
Record = Callable[[Message, int], None]
"""Told a message and when it was in simulated time [ns]."""


class SteppedWorld(Protocol):
    """What a stepped run asks of a world: `World`, or a real firmware in it (`FirmwareWorld` of the tests)."""

    @property
    def t_ns(self) -> int:
        """Simulated time [ns]."""
        ...

    def step(self) -> Outgoing:
        """One step on; the bytes that are due."""
        ...

    def add_peer(self, peer: Hashable) -> None:
        """A MAVLink peer is there."""
        ...

    def mavlink(self, data: bytes, peer: Hashable) -> bytes:
        """Bytes to the autopilot; what it answers at once."""
        ...

    def uwb(self, data: bytes) -> bytes:
        """Bytes to the UWB tag; its answer."""
        ...

    def truth(self) -> GroundTruth:
        """What really is."""
        ...


class SteppedRun:
    """One boat under way. `messages`: everything in, out and true, in order. `solve(request, warm)`: the NMPC.

    `begin`: what the operator asks for at the start, mission or excitation; None: nothing yet. `record` is told all of
    `messages` and the notes that belong into a log: a StepMark for each call of the pilot, a LoopTiming for each lease.
    """

    def __init__(
        self,
        world: SteppedWorld,
        pilot: Pilot,
        solve: Callable[[SolveRequest, Any], tuple[PlanResult, Any]],
        begin: Literal["start", "excite"] | None = "start",
        record: Record = lambda _message, _t_ns: None,
    ):
        sensors = pilot.settings.vessel.sensors
        self.world, self.pilot = world, pilot
        self.messages: list[Message] = []
        self.state = pilot.initial(world.t_ns)
        self._solve, self._warm, self._record = solve, None, record
        self._codec = MavlinkCodec()
        self._session = MavlinkSession(self._codec, wanted_hz(sensors))
        names = {"uwb": "tag"}
        self._devices = {key: DEVICES[key].codec(sensors, names.get(key, key)) for key in devices_of(sensors)}
        self._period_ns = round(pilot.settings.control.period_s * 1e9)
        self._deadline_ns = round(pilot.settings.control.plan_deadline_s * 1e9)
        self._timing = TickTiming(self._period_ns)
        self._tick = -1
        self._tick_due_ns = world.t_ns + self._period_ns
        self._plans: list[PlanResult] = []
        self._deadline: PlanDeadline | None = None
        world.add_peer(PEER)
        for key, codec in self._devices.items():
            self._say(key, codec.start_bytes())
        if begin:
            self.feed([OperatorCommand(t_ns=world.t_ns, command=begin)])

    def run(self, until: Callable[[SteppedRun], bool], limit_s: float) -> bool:
        """Step until `until(self)` or `limit_s` of simulated time; whether the former."""
        end_ns = self.world.t_ns + round(limit_s * 1e9)
        while self.world.t_ns < end_ns:
            self.step()
            if until(self):
                return True
        return False

    def step(self) -> None:
        """One step of the world, and whatever of the boat's falls due in it."""
        outgoing = self.world.step()
        t_ns = self.world.t_ns
        for peer, data in outgoing.mavlink:
            if peer == PEER:
                self._hear_autopilot(data)
        for key, data in {"uwb": outgoing.uwb, **outgoing.devices}.items():
            self._hear_device(key, data)
        if (t_ns // STEP_NS) % SESSION_STEPS == 0:
            self._send_all(self._session.step((), t_ns))
            for key, codec in self._devices.items():
                self._say(key, codec.step(t_ns))
        if t_ns >= self._tick_due_ns:
            self._begin_tick(t_ns)
        self._end_tick(t_ns)

    def stall(self, seconds: float) -> None:
        """The companion stands still for so long; then all that has queued up meanwhile arrives at once."""
        end_ns = self.world.t_ns + round(seconds * 1e9)
        mavlink, devices = b"", dict.fromkeys(self._devices, b"")
        while self.world.t_ns < end_ns:
            outgoing = self.world.step()
            mavlink += b"".join(data for peer, data in outgoing.mavlink if peer == PEER)
            for key, data in {"uwb": outgoing.uwb, **outgoing.devices}.items():
                devices[key] = devices.get(key, b"") + data
        self._hear_autopilot(mavlink)
        for key, data in devices.items():
            self._hear_device(key, data)
        self._tick_due_ns = self.world.t_ns

    def feed(self, inputs: Sequence[Message]) -> None:
        """One call of the pilot, and what follows from it."""
        self._keep(inputs)
        self._record(StepMark(t_ns=self.world.t_ns, inputs=len(inputs)), self.world.t_ns)
        self.state, outputs = self.pilot.step(self.state, inputs, self.world.t_ns)
        self._keep(outputs)
        for output in outputs:
            self._do(output)

    def of(self, kind: type) -> list[Any]:
        """All messages of one kind so far."""
        return [m for m in self.messages if isinstance(m, kind)]

    def _keep(self, messages: Sequence[Message]) -> None:
        self.messages += messages
        for message in messages:
            self._record(message, self.world.t_ns)

    def _begin_tick(self, t_ns: int) -> None:
        self._tick += 1
        self._tick_due_ns += self._period_ns
        self._keep([self.world.truth()])
        self._deadline = PlanDeadline(t_ns=t_ns + self._deadline_ns, index=self._tick)
        self.feed([self._timing.begin(self._tick, due_ns=t_ns, now_ns=t_ns)])

    def _end_tick(self, t_ns: int) -> None:
        if self._plans and t_ns >= self._plans[0].t_ns:
            self.feed([self._plans.pop(0)])
        if self._deadline and t_ns >= self._deadline.t_ns:
            late, self._deadline = self._deadline, None
            if self.state.open_tick == late.index:
                self.feed([late])

    def _do(self, output: Message) -> None:
        encoder = self._codec.encoder
        if isinstance(output, SolveRequest):
            plan, self._warm = self._solve(output, self._warm)
            self._plans.append(replace(plan, t_ns=output.t_ns + PLAN_NS))
        elif isinstance(output, OverrideLease):
            self._record(self._timing.of_lease(output, self.world.t_ns, sent=True), self.world.t_ns)
            self._send_all([encoder.override(output)])
        elif isinstance(output, VehicleRequest) and output.action == "set_mode":
            self._send_all([encoder.set_mode(output.custom_mode or 0)])
        elif isinstance(output, VehicleRequest):
            self._send_all([encoder.arm() if output.action == "arm" else encoder.disarm()])

    def _send_all(self, frames: Sequence[bytes]) -> None:
        for frame in frames:
            self._hear_autopilot(self.world.mavlink(frame, PEER))

    def _hear_autopilot(self, data: bytes) -> None:
        if not data:
            return
        messages = self._codec.feed(data, self.world.t_ns)
        self._timing.hear(messages)
        frames = self._session.step(messages, self.world.t_ns)
        if messages:
            self.feed(messages)
        self._send_all(frames)

    def _say(self, key: str, words: Sequence[bytes]) -> None:
        """Bytes to a device; only the tag answers."""
        for data in words:
            self._hear_device(key, self.world.uwb(data) if key == "uwb" else b"")

    def _hear_device(self, key: str, data: bytes) -> None:
        if data and (messages := self._devices[key].feed(data, self.world.t_ns)):
            self.feed(messages)
