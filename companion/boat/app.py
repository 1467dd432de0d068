"""The boat's program: the only place where devices, clock, solver thread and pure core meet.

    bytes -> Link -> messages -> pilot.step -> outputs -> bytes

Every call of `pilot.step` is logged with its inputs and outputs, so that `aritra replay` can repeat it. Every
tick ends in one lease; should anything in here raise, whatever it is, neutral is sent for a second, the autopilot is
disarmed, the channels are released, and the process ends non-zero for systemd to start it again.
"""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from msgspec.structs import replace

from companion.boat.clock import Clock
from companion.boat.devices.autopilot_commands import NEUTRAL_PERIOD_S, AutopilotCommands
from companion.boat.devices.sensor_device import SensorDevice, device_timing
from companion.boat.fault_barrier import FaultBarrier, GuardedCodec
from companion.boat.gcs_forward import GcsForward
from companion.boat.position_feed import PositionFeed
from companion.boat.process_stats import ProcessMeter
from companion.boat.recorder import Recorder, RecordingAlerts
from companion.boat.solver_thread import REHEARSAL_S, Solver, SolverThread
from companion.boat.start_interlock import WAITS_S, StartInterlock
from companion.boat.tick_timing import TickTiming
from companion.core.messages import (
    Alert,
    ManualInput,
    Message,
    NewMission,
    OperatorCommand,
    OverrideLease,
    PlanDeadline,
    PlanResult,
    SolveRequest,
    StateEstimate,
    StepMark,
    VehicleRequest,
)
from companion.core.pilot.autopilot_state import AutopilotState, is_alive
from companion.core.pilot.pilot import Pilot, PilotState
from drivers.devices import DeviceCodec
from drivers.link import DeviceLink, LinkTiming
from drivers.mavlink.codec import MavlinkCodec
from drivers.mavlink.session import MavlinkSession
from drivers.mavlink.streams import wanted_hz
from drivers.ports.port import Port

HOUSEKEEPING_NS = 100_000_000


