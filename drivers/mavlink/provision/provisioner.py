"""Setting up an autopilot with MAVSDK: parameters, files, logs, reboot. A ground station's job, not the boat's loop.

    async with Provisioner.connect("serial:/dev/ttyACM0:115200") as autopilot:
        told = await autopilot.parameters()
        now = await autopilot.write("FS_ACTION", 2.0)

We are ground station 255/190, so that our heartbeats do not count as the companion's. What MAVSDK or the autopilot
refuses is a ProvisioningError in words. MAVSDK talks through our `relay`, which signs for it where there is a key and
notes whether the autopilot does. Files are sent by our own `ftp`, for MAVSDK counts the NUL of a path, which ArduPilot
4.6 refuses.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any, NamedTuple

from mavsdk import MavsdkError, log_subscribe
from mavsdk.asyncio import Configuration, Mavsdk, System
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.log_files import LogFilesAsync
from mavsdk.asyncio.plugins.mavlink_direct import MavlinkDirectAsync, MavlinkMessage
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.plugins.log_files import LogFilesResult

from drivers.mavlink.provision.ftp import (
    INVALID_SESSION,
    FtpRefusedError,
    FtpReply,
    FtpRequest,
    parse_reply,
    upload_steps,
)
from drivers.mavlink.provision.relay import HOST, Relay, open_relay
from drivers.mavlink.signing import GREETING_NS, NO_KEY, Signing
from drivers.ports.port import Port

SYSTEM, COMPONENT = 255, 190
HEARD_S, HEARTBEAT_S = 10.0, 8.0
"""How long to wait for an autopilot, and for the next of its heartbeats; assumed."""
TIMEOUT_S = 60.0
"""For all parameters, or the list of logs; 1272 parameters were seen to take 1.3 to 3.3 s on USB."""
FTP_WAIT_S, FTP_TRIES = 1.0, 6
"""For one answer, and how often a request is sent: an idle file transfer of somebody else ends after 3 s (source)."""
ANSWER_S, ANSWER_TRIES, WRITE_TRIES = 1.0, 3, 5
"""An answer takes some 10 ms; assumed."""
AUTOPILOT_COMPONENT = 1
INT32, REAL32 = 6, 9
"""MAV_PARAM_TYPE."""
ARMED = 128
"""base_mode: MAV_MODE_FLAG_SAFETY_ARMED."""

Heard = asyncio.Queue[dict[str, Any]]
"""Fields of MAVLink messages as they come."""


class ProvisioningError(Exception):
    """What could not be done, and why."""


class StoredLog(NamedTuple):
    """A log on the autopilot. `date`: ISO 8601 as the autopilot's clock had it."""

    number: int
    date: str
    size_bytes: int


