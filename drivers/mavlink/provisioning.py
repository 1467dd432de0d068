"""Setting up an autopilot with MAVSDK: parameters, files, logs, reboot. A ground station's job, not the boat's loop.

    async with Provisioner.connect("serial:/dev/ttyACM0:115200") as autopilot:
        told = await autopilot.parameters()
        now = await autopilot.write("FS_ACTION", 2.0)

We are ground station 255/190, so that our heartbeats do not count as the companion's. What MAVSDK or the autopilot
refuses is a ProvisioningError in words. MAVSDK does not sign: with a key it talks through `signing_relay`.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import NamedTuple

from mavsdk import MavsdkError, log_subscribe
from mavsdk.asyncio import Configuration, Mavsdk, System
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.ftp import FtpAsync
from mavsdk.asyncio.plugins.log_files import LogFilesAsync
from mavsdk.asyncio.plugins.mavlink_direct import MavlinkDirectAsync
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.plugins.ftp import FtpResult
from mavsdk.plugins.log_files import LogFilesResult

from drivers.mavlink.signing import GREETING_NS, Signing
from drivers.mavlink.signing_relay import HOST, signing_relay
from drivers.ports.url import PortUrlError, open_port_from_url

SYSTEM, COMPONENT = 255, 190
HEARD_S, HEARTBEAT_S = 10.0, 4.0
"""How long to wait for an autopilot, and for the next of its heartbeats; assumed."""
TIMEOUT_S = 60.0
"""For all parameters, or the list of logs; 1272 parameters were seen to take 1.3 to 3.3 s on USB."""
ARMED = 128
"""base_mode: MAV_MODE_FLAG_SAFETY_ARMED."""


class ProvisioningError(Exception):
    """What could not be done, and why."""


class StoredLog(NamedTuple):
    """A log on the autopilot. `date`: ISO 8601 as the autopilot's clock had it."""

    number: int
    date: str
    size_bytes: int


def mavsdk_url(url: str) -> str:
    """MAVSDK's form of one of our port URLs; ProvisioningError for one that it has none for."""
    scheme, _, rest = url.partition(":")
    forms = {"udpin": "udpin", "udpout": "udpout", "tcp": "tcpout", "tcpin": "tcpin", "serial": "serial"}
    if scheme not in forms or not rest:
        raise ProvisioningError(f"port {url!r}: expected one of {', '.join(f'{form}:...' for form in forms)}")
    if scheme == "serial" and not rest.rpartition(":")[2].isdigit():
        rest = f"{rest}:115200"
    return f"{forms[scheme]}://{rest}"


class Provisioner:
    """One connected autopilot. Made by `connect`."""

    def __init__(self, system: System) -> None:
        self._param, self._action = ParamAsync(system), ActionAsync(system)
        self._ftp, self._logs = FtpAsync(system), LogFilesAsync(system)
        self._direct = MavlinkDirectAsync(system)
        self._whole: set[str] = set()

    @staticmethod
    @contextlib.asynccontextmanager
    async def connect(url: str, heard_s: float = HEARD_S, signing: Signing | None = None) -> AsyncIterator[Provisioner]:
        """Wait for the autopilot on one of our port URLs. `signing`: signs what we send. Raises ProvisioningError."""
        log_subscribe(lambda level, message, file, line: True)  # it would write into the terminal
        async with contextlib.AsyncExitStack() as stack:
            where = await stack.enter_async_context(_signed(url, signing)) if signing else mavsdk_url(url)
            mavsdk = await stack.enter_async_context(Mavsdk(Configuration.create_manual(SYSTEM, COMPONENT, True)))
            try:
                await mavsdk.add_any_connection(where)
            except MavsdkError as error:
                raise ProvisioningError(f"{url}: cannot be opened: {error}") from None
            system = await mavsdk.first_autopilot(heard_s)
            if system is None:
                raise ProvisioningError(f"{url}: {_unheard(heard_s, signing)}")
            yield Provisioner(system)

    async def armed(self) -> bool:
        """Whether it is armed, by its next heartbeat. Raises ProvisioningError where none comes."""
        stream = self._direct.subscribe_message("HEARTBEAT")
        try:
            async with asyncio.timeout(HEARTBEAT_S):
                async for message in stream:
                    fields = json.loads(message.fields_json)
                    if message.component_id == 1 and message.system_id != SYSTEM:
                        return bool(int(fields["base_mode"]) & ARMED)
        except TimeoutError:
            pass
        finally:
            await stream.aclose()
        raise ProvisioningError("the autopilot has fallen silent")

    async def parameters(self) -> dict[str, float]:
        """All parameters by name."""
        everything = await self._wait(self._param.get_all_params(), "read the parameters")
        self._whole = {p.name for p in everything.int_params}
        values = {p.name: float(p.value) for p in [*everything.int_params, *everything.float_params]}
        if not values:
            raise ProvisioningError("the autopilot does not tell its parameters: is MAVLink signing set up?")
        return values

    async def write(self, name: str, value: float) -> float:
        """Set a parameter that `parameters` told of; the value that it then has."""
        try:
            if name in self._whole:
                await self._param.set_param_int(name, round(value))
                return float(await self._param.get_param_int(name))
            await self._param.set_param_float(name, value)
            return float(await self._param.get_param_float(name))
        except MavsdkError as error:
            raise ProvisioningError(f"{name}: {_reason(error)}") from None

    async def reboot(self) -> None:
        """Restart the autopilot; it refuses while armed."""
        try:
            await self._action.reboot()
        except MavsdkError as error:
            raise ProvisioningError(f"the autopilot does not reboot: {_reason(error)}") from None

    async def upload(self, local: Path, folder: str) -> None:
        """Put a file into a folder of the autopilot by MAVFTP and compare it there. Raises ProvisioningError."""
        remote = f"{folder}/{local.name}"
        try:
            async with asyncio.timeout(TIMEOUT_S):
                async for result, _ in self._ftp.upload(str(local), folder):
                    if result == FtpResult.SUCCESS:
                        break
                if not await self._ftp.are_files_identical(str(local), remote):
                    raise ProvisioningError(f"{remote}: is not what was sent")
        except MavsdkError as error:
            raise ProvisioningError(f"{remote}: {_reason(error)}") from None
        except TimeoutError:
            raise ProvisioningError(f"{remote}: no answer for {TIMEOUT_S:g} s") from None

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


@contextlib.asynccontextmanager
async def _signed(url: str, signing: Signing) -> AsyncIterator[str]:
    """MAVSDK's URL of a relay to `url` that signs."""
    mavsdk_url(url)  # the same ports, with and without a key
    try:
        async with signing_relay(open_port_from_url(url), signing) as port:
            yield f"udpout://{HOST}:{port}"
    except PortUrlError as error:
        raise ProvisioningError(str(error)) from None
    except OSError as error:
        raise ProvisioningError(f"{url}: cannot be opened: {error.strerror or error}") from None


def _unheard(heard_s: float, signing: Signing | None) -> str:
    """Why there is nobody: not one frame, or none that may be believed."""
    refused = [alert.text for alert in signing.alerts(GREETING_NS)] if signing else []
    text = f"no autopilot heard within {heard_s:g} s"
    return f"{text} that may be believed: {'; '.join(refused)}" if refused else f"{text}: cable, baud rate, port?"


def _reason(error: MavsdkError) -> str:
    """MAVSDK's word for it, in lower case."""
    result = getattr(error, "result", None)
    return str(error) if result is None else result.name.lower().replace("_", " ")