class App:
    """One run. `watch` sees every message and output as it happens; `devices`: wires of sensors, by their keys."""

    def __init__(
        self,
        pilot: Pilot,
        solver: Solver,
        *,
        mavlink: tuple[Port, MavlinkCodec],
        devices: Mapping[str, tuple[Port, DeviceCodec]],
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
        self._stop, self._faults = asyncio.Event(), FaultBarrier(self._fail)
        settings, codec = pilot.settings, mavlink[1]
        self._session = MavlinkSession(codec, wanted_hz(settings.vessel.sensors))
        self._mavlink = self._link("mavlink", *mavlink, rng, LinkTiming())
        timing = {sensor.key: device_timing(sensor.rate_Hz) for sensor in pilot.sensors}
        self._devices = tuple(
            SensorDevice(name, self._link(name, port, codec, rng, timing[name]), codec, recorder)
            for name, (port, codec) in devices.items()
        )
        position = PositionFeed(vision_hz, settings.site, settings.vessel, codec) if vision_hz else None
        self._autopilot = AutopilotCommands(
            self._mavlink, codec, pilot.channels, recorder, forward=forward, position=position
        )
        self._forward, self._guard = forward, guard
        if forward:
            codec.framer.on_frame = forward.show
        self._solver = SolverThread(solver, self._planned)
        self._period_ns = round(self._control.period_s * 1e9)
        self._timing = TickTiming(self._period_ns)
        self._solver_stuck = False
        self._lease_end_ns = clock.now_ns()

    async def run(self) -> None:
        """Until `stop`; ends with neutral, disarm and a release. Raises what was raised inside, after neutral."""
        try:
            async with asyncio.TaskGroup() as group:
                wires = (self._mavlink, *(device.link for device in self._devices))
                links = [group.create_task(self._faults.keep(link.run, self._pause)) for link in wires]
                if self._forward:
                    station = self._forward.run(self._autopilot.pass_on, self._note, self._is_disarmed)
                    links.append(group.create_task(self._faults.task(station)))
                loops = [group.create_task(self._faults.task(loop)) for loop in (self._ticks(), self._housekeeping())]
                try:
                    await self._stop.wait()
                finally:  # also where this very task is cancelled
                    await self._let_go(loops)
                for task in links:
                    task.cancel()
        finally:
            self._solver.close()
        self._faults.end()

    def stop(self) -> None:
        """End the run from a signal handler or a task."""
        self._stop.set()

    def command(self, command: OperatorCommand, waits_s: float = WAITS_S) -> bool:
        """Hand an operator's command to the pilot, once the guard lets it pass, which may take `waits_s` and no longer;
        whether the pilot has it now.
        """
        ends = self._faults.failure or (self._stop.is_set() and command.command != "stop")
        if ends or not (self._guard is None or self._guard.passes(command, waits_s)):
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
        ends = "the run ends" if self._stop.is_set() else None  # a fault sets it as well
        return ends or (self._guard.refusal if self._guard else None)

    def load(self, mission: NewMission) -> bool:
        """Hand the pilot another mission, unless one is driven; whether it has it now."""
        if self._faults.failure or self.state.helm.on_mission:
            return False
        self._step([mission], self._clock.now_ns())
        return True

    def manual(self, sticks: ManualInput) -> None:
        """Hand sticks to the pilot; they count in manual mode, once they have been at rest (`manual_control`)."""
        self._step([sticks], self._clock.now_ns())

    def _fail(self) -> None:
        self._stop.set()
        self._faults.attempt(self._autopilot.neutral)

    # --- the loop ----------------------------------------------------------------------------------

    async def _ticks(self) -> None:
        """The control period: a tick, then the deadline of its plan, then a rehearsal for the next."""
        deadline_ns = round(self._control.plan_deadline_s * 1e9)
        due_ns = self._clock.now_ns() + self._period_ns
        for index in range(1 << 62):
            await self._clock.sleep_until(due_ns)
            now = self._clock.now_ns()
            self._step([self._timing.begin(index, due_ns, now)], now)
            await self._clock.sleep_until(due_ns + deadline_ns)
            if self.state.open_tick == index:
                now = self._clock.now_ns()
                self._step([PlanDeadline(t_ns=now, index=index)], now)
            due_ns = self._timing.next_due_ns(due_ns, self._clock.now_ns())
            await self._clock.sleep_until(due_ns - round(REHEARSAL_S * 1e9))
            self._solver.rehearse()

    def _planned(self, result: PlanResult) -> None:
        now = self._clock.now_ns()
        self._step([replace(result, t_ns=now)], now)

    def _step(self, inputs: Sequence[Message], t_ns: int) -> None:
        self._faults.call(self._think, inputs, t_ns)

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
        sent = self._autopilot.override(lease)
        now = self._clock.now_ns()
        self._lease_end_ns = now + round(lease.valid_for_s * 1e9)
        self._note(self._timing.of_lease(lease, now, sent=sent))

    def _solve(self, request: SolveRequest) -> None:
        stuck, self._solver_stuck = self._solver_stuck, not self._solver.submit(request)
        if self._solver_stuck and not stuck:
            text = f"tick {request.index}: the solver is still busy with an earlier one"
            self._note(Alert(t_ns=request.t_ns, level="warning", text=text))

    def _ask_vehicle(self, request: VehicleRequest) -> None:
        self._autopilot.request(request)

    def _tell_position(self, estimate: StateEstimate) -> None:
        self._autopilot.position(estimate, restarts=self.state.estimator.restarts, begins=self._session.begins)

    def _note(self, message: Message) -> None:
        self._recorder.record(message)
        self._watch(message)

    def _is_disarmed(self) -> bool:
        """As far as the ground station is concerned: only a living autopilot can be known to be disarmed."""
        autopilot = self.state.monitor(AutopilotState)
        armed = autopilot.heartbeat is None or autopilot.heartbeat.armed
        return not armed and is_alive(autopilot.heartbeat_ns, self._clock.now_ns())

    # --- devices -----------------------------------------------------------------------------------

    def _link(self, name: str, port: Port, codec: Any, rng: random.Random, timing: LinkTiming) -> DeviceLink:
        take = self._hear_autopilot if name == "mavlink" else self._think
        return DeviceLink(
            name,
            port,
            GuardedCodec(codec, self._faults),
            now_ns=self._clock.now_ns,
            sleep_until=self._clock.sleep_until,
            rng=rng,
            on_messages=lambda messages, t_ns: self._faults.call(take, messages, t_ns),
            on_bytes=lambda data, t_ns: self._faults.call(self._recorder.record_raw, name, "rx", data),
            timing=timing,
        )

    def _hear_autopilot(self, messages: Sequence[Message], t_ns: int) -> None:
        self._timing.hear(messages)
        self._talk(messages, t_ns)
        self._think(messages, t_ns)

    def _talk(self, messages: Sequence[Message], t_ns: int) -> None:
        """Frames and alerts of the session and of the guard, and the command that waited for the guard's check."""
        for partner in (self._session, self._guard) if self._guard else (self._session,):
            for frame in partner.step(messages, t_ns):
                self._autopilot.send(frame)
            for alert in partner.take_alerts():
                self._note(alert)
        for message in self._guard.take_inputs(t_ns, self.state.helm.taken) if self._guard else ():
            self._step([message], t_ns)

    async def _housekeeping(self) -> None:
        """What goes on in silence: neutral after a lease, the session, words to the sensors, figures, the log."""
        meter = ProcessMeter(self._clock.now_ns())
        recording = RecordingAlerts()
        while True:
            now = self._clock.now_ns()
            if now >= self._lease_end_ns:
                self._autopilot.neutral()
            self._talk((), now)
            for device in self._devices:
                device.step(now)
            if stats := meter.step(now):
                self._note(stats)
            if alert := recording.step(self._recorder.problem, now):
                self._watch(alert)
            await self._clock.sleep_until(now + HOUSEKEEPING_NS)

    async def _let_go(self, loops: Sequence[asyncio.Task[None]]) -> None:
        """Neutral for a second, disarm, and only then hand the channels back; nothing takes them again.

        Whatever fails here, and where this is cancelled too, the rest is sent.
        """
        self._faults.attempt(self.command, OperatorCommand(t_ns=self._clock.now_ns(), command="stop"))
        try:
            await self._autopilot.rest(self._faults.attempt, self._pause)
        finally:
            for task in loops:
                task.cancel()
            self._autopilot.leave(self._faults.attempt)
            self._faults.over = True
        await self._pause()  # let them leave

    async def _pause(self) -> None:
        await self._clock.sleep_until(self._clock.now_ns() + round(NEUTRAL_PERIOD_S * 1e9))


_DISPATCH: dict[type[Message], Callable[[App, Any], None]] = {
    OverrideLease: App._lease,
    SolveRequest: App._solve,
    StateEstimate: App._tell_position,
    VehicleRequest: App._ask_vehicle,
}
