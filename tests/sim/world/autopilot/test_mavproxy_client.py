"""MAVProxy, as a person would run it, against the simulated autopilot."""

import asyncio
import os
import sys
from asyncio.subprocess import PIPE, STDOUT
from pathlib import Path

import pytest

from sim.world.autopilot.modes import Mode
from sim.world.autopilot.parameter_table import TABLE
from tests.sim.world.autopilot.autopilot_process import booted_rover, served, until

pytestmark = pytest.mark.alone

MAVPROXY = Path(sys.executable).with_name("mavproxy.py")


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
                while words not in self.heard[start:]:
                    data = await self._process.stdout.read(4096)
                    assert data, f"MAVProxy ended; it said:\n{self.heard}"
                    self.heard += data.decode(errors="replace")
        except TimeoutError:
            raise AssertionError(f"waited in vain for {words!r}; MAVProxy said:\n{self.heard}") from None


async def session(console, rover):
    vehicle, modes = rover.vehicle, rover.vehicle.modes
    await console.read(f"Received {len(TABLE)} parameters", 15.0)
    assert modes.mode is Mode.HOLD  # no RC input: it booted into HOLD
    console.type("param show SCHED_LOOP_RATE")
    await console.read("200.0")
    console.type("param set SERVO_RC_FS_MSK 3840")
    assert await until(lambda: vehicle.parameters["SERVO_RC_FS_MSK"] == 3840)

    console.type("mode MANUAL")
    await console.read("Mode MANUAL")
    assert modes.mode is Mode.MANUAL
    console.type("arm throttle")
    await console.read("ARMED")
    assert modes.armed
    console.type("mode HOLD")
    await console.read("Mode HOLD")
    assert modes.mode is Mode.HOLD
    console.type("mode GUIDED")
    await console.read("DO_SET_MODE: FAILED")
    assert modes.mode is Mode.HOLD
    console.type("disarm")
    await console.read("DISARMED")
    assert not modes.armed
    console.type("mode GUIDED")
    await console.read("Mode GUIDED")
    console.type("arm throttle")
    await console.read("Arm: Need Position Estimate")
    assert not modes.armed


@pytest.mark.long
def test_mavproxy_connects_reads_parameters_arms_changes_mode_and_disarms(tmp_path):
    async def scene():
        rover = booted_rover()
        async with served(rover) as (_, tcp):
            process = await asyncio.create_subprocess_exec(
                sys.executable, str(MAVPROXY), f"--master=tcp:127.0.0.1:{tcp[1]}", "--no-state",
                stdin=PIPE, stdout=PIPE, stderr=STDOUT,
                cwd=tmp_path, env={**os.environ, "HOME": str(tmp_path), "PYTHONUNBUFFERED": "1"},
            )  # fmt: skip
            try:
                await session(Console(process), rover)
                assert all(link.bad_data == 0 for link in rover.links.values())
            finally:
                if process.returncode is None:
                    process.kill()
                await process.communicate()

    asyncio.run(asyncio.wait_for(scene(), 60.0))
