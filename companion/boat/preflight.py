"""The pre-flight check with its ports: opens the links, listens, reads parameters, and never moves anything.

What goes out to the autopilot: heartbeats, TIMESYNC, message intervals, AUTOPILOT_VERSION, MAV_CMD_RUN_PREARM_CHECKS
and PARAM_REQUEST_READ. No override, no arming, no mode, no parameter is ever set. The tag's shell is woken as in a run.
"""

from __future__ import annotations

import asyncio
import math
import os
import random
import shutil
import time
from collections.abc import Awaitable, Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from msgspec.structs import replace as struct_replace

from companion.boat.clock import Clock
from companion.boat.devices.sensor_device import SensorDevice, device_timing
from companion.boat.load_run import RunSetup, warnings
from companion.boat.log_quota import MB, stored_logs
from companion.boat.start_interlock import companion_of
from companion.core.estimation.estimator import Estimator, EstimatorState
from companion.core.geometry.frames import ssa
from companion.core.messages import (
    Attitude,
    AutopilotInfo,
    Battery,
    CommandAck,
    Heartbeat,
    Innovation,
    LinkStatus,
    Message,
    RcChannels,
    ServoOutput,
    StatusText,
    TimeSync,
    UwbPosition,
    UwbRanges,
)
from companion.core.preflight.autopilot import further_parameter_names, parameter_names, parameter_rows
from companion.core.preflight.boat import battery_rows, configuration_rows, disk_rows, estimator_rows, sensor_rows
from companion.core.preflight.link import PRE_ARM, arming_complaints, link_rows, rest_rows
from companion.core.preflight.observations import Disk, Observations, RoundTrip, cycles_of
from companion.core.preflight.rows import ParameterSet, Row
from companion.core.sensors.table import AIDING
from companion.core.sensors.uwb import RangingSensor
from drivers.devices import DeviceCodec
from drivers.link import DeviceLink, LinkTiming
from drivers.mavlink.codec import MavlinkCodec
from drivers.mavlink.parameter_reader import ParameterReader
from drivers.mavlink.session import MavlinkSession
from drivers.mavlink.streams import wanted_hz
from drivers.ports.port import Port

STEP_NS = 50_000_000
SETTLE_S = 1.0
"""Streams that were just requested take a moment to begin; assumed."""
HEARTBEAT_WAIT_S = 8.0
"""Heartbeats come at 1 Hz; opening a port may take some seconds (assumed)."""
TAG_S = 20.0
"""A DWM1001 takes 5 to 20 s from opening its port to its first range."""
PARAMETERS_S = 15.0
"""Longest wait for parameters: some 150 questions at 12 at a time; assumed."""
ARMING_S, ASK_AGAIN_S = 20.0, 3.0
"""How long complaints are waited out, and until the checks are asked for again: sensors take 12 to 18 s (observed)."""
ASKS, ANSWER_S = 4, 0.5
"""How often it is asked for its checks where it does not answer, and how long an answer may take; assumed."""
RUN_PREARM_CHECKS = 401
"""MAV_CMD: the autopilot says in STATUSTEXTs why it would refuse to arm."""


def all_rows(setup: RunSetup, observed: Observations, parameters: ParameterSet) -> list[Row]:
    """The whole table."""
    companion, vessel = companion_of(setup), setup.pilot.vessel
    asked = parameter_rows(parameters, companion) if observed.heartbeat else []
    what = f"{setup.digest}: vessel {vessel.name}, site {setup.pilot.site.name}, mission {setup.pilot.mission.name}"
    return [
        *configuration_rows(observed.notes, what),
        *link_rows(observed, companion),
        *asked,
        *rest_rows(observed, parameters, companion),
        *estimator_rows(observed, setup.pilot.fence),
        *sensor_rows(observed, setup.pilot.site, vessel),
        *battery_rows(observed, vessel.propulsion.nominal_voltage_V, setup.run.battery),
        *disk_rows(observed),
    ]


