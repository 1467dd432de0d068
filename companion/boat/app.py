"""The boat's program: the only place where devices, clock, solver thread and pure core meet.

    bytes -> Link -> messages -> pilot.step -> outputs -> bytes

Every call of `pilot.step` is logged with its inputs and outputs, so that `aritra replay` can repeat it. Every
tick ends in one lease; should anything in here raise, neutral is sent for a second, the channels are released,
and the process ends non-zero for systemd to start it again.
"""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable, Coroutine, Sequence
from typing import Any

from msgspec.structs import replace

from companion.boat.clock import Clock
from companion.boat.gcs_forward import GcsForward
from companion.boat.position_feed import PositionFeed
from companion.boat.process_stats import ProcessMeter
from companion.boat.recorder import Recorder
from companion.boat.solver_thread import REHEARSAL_S, Solver, SolverThread
from companion.boat.start_interlock import StartInterlock
from companion.core.messages import (
    Alert,
    ImuSample,
    LoopTiming,
    ManualInput,
    Message,
    NewMission,
    OperatorCommand,
    OverrideLease,
    PlanDeadline,
    PlanResult,
    ProcessStats,
    SolveRequest,
    StateEstimate,
    StepMark,
    Tick,
    VehicleRequest,
)
from companion.core.pilot.autopilot_state import AutopilotState, is_alive
from companion.core.pilot.pilot import Pilot, PilotState
from drivers.link import DeviceLink, LinkTiming
from drivers.mavlink.codec import MavlinkCodec
from drivers.mavlink.session import MavlinkSession
from drivers.ports.port import Port
from drivers.uwb import UwbCodec

NEUTRAL_REPEATS = 10
NEUTRAL_PERIOD_S = 0.1
"""Neutral is sent ten times in a second before a release: without a receiver a release changes nothing."""
UWB_STALE_PERIODS = 2.5
UWB_LOST_S = 20.0
"""A tag's cycles jitter, and a DWM1001 takes 5-20 s from opening its port to its first range."""
UWB_RETRY_S = 0.25
"""A tag is plugged in while all else waits for it: its port is tried so often. Assumed."""
IMU_AGE_NS, NUDGE_NS = 4_000_000, 1_000_000
"""Age of the newest IMU bytes that a tick aims at, and how far it moves for that at a time; assumed."""
HOUSEKEEPING_NS = 100_000_000
STATS_NS = 1_000_000_000