class Provisioner:
    """One connected autopilot. Made by `connect`."""

    def __init__(self, system: System, number: int) -> None:
        self._param, self._action = ParamAsync(system), ActionAsync(system)
        self._logs, self._direct = LogFilesAsync(system), MavlinkDirectAsync(system)
        self._target = {"target_system": number, "target_component": AUTOPILOT_COMPONENT}
        self._whole: set[str] = set()
        self._number = 0

    @staticmethod
    @contextlib.asynccontextmanager
    async def connect(
        port: Port, heard_s: float = HEARD_S, signing: Signing | None = None
    ) -> AsyncIterator[Provisioner]:
        """Wait for the autopilot on a port of ours. `signing`: signs what we send. Raises ProvisioningError."""
        log_subscribe(lambda level, message, file, line: True)  # it would write into the terminal
        async with contextlib.AsyncExitStack() as stack:
            try:
                relay = await stack.enter_async_context(open_relay(port, signing))
            except OSError as error:
                raise ProvisioningError(f"{port.name}: cannot be opened: {error.strerror or error}") from None
            mavsdk = await stack.enter_async_context(Mavsdk(Configuration.create_manual(SYSTEM, COMPONENT, True)))
            await mavsdk.add_any_connection(f"udpout://{HOST}:{relay.number}")
            system = await mavsdk.first_autopilot(heard_s)
            if system is None:
                raise ProvisioningError(f"{port.name}: {_unheard(heard_s, signing)}")
            autopilot = Provisioner(system, await system.get_system_id())
            await autopilot.refuse_unheard(relay, signing)
            yield autopilot

    async def armed(self) -> bool:
        """Whether it is armed, by its next heartbeat. Raises ProvisioningError where none comes."""
        async with self._heard("HEARTBEAT") as heard:
            with contextlib.suppress(TimeoutError):
                return bool(int((await asyncio.wait_for(heard.get(), HEARTBEAT_S))["base_mode"]) & ARMED)
        raise ProvisioningError("the autopilot has fallen silent")

    async def parameters(self) -> dict[str, float]:
        """All parameters by name. Raises ProvisioningError."""
        everything = await self._wait(self._param.get_all_params(), "read the parameters")
        self._whole = {p.name for p in everything.int_params}
        values = {p.name: float(p.value) for p in [*everything.int_params, *everything.float_params]}
        if not values:
            raise ProvisioningError("the autopilot does not tell its parameters")
        return values

    async def write(self, name: str, value: float) -> float:
        """Set a parameter, and read it back; the value that it then has. Raises ProvisioningError."""
        kind = REAL32 if name not in self._whole else INT32  # ArduPilot goes by its own type (source)
        async with self._heard("PARAM_VALUE") as heard:
            await self._told(heard, name, "PARAM_SET", {"param_value": value, "param_type": kind})
            return await self._told(heard, name, "PARAM_REQUEST_READ", {"param_index": -1})

    async def _told(self, heard: Heard, name: str, message: str, fields: dict[str, Any]) -> float:
        """Value of a parameter as the autopilot answers one message. MAVSDK's own writing waits for ever where the
        wire is dead.
        """
        for _ in range(WRITE_TRIES):
            await self._send(message, {"param_id": name, **fields})
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(ANSWER_S):
                    while (answer := await heard.get())["param_id"] != name:
                        pass
                    return float(answer["param_value"])
        raise ProvisioningError(f"{name}: no answer for {WRITE_TRIES * ANSWER_S:g} s")

    async def reboot(self) -> None:
        """Restart the autopilot; it refuses while armed."""
        try:
            await self._action.reboot()
        except MavsdkError as error:
            raise ProvisioningError(f"the autopilot does not reboot: {_reason(error)}") from None

    async def upload(self, local: Path, folder: str) -> None:
        """Put a file into a folder of the autopilot by MAVLink FTP and compare it there. Raises ProvisioningError."""
        steps = upload_steps(f"{folder}/{local.name}", local.read_bytes())
        async with self._heard("FILE_TRANSFER_PROTOCOL") as heard:
            try:
                request = next(steps)
                while True:
                    request = steps.send(await self._ask(request, heard))
            except StopIteration:
                return
            except FtpRefusedError as error:
                raise ProvisioningError(str(error)) from None

    async def _ask(self, request: FtpRequest, heard: Heard) -> FtpReply:
        """The reply to one request, which is sent again where it is lost, or while another's file is open."""
        for _ in range(FTP_TRIES):
            self._number += 1
            reply = await self._reply(request, heard)
            if reply.error != INVALID_SESSION:
                break
            await asyncio.sleep(FTP_WAIT_S)
        return reply

    async def _reply(self, request: FtpRequest, heard: Heard) -> FtpReply:
        payload = list(request.payload(self._number))
        for _ in range(FTP_TRIES):
            await self._send("FILE_TRANSFER_PROTOCOL", {"target_network": 0, "payload": payload})
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(FTP_WAIT_S):
                    while True:
                        if reply := parse_reply(bytes((await heard.get())["payload"]), request, self._number):
                            return reply
        raise ProvisioningError(f"no answer to a file transfer for {FTP_TRIES * FTP_WAIT_S:g} s")

    async def refuse_unheard(self, relay: Relay, signing: Signing | None) -> None:
        """An autopilot that signs, where we have no key, may answer all the same, as on USB; else ProvisioningError."""
        if signing or not relay.signed:
            return
        async with self._heard("PARAM_VALUE") as heard:
            for _ in range(ANSWER_TRIES):
                await self._send("PARAM_REQUEST_READ", {"param_id": "", "param_index": 0})
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(heard.get(), ANSWER_S)
                    return
        raise ProvisioningError(NO_KEY)

    @contextlib.asynccontextmanager
    async def _heard(self, name: str) -> AsyncIterator[Heard]:
        """Fields of the messages of one type that the autopilot sends from now on."""
        heard: Heard = asyncio.Queue()

        async def listen() -> None:
            async for message in self._direct.subscribe_message(name):
                if message.system_id == self._target["target_system"] and message.component_id == AUTOPILOT_COMPONENT:
                    heard.put_nowait(json.loads(message.fields_json))

        task = asyncio.create_task(listen())
        await asyncio.sleep(0)  # it is subscribed
        try:
            yield heard
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)

    async def _send(self, name: str, fields: dict[str, Any]) -> None:
        """One message in MAVSDK's form of it."""
        text = json.dumps({**self._target, **fields})
        system, component = self._target["target_system"], self._target["target_component"]
        await self._direct.send_message(MavlinkMessage(name, SYSTEM, COMPONENT, system, component, text))

    async def logs(self) -> list[StoredLog]:
        """Logs on the autopilot, in its order; none where it has none."""
        try:
            entries = await asyncio.wait_for(self._logs.get_entries(), TIMEOUT_S)
        except MavsdkError as error:
            if getattr(error, "result", None) == LogFilesResult.NO_LOGFILES:
                return []
            raise ProvisioningError(f"the list of logs: {_reason(error)}") from None
        except TimeoutError:
            raise ProvisioningError("the list of logs: no answer") from None
        return [StoredLog(e.id, e.date, e.size_bytes) for e in entries]

    async def download(self, log: StoredLog, path: Path, say: Callable[[float], None]) -> None:
        """Fetch one log into a file that is not there yet; `say` is told the share that has come."""
        entries = {e.id: e for e in await self._logs.get_entries()}
        try:
            async for result, progress in self._logs.download_log_file(entries[log.number], str(path)):
                if result == LogFilesResult.NEXT:
                    say(float(progress.progress))
        except MavsdkError as error:
            raise ProvisioningError(f"log {log.number}: {_reason(error)}") from None
        if (size := path.stat().st_size) != log.size_bytes:
            raise ProvisioningError(f"{path}: {size} bytes came of {log.size_bytes}")

    @staticmethod
    async def _wait(work, what: str):
        try:
            return await asyncio.wait_for(work, TIMEOUT_S)
        except (MavsdkError, TimeoutError) as error:
            reason = _reason(error) if isinstance(error, MavsdkError) else f"no answer for {TIMEOUT_S:g} s"
            raise ProvisioningError(f"cannot {what}: {reason}") from None


def _unheard(heard_s: float, signing: Signing | None) -> str:
    """Why there is nobody: not one frame, or none that may be believed."""
    refused = [alert.text for alert in signing.alerts(GREETING_NS)] if signing else []
    text = f"no autopilot heard within {heard_s:g} s"
    return f"{text} that may be believed: {'; '.join(refused)}" if refused else f"{text}: cable, baud rate, port?"


def _reason(error: MavsdkError) -> str:
    """MAVSDK's word for it, in lower case."""
    result = getattr(error, "result", None)
    return str(error) if result is None else result.name.lower().replace("_", " ")