class Listener:
    """One check. `say` takes a text for each stage of it."""

    def __init__(
        self,
        setup: RunSetup,
        *,
        mavlink: tuple[Port, MavlinkCodec],
        devices: Mapping[str, tuple[Port, DeviceCodec]],
        clock: Clock,
        say: Callable[[str], None],
    ) -> None:
        self._setup, self._clock, self._say = setup, clock, say
        self._codec, sensors = mavlink[1], setup.pilot.vessel.sensors
        self._wanted_hz = wanted_hz(sensors)
        self._session = MavlinkSession(self._codec, self._wanted_hz)
        self._reader = ParameterReader(self._codec.encoder)
        self._estimator = Estimator(setup.pilot.vessel, setup.pilot.site)
        self._state: EstimatorState = self._estimator.initial()
        self._rotation_rad = math.radians(setup.pilot.site.rotation_deg)
        self._latest: dict[type[Message], Any] = {}
        self._links: dict[str, LinkStatus] = {}
        self._kept: dict[type[Message], list[Any]] = {k: [] for k in (StatusText, *AIDING)}
        self._innovations: list[Innovation] = []
        self._round_trips: list[RoundTrip] = []
        self._arming_told = False
        self._mavlink = self._link("mavlink", *mavlink, LinkTiming(), self._hear)
        rates = {sensor.key: sensor.rate_Hz for sensor in self._estimator.sensors}
        self._devices = {
            name: SensorDevice(name, self._link(name, port, codec, device_timing(rates[name]), self._take), codec)
            for name, (port, codec) in devices.items()
        }

    async def run(self, listen_s: float, disk: Disk) -> tuple[Observations, ParameterSet]:
        """Listen for `listen_s` [s] from the first heartbeat on, then read the autopilot's parameters."""
        tasks = [asyncio.create_task(work) for work in (*(link.run() for link in self._links_of()), self._talk())]
        try:
            self._say(f"waiting for autopilot and {self._estimator.sensors.position.label}")
            await self._until(lambda: Heartbeat in self._latest, max(listen_s, HEARTBEAT_WAIT_S))
            await self._until(self._position_is_heard, TAG_S)
            await self._wait(SETTLE_S)
            if Heartbeat in self._latest:
                await self._ask_arming_checks()
            self._say(f"listening for {listen_s:g} s")
            before, start_ns = (self._counts(), self._cycles()), self._clock.now_ns()
            await self._wait(listen_s)
            await self._until_it_would_arm()
            observed = self._observations((self._clock.now_ns() - start_ns) * 1e-9, before, disk)
            if observed.heartbeat:
                self._say("reading the autopilot's parameters")
                await self._read_parameters()
            return observed, ParameterSet(self._reader.values)
        finally:
            for task in tasks:
                task.cancel()
            ended = await asyncio.gather(*tasks, return_exceptions=True)
            for result in ended:
                if isinstance(result, Exception):  # a link or its codec must not raise: that is a bug
                    raise result

    async def _ask_arming_checks(self) -> None:
        """Have the autopilot say once more what stands against arming, until it answers; what it said is forgotten."""
        self._kept[StatusText] = [text for text in self._kept[StatusText] if not text.text.startswith(PRE_ARM)]
        self._arming_told = False
        for _ in range(ASKS):  # question or answer may be lost
            self._mavlink.send(self._codec.encoder.command_long(RUN_PREARM_CHECKS))
            await self._until(lambda: self._arming_told, ANSWER_S)
            if self._arming_told:
                return

    async def _until_it_would_arm(self) -> None:
        """Ask again while it complains, as a firmware does of its sensors in its first 20 s."""
        end_ns = self._clock.now_ns() + round(ARMING_S * 1e9)
        while arming_complaints(self._kept[StatusText]) and self._clock.now_ns() < end_ns:
            self._say(f"waiting for the autopilot's arming checks: {arming_complaints(self._kept[StatusText])[0]}")
            await self._ask_arming_checks()
            await self._wait(ASK_AGAIN_S)

    async def _read_parameters(self) -> None:
        self._reader.ask(parameter_names(companion_of(self._setup)))
        await self._until(lambda: self._reader.done, PARAMETERS_S)
        self._reader.ask(further_parameter_names(ParameterSet(self._reader.values)))
        await self._until(lambda: self._reader.done, PARAMETERS_S)

    # --- time --------------------------------------------------------------------------------------

    async def _wait(self, seconds: float) -> None:
        await self._clock.sleep_until(self._clock.now_ns() + round(seconds * 1e9))

    async def _until(self, condition: Callable[[], bool], seconds: float) -> None:
        end_ns = self._clock.now_ns() + round(seconds * 1e9)
        while not condition() and self._clock.now_ns() < end_ns:
            await self._clock.sleep_until(self._clock.now_ns() + STEP_NS)

    async def _talk(self) -> None:
        """What is sent without being asked: heartbeats, repeated requests, words to the sensors."""
        while True:
            now_ns = self._clock.now_ns()
            self._answer((), now_ns)
            for device in self._devices.values():
                device.step(now_ns)
            await self._clock.sleep_until(now_ns + STEP_NS)

    # --- messages ----------------------------------------------------------------------------------

    def _link(self, name: str, port: Port, codec, timing: LinkTiming, hear) -> DeviceLink:
        sleep: Callable[[int], Awaitable[None]] = self._clock.sleep_until
        return DeviceLink(
            name, port, codec, now_ns=self._clock.now_ns, sleep_until=sleep, rng=random.Random(), on_messages=hear,
            timing=timing,
        )  # fmt: skip

    def _hear(self, messages: Sequence[Message], t_ns: int) -> None:
        self._answer(messages, t_ns)
        self._take(messages, t_ns)

    def _answer(self, messages: Sequence[Message], t_ns: int) -> None:
        for frame in (*self._session.step(messages, t_ns), *self._reader.step(messages, t_ns)):
            self._mavlink.send(frame)
        self._session.take_alerts()

    def _take(self, messages: Sequence[Message], t_ns: int) -> None:
        for message in messages:
            self._latest[type(message)] = message
            self._arming_told |= isinstance(message, CommandAck) and message.command == RUN_PREARM_CHECKS
            if isinstance(message, LinkStatus):
                self._links[message.link] = message
            elif type(message) in self._kept:
                self._kept[type(message)].append(message)
            elif isinstance(message, TimeSync) and message.tc1_ns:
                took_ns = t_ns - message.ts1_ns
                offset_ns = message.ts1_ns + took_ns // 2 - message.tc1_ns
                self._round_trips.append(RoundTrip(took_ns * 1e-9, offset_ns * 1e-9))
            self._estimate(message)

    def _estimate(self, message: Message) -> None:
        """The boat's filter, with headings in site axes as the pilot turns them."""
        if isinstance(message, Attitude):
            message = struct_replace(message, psi_rad=ssa(message.psi_rad - self._rotation_rad))
        self._state, innovations = self._estimator.step(self._state, message)
        self._innovations += innovations

    # --- observations ------------------------------------------------------------------------------

    def _counts(self) -> dict[str, int]:
        return {name: self._codec.counters.from_target(name) for name in self._wanted_hz}

    def _heard(self) -> dict[str, list[Any]]:
        """Messages of each sensor that aids the inertial ones."""
        sensors = [sensor for sensor in self._estimator.sensors if sensor.aids]
        return {sensor.key: [m for kind in sensor.messages for m in self._kept[kind]] for sensor in sensors}

    def _cycles(self) -> dict[str, int]:
        return {key: cycles_of(messages) for key, messages in self._heard().items()}

    def _position_is_heard(self) -> bool:
        """Whether the sensor of positions has spoken, or cannot: its own wire is not open."""
        key = self._estimator.sensors.position.key
        silent = key in self._devices and not self._devices[key].link.is_open
        return silent or self._cycles()[key] > 0

    def _links_of(self) -> tuple[DeviceLink, ...]:
        return (self._mavlink, *(device.link for device in self._devices.values()))

    def _observations(self, listened_s: float, then: tuple[dict[str, int], dict[str, int]], disk: Disk) -> Observations:
        before, after, counters = then[0], self._counts(), self._codec.counters
        sensor_hz = {key: (count - then[1][key]) / listened_s for key, count in self._cycles().items()}

        def latest(kind):
            return self._latest.get(kind)

        return Observations(
            listened_s=listened_s, disk=disk, wall_s=time.time(), mavlink=self._links.get("mavlink"),
            uwb=self._links.get("uwb"), heartbeat=latest(Heartbeat), info=latest(AutopilotInfo),
            rates_hz={name: (after[name] - before[name]) / listened_s for name in after}, wanted_hz=self._wanted_hz,
            deaf=self._session.is_deaf, autopilot=self._setup.run.mavlink.autopilot_system_id,
            strangers=tuple(sorted(self._codec.strangers)),
            received=counters.received.total(), lost=counters.lost.total(), round_trips=tuple(self._round_trips),
            battery=latest(Battery), servo=latest(ServoOutput), rc=latest(RcChannels),
            texts=tuple(self._kept[StatusText]), arming_told=self._arming_told,
            estimate=self._estimator.estimate(self._state, self._clock.now_ns()),
            innovations=tuple(self._innovations),
            ranges=tuple(self._kept[UwbRanges]),
            positions=tuple(self._kept[UwbPosition]),
            heard={key: tuple(messages) for key, messages in self._heard().items()}, sensor_hz=sensor_hz,
            uwb_hz=sensor_hz.get(RangingSensor.key, 0.0), notes=tuple(warnings(self._setup)),
        )  # fmt: skip


def disk_state(folder: Path, quota_MB: float | None) -> Disk:
    """State of the log folder; nothing is written or made."""
    quota = None if quota_MB is None else quota_MB * MB
    name = str(folder) if str(folder) != "." else str(Path.cwd())
    try:
        existing = next((p for p in (folder, *folder.absolute().parents) if p.exists()), Path("/"))
        free = shutil.disk_usage(existing).free
        logs = list(stored_logs(folder)) if folder.is_dir() else []
    except OSError as error:  # also a folder above it that may not be looked into
        return Disk(name, 0, problem=error.strerror)
    problem = None
    if not existing.is_dir():
        problem = f"{existing} is not a folder"
    elif not os.access(existing, os.W_OK | os.X_OK):
        problem = "may not be written to"
    newest_s = max((log.modified_s for log in logs), default=None)
    return Disk(name, free, problem, quota, sum(log.size_bytes for log in logs), newest_s)
