"""MAVProxy, as a person would run it: the same session with the simulated autopilot and with a real firmware."""

import asyncio
import os
import re
import sys
from asyncio.subprocess import PIPE, STDOUT
from pathlib import Path

import pytest

from tests.support.autopilots.client_autopilots import autopilot
from tests.support.autopilots.firmware_rig import binaries

pytestmark = [pytest.mark.real_time, pytest.mark.long]

MODULES = "link,param,mode,arm,cmdlong,rc,ftp,wp"
MAVPROXY = Path(sys.executable).with_name("mavproxy.py")
FIRMWARES = [pytest.param(path, id=path.parent.name, marks=pytest.mark.firmware) for path in binaries()]
SCRIPT = (
    ("param show SCHED_LOOP_RATE", "200"),
    ("param set SERVO_RC_FS_MSK 3840", ""),
    ("param fetch SERVO_RC_FS_MSK", "SERVO_RC_FS_MSK = 3840"),
    ("mode MANUAL", "Got COMMAND_ACK: DO_SET_MODE: ACCEPTED"),
    ("arm throttle", "ARMED"),
    ("mode HOLD", "Mode HOLD"),
    ("mode GUIDED", "Flight mode change failed"),
    ("disarm", "DISARMED"),
    ("mode GUIDED", "Mode GUIDED"),
    ("arm throttle", "Arm: AHRS: waiting for home"),
    ("mode RTL", "Flight mode change failed"),
    ("mode HOLD", "Mode HOLD"),
    ("ftp mkdir /clients", ""),
    ("ftp list /clients", "Total size"),
    ("wp list", "Requesting 0 waypoints"),
)
"""What is typed, and what must be read then, in this order."""


class Console:
    """MAVProxy's standard input and output; `read` waits for words, in order."""

    def __init__(self, process):
        self._process = process
        self.heard = ""

    def type(self, line):
        self._process.stdin.write(f"{line}\n".encode())

    async def read(self, words, seconds=10.0):
        start = len(self.heard)
        try:
            async with asyncio.timeout(seconds):
                while not re.search(words, self.heard[start:]):
                    data = await self._process.stdout.read(4096)
                    assert data, f"MAVProxy ended; it said:\n{self.heard}"
                    self.heard += data.decode(errors="replace")
        except TimeoutError:
            raise AssertionError(f"waited in vain for {words!r}; MAVProxy said:\n{self.heard}") from None


async def session(console):
    await console.read(r"Received [0-9]+ parameters \(ftp\)", 40.0)
    for typed, words in SCRIPT:
        console.type(typed)
        if words:
            await console.read(re.escape(words))
        else:
            await asyncio.sleep(1.0)


@pytest.mark.parametrize("binary", [pytest.param(None, id="simulated"), *FIRMWARES])
def test_mavproxy_reads_parameters_arms_changes_mode_and_disarms(binary, tmp_path):
    async def scene():
        home = tmp_path / "home"
        home.mkdir()
        (tmp_path / "firmware").mkdir()
        async with autopilot(binary, tmp_path / "firmware") as (host, port):
            process = await asyncio.create_subprocess_exec(
                sys.executable, str(MAVPROXY), f"--master=tcp:{host}:{port}", "--no-state",
                f"--default-modules={MODULES}", stdin=PIPE, stdout=PIPE, stderr=STDOUT,
                cwd=home, env={**os.environ, "HOME": str(home), "PYTHONUNBUFFERED": "1"},
            )  # fmt: skip
            try:
                await session(Console(process))
            finally:
                if process.returncode is None:
                    process.kill()
                await process.communicate()

    asyncio.run(asyncio.wait_for(scene(), 200.0))