class App:
    """One run. `watch` sees every message and output as it happens (progress display, telemetry)."""

    def __init__(
        self,
        pilot: Pilot,
        solver: Solver,
        *,
        mavlink: tuple[Port, MavlinkCodec],
        uwb: tuple[Port, UwbCodec],
        clock: Clock,
        recorder: Recorder,
        rng: random.Random,
        watch: Callable[[Message], None],
        forward: GcsForward | None = None,
        vision_hz: float | None = None,
        guard: StartInterlock | None = None,
    ):
        self.state: PilotState = pilot.initial(clock.now_ns())
        self._pilot, self._clock, self._recorder, self._watch = pilot, clock, recorder, watch
        self._control = pilot.settings.control
        self._codec, self._uwb_codec = mavlink[1], uwb[1]
        self._session = MavlinkSession(self._codec)
        self._mavlink = self._link("mavlink", *mavlink, rng, LinkTiming())
        told = pilot.settings
        self._position = PositionFeed(vision_hz, told.site, told.vessel, self._codec) if vision_hz else None
        self._forward, self._guard = forward, guard
        if forward:
            self._codec.framer.on_frame = forward.show
        self._uwb = self._link("uwb", *uwb, rng, uwb_timing(pilot.settings.vessel.sensors.uwb.rate_Hz))
        self._solver = SolverThread(solver, self._planned)
        self._imu_rx_ns: int | None = None
        self._tick = Tick(t_ns=0, index=-1)
        self._tick_imu_ns: int | None = None
        self._stop = asyncio.Event()
        self._uwb_online = False
        self._solver_stuck = False
        self._failure: Exception | None = None
        self._lease_end_ns = clock.now_ns()

    async def run(self) -> None:
        """Until `stop`; ends with neutral, disarm and a release. Raises what was raised inside, after neutral."""
        try:
            async with asyncio.TaskGroup() as group:
                links = [group.create_task(self._guarded(link.run())) for link in (self._mavlink, self._uwb)]
                if self._forward:
                    station = self._forward.run(self._pass_on, self._note, self._is_disarmed)
                    links.append(group.create_task(self._guarded(station)))
                loops = [group.create_task(self._guarded(loop)) for loop in (self._ticks(), self._housekeeping())]
                await self._stop.wait()
                await self._let_go(loops)
                for task in links:
                    task.cancel()
        finally:
            self._solver.close()
        if self._failure:
            raise self._failure

    def stop(self) -> None:
        """End the run from a signal handler or a task."""
        self._stop.set()

    def command(self, command: OperatorCommand) -> bool:
        """Hand an operator's command to the pilot, once the guard lets it pass; whether the pilot has it now."""
        if self._failure or not (self._guard is None or self._guard.passes(command)):
            return False
        self._step([command], self._clock.now_ns())
        return True

    @property
    def solving(self) -> bool:
        """Whether the solver has a request in hand."""
        return self._solver.busy

    @property
    def refusal(self) -> str | None:
        """Why no command but a stop comes to the pilot; None: it may, or waits for the guard's check."""
        if self._failure:
            return "the run ends after a fault"
        return self._guard.refusal if self._guard else None

    def load(self, mission: NewMission) -> bool:
        """Hand the pilot another mission, unless one is driven; whether it has it now."""
        if self._failure or self.state.helm.on_mission:
            return False
        self._step([mission], self._clock.now_ns())
        return True

    def manual(self, sticks: ManualInput) -> None:
        """Hand sticks to the pilot; they count in manual mode, once they have been at rest (`core.sticks`)."""
        self._step([sticks], self._clock.now_ns())

    # --- what goes wrong ---------------------------------------------------------------------------

    async def _guarded(self, work: Coroutine[Any, Any, None]) -> None:
        """One task; a fault in it leaves the others running until neutral has been sent."""
        try:
            await work
        except Exception as error:
            self._fail(error)

    def _safely(self, call: Callable[..., None], *args: Any) -> None:
        """Call it, unless the run has failed already; what it raises ends the run, safely."""
        if self._failure:
            return
        try:
            call(*args)
        except Exception as error:
            self._fail(error)

    def _fail(self, error: Exception) -> None:
        self._failure = self._failure or error
        self._send(self._codec.encoder.neutral(self._pilot.channels))
        self._stop.set()

    # --- the loop ----------------------------------------------------------------------------------

    async def _ticks(self) -> None:
        """The control period: a tick, then the deadline of its plan, then a rehearsal for the next."""
        period_ns = round(self._control.period_s * 1e9)
        deadline_ns = round(self._control.plan_deadline_s * 1e9)
        due_ns = self._clock.now_ns() + period_ns
        for index in range(1 << 62):
            await self._clock.sleep_until(due_ns)
            now = self._clock.now_ns()
            self._tick = Tick(t_ns=now, index=index, lateness_ns=now - due_ns)
            self._tick_imu_ns = self._imu_rx_ns
            self._step([self._tick], now)
            await self._clock.sleep_until(due_ns + deadline_ns)
            if self.state.open_tick == index:
                now = self._clock.now_ns()
                self._step([PlanDeadline(t_ns=now, index=index)], now)
            due_ns = max(due_ns + period_ns + self._nudge_ns(), self._clock.now_ns())
            await self._clock.sleep_until(due_ns - round(REHEARSAL_S * 1e9))
            self._solver.rehearse()

    def _nudge_ns(self) -> int:
        """Moves the next tick towards `IMU_AGE_NS` after an IMU sample, so that it plans from a fresh one."""
        if self._tick_imu_ns is None:
            return 0
        off_ns = IMU_AGE_NS - (self._tick.t_ns - self._tick_imu_ns)
        return max(-NUDGE_NS, min(NUDGE_NS, off_ns))

    def _planned(self, result: PlanResult) -> None:
        now = self._clock.now_ns()
        self._step([replace(result, t_ns=now)], now)

    def _step(self, inputs: Sequence[Message], t_ns: int) -> None:
        self._safely(self._think, inputs, t_ns)

    def _think(self, inputs: Sequence[Message], t_ns: int) -> None:
        """One logged call of the core, and what follows from it."""
        for message in inputs:
            self._recorder.record(message)
            self._watch(message)
        self._recorder.record(StepMark(t_ns=t_ns, inputs=len(inputs)))
        self.state, outputs = self._pilot.step(self.state, inputs, t_ns)
        for output in outputs:
            if handle := _DISPATCH.get(type(output)):
                handle(self, output)
            self._recorder.record(output)
            self._watch(output)

    # --- outputs -----------------------------------------------------------------------------------

    def _lease(self, lease: OverrideLease) -> None:
        sent = self._send(self._codec.encoder.override(lease))
        now = self._clock.now_ns()
        self._lease_end_ns = now + round(lease.valid_for_s * 1e9)
        age_ms = None if self._tick_imu_ns is None else (now - self._tick_imu_ns) * 1e-6
        lateness_ms = self._tick.lateness_ns * 1e-6
        timing = LoopTiming(t_ns=now, index=lease.index, lateness_ms=lateness_ms, imu_to_override_ms=age_ms, sent=sent)
        self._note(timing)

    def _solve(self, request: SolveRequest) -> None:
        stuck, self._solver_stuck = self._solver_stuck, not self._solver.submit(request)
        if self._solver_stuck and not stuck:
            text = f"tick {request.index}: the solver is still busy with an earlier one"
            self._note(Alert(t_ns=request.t_ns, level="warning", text=text))

    def _ask_vehicle(self, request: VehicleRequest) -> None:
        encoder = self._codec.encoder
        if request.action == "set_mode":
            self._send(encoder.set_mode(request.custom_mode or 0))
        else:
            self._send(encoder.arm() if request.action == "arm" else encoder.disarm())

    def _tell_position(self, estimate: StateEstimate) -> None:
        if self._position:
            restarts, begins = self.state.estimator.restarts, self._session.begins
            for frame in self._position.frames(estimate, restarts=restarts, begins=begins):
                self._send(frame)

    def _note(self, message: Message) -> None:
        self._recorder.record(message)
        self._watch(message)

    def _send(self, data: bytes) -> bool:
        """Whether the port was open for it."""
        if sent := self._mavlink.send(data):
            self._recorder.record_raw("mavlink", "tx", data)
            if self._forward:
                self._forward.show_own(data)
        return sent

    # --- the ground station ------------------------------------------------------------------------

    def _pass_on(self, frame: bytes) -> None:
        if self._mavlink.send(frame):
            self._recorder.record_raw("mavlink", "tx", frame)

    def _is_disarmed(self) -> bool:
        autopilot = self.state.monitor(AutopilotState)
        armed = autopilot.heartbeat is None or autopilot.heartbeat.armed
        return not armed and is_alive(autopilot.heartbeat_ns, self._clock.now_ns())

    # --- devices -----------------------------------------------------------------------------------

    def _link(self, name: str, port: Port, codec: Any, rng: random.Random, timing: LinkTiming) -> DeviceLink:
        hear = self._hear_autopilot if name == "mavlink" else self._think
        return DeviceLink(
            name,
            port,
            codec,
            now_ns=self._clock.now_ns,
            sleep_until=self._clock.sleep_until,
            rng=rng,
            on_messages=lambda messages, t_ns: self._safely(hear, messages, t_ns),
            on_bytes=lambda data, t_ns: self._recorder.record_raw(name, "rx", data),
            timing=timing,
        )

    def _hear_autopilot(self, messages: Sequence[Message], t_ns: int) -> None:
        for message in messages:
            if isinstance(message, ImuSample):
                self._imu_rx_ns = message.t_rx_ns
        self._talk(messages, t_ns)
        self._think(messages, t_ns)

    def _talk(self, messages: Sequence[Message], t_ns: int) -> None:
        for frame in self._session.step(messages, t_ns):
            self._send(frame)
        for alert in self._session.take_alerts():
            self._note(alert)
        if self._guard:
            self._ask_guard(self._guard, messages, t_ns)

    def _ask_guard(self, guard: StartInterlock, messages: Sequence[Message], t_ns: int) -> None:
        """Its questions to the autopilot, what it says, and the command that waited for it."""
        for frame in guard.step(messages, t_ns):
            self._send(frame)
        for alert in guard.take_alerts():
            self._note(alert)
        if command := guard.take_command():
            self._step([replace(command, t_ns=t_ns)], t_ns)

    async def _housekeeping(self) -> None:
        """What goes on in silence: neutral after a lease, the session, the tag's shell, figures, the log."""
        meter = ProcessMeter()
        stats_due_ns = self._clock.now_ns() + STATS_NS
        told: str | None = None
        while True:
            now = self._clock.now_ns()
            if now >= self._lease_end_ns:
                self._send(self._codec.encoder.neutral(self._pilot.channels))
            self._talk((), now)
            self._talk_to_tag(now)
            if now >= stats_due_ns:
                stats_due_ns = now + STATS_NS
                cpu_percent, rss_mb = meter.read(now)
                self._note(ProcessStats(t_ns=now, cpu_percent=cpu_percent, rss_mb=rss_mb))
            if self._recorder.problem and self._recorder.problem != told:
                told = self._recorder.problem
                self._watch(Alert(t_ns=now, level="error", text=told))
            await self._clock.sleep_until(now + HOUSEKEEPING_NS)

    def _talk_to_tag(self, t_ns: int) -> None:
        online, self._uwb_online = self._uwb_online, self._uwb.is_open
        opened = self._uwb_online and not online
        for data in (self._uwb_codec.start_bytes() if opened else []) + self._uwb_codec.step(t_ns):
            if self._uwb.send(data):
                self._recorder.record_raw("uwb", "tx", data)

    async def _let_go(self, loops: Sequence[asyncio.Task[None]]) -> None:
        """Neutral for a second, disarm, and only then hand the channels back; nothing takes them again."""
        self.command(OperatorCommand(t_ns=self._clock.now_ns(), command="stop"))
        for _ in range(NEUTRAL_REPEATS):
            self._send(self._codec.encoder.neutral(self._pilot.channels))
            await self._clock.sleep_until(self._clock.now_ns() + round(NEUTRAL_PERIOD_S * 1e9))
        for task in loops:
            task.cancel()
        self._send(self._codec.encoder.disarm())
        self._send(self._codec.encoder.release(self._pilot.channels))
        await self._clock.sleep_until(self._clock.now_ns() + round(NEUTRAL_PERIOD_S * 1e9))  # let them leave


def uwb_timing(rate_hz: float) -> LinkTiming:
    """When a tag that measures at `rate_hz` counts as stale and as lost."""
    stale_s = max(LinkTiming().stale_after_s, UWB_STALE_PERIODS / rate_hz)
    lost_s = max(UWB_LOST_S, 2 * stale_s)
    return LinkTiming(stale_after_s=stale_s, lost_after_s=lost_s, backoff_max_s=UWB_RETRY_S)


_DISPATCH: dict[type[Message], Callable[[App, Any], None]] = {
    OverrideLease: App._lease,
    SolveRequest: App._solve,
    StateEstimate: App._tell_position,
    VehicleRequest: App._ask_vehicle,
}
