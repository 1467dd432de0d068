"""A real ArduPilot in software and our physics as one world in lockstep: `World`'s calls, with the firmware's answers.

    step() -> Outgoing          10 ms on: in frames of 2.5 ms, a servo packet and a state each
    mavlink(data, peer)         bytes to the firmware's first serial port; what it says comes out of `step`
    receiver_us                 pulse widths of an RC receiver, where the setup has one

Simulated time alone counts: the firmware waits for each state, and each step for the firmware's scripts
(`script_thread`), so that a busy machine makes it slow and nothing else.
Bytes that the firmware has sent before a servo packet are read before that packet is answered.
"""

from __future__ import annotations

import os
import shutil
import signal
import socket
import struct
import subprocess
import time
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import IO

from companion.core.messages import GroundTruth
from companion.python_child import end_with
from sim.world.sitl.backend import JsonBackend
from sim.world.sitl.board import VOLTAGE_V
from sim.world.sitl.physics import SitlPhysics
from sim.world.sitl.protocol import PORT, NotServos, decode
from sim.world.world import STEP_NS, Outgoing, WorldSetup
from tests.support.autopilots.script_thread import ScriptThread

FRAME_HZ = 400
TCP_PORT, RC_PORT = 5760, 5501
START_S, ANSWER_S, LOOK_S = 20.0, 20.0, 0.2
"""How long [s, this machine's clock] a firmware may take to listen, and to answer a state; after how long a silence its
serial port is looked at, where one that has started again waits until somebody connects. Assumed."""
INSTANCES = range(20, 256)
"""ArduPilot's -I, tried in order until its ports are free; each moves them by 10."""
HERE = {
    "SIM_RC_FAIL": 1,
    "SIM_RATE_HZ": FRAME_HZ,
    "SIM_BATT_VOLTAGE": VOLTAGE_V,
    "BATT_MONITOR": 4,
    "MAV_GCS_SYSID": 1,
    **{f"INS_ACC{n}OFFS_{axis}": 0.001 for n in ("", "2") for axis in "XYZ"},
    **{f"INS_ACC{n}SCAL_{axis}": 1.001 for n in ("", "2") for axis in "XYZ"},
}
"""Parameters of the simulated board: no receiver, battery, and accelerometers that count as calibrated (the last two as
in ArduPilot's own autotest/default_params/rover.parm)."""


class FirmwareStopped(RuntimeError):
    """The firmware ended, or answers no more; the text has its last words."""


@dataclass(frozen=True)
class FirmwareSetup:
    """Which firmware, started how. `folder`: where it runs, empty; `parameter_files`: loaded as defaults, in order;
    `parameters`: on top of them; `scripts`: Lua files that are on its card.
    """

    binary: Path
    folder: Path
    parameter_files: Sequence[Path] = ()
    parameters: Mapping[str, float] = field(default_factory=dict)
    scripts: Sequence[Path] = ()


class FirmwareWorld:
    """One boat whose autopilot is a firmware of its own. `pulses`: (t_ns, pulse widths) where they changed."""

    def __init__(self, setup: WorldSetup, seed: int, firmware: FirmwareSetup):
        self.physics = SitlPhysics(setup, seed)
        self.pulses: list[tuple[int, tuple[int, ...]]] = []
        self.receiver_us = setup.receiver_us
        self._peers: list[Hashable] = []
        self._backend = JsonBackend(self.physics)
        self._udp, self._instance = _listen()
        self._out = (firmware.folder / "console.txt").open("wb")
        self._process = _start(firmware, setup, self._instance, self._out)
        self._script = ScriptThread(self._process.pid)
        self._tcp = socket.socket()
        try:
            self._connect()
        except FirmwareStopped:
            self.close()
            raise

    @property
    def t_ns(self) -> int:
        """Simulated time [ns]."""
        return self.physics.world.t_ns

    @property
    def second_port(self) -> tuple[str, int]:
        """Where the firmware's second MAVLink port (SERIAL1) listens, for a client of its own."""
        return "127.0.0.1", TCP_PORT + 10 * self._instance + 2

    def step(self) -> Outgoing:
        """Advance the world by `STEP_NS`, or by what a frame is longer."""
        until_ns = (self.t_ns // STEP_NS + 1) * STEP_NS
        if self.receiver_us:
            frame = struct.pack(f"<{len(self.receiver_us)}H", *self.receiver_us)
            self._udp.sendto(frame, ("127.0.0.1", RC_PORT + 10 * self._instance))
        self._script.wait_for_turn()
        mavlink, uwb = b"", b""
        while self.t_ns < until_ns:
            packet, sender, heard = self._packet()
            mavlink += heard + self._read()
            answer = self._backend.receive(packet, sender, time.monotonic_ns())
            if answer is not None:
                uwb += answer.uwb
                self._udp.sendto(answer.data, sender)
        return Outgoing([(peer, mavlink) for peer in self._peers] if mavlink else [], uwb)

    def add_peer(self, peer: Hashable) -> None:
        """All peers share the one wire."""
        self._peers.append(peer)

    def mavlink(self, data: bytes, peer: Hashable = None) -> bytes:
        """Bytes to the firmware; its answer comes with a later step."""
        try:
            self._tcp.sendall(data)
        except OSError:
            raise FirmwareStopped(self._words("closed its serial port")) from None
        return b""

    def uwb(self, data: bytes) -> bytes:
        """Bytes from the companion to the UWB tag now; its answer."""
        return self.physics.world.uwb(data)

    def truth(self) -> GroundTruth:
        """What really is."""
        return self.physics.world.truth()

    def close(self) -> None:
        """End the firmware; may be called twice."""
        self._process.kill()
        self._process.wait()
        for each in (self._tcp, self._udp, self._out):
            each.close()

    def _packet(self) -> tuple[bytes, tuple[str, int], bytes]:
        """The firmware's next servo packet, where it came from, and what was said on its serial port meanwhile."""
        heard, end_s = b"", time.monotonic() + ANSWER_S
        while True:
            try:
                data, sender = self._udp.recvfrom(4096)
                break
            except TimeoutError:
                heard += self._read()
                if time.monotonic() > end_s:
                    raise FirmwareStopped(self._words(f"sent no servo packet for {ANSWER_S:.0f} s")) from None
        try:
            pulses = decode(data).outputs_us
        except NotServos:
            return data, sender, heard
        if not self.pulses or self.pulses[-1][1] != pulses:
            self.pulses.append((self.t_ns, pulses))
        return data, sender, heard

    def _read(self) -> bytes:
        """What the firmware has sent on its serial port."""
        data = b""
        while True:
            try:
                more = self._tcp.recv(65536)
            except BlockingIOError:
                return data
            except OSError:
                more = b""
            if not more:  # it ends its serial port when it starts again
                self._connect()
                return data
            data += more

    def _connect(self) -> None:
        """Open the firmware's first serial port, once it listens."""
        until_s = time.monotonic() + START_S
        while time.monotonic() < until_s and self._process.poll() is None:
            self._tcp.close()
            self._tcp = socket.socket()
            try:
                self._tcp.connect(("127.0.0.1", TCP_PORT + 10 * self._instance))
            except OSError:
                time.sleep(0.05)
                continue
            self._tcp.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._tcp.setblocking(False)
            return
        raise FirmwareStopped(self._words("does not listen"))

    def _words(self, what: str) -> str:
        self._out.flush()
        last = Path(self._out.name).read_text(encoding="utf-8", errors="replace").strip().splitlines()[-3:]
        return (
            f"the firmware {what}"
            + (f" (exit code {code})" if (code := self._process.poll()) else "")
            + (f"; its last words: {' / '.join(last)}" if last else "")
        )


def _listen() -> tuple[socket.socket, int]:
    """A socket where an instance of the firmware will send its servo packets, and the number of that instance."""
    for instance in INSTANCES:
        udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            udp.bind(("127.0.0.1", PORT + 10 * instance))
            with socket.socket() as tcp:
                tcp.bind(("127.0.0.1", TCP_PORT + 10 * instance))
        except OSError:
            udp.close()
            continue
        udp.settimeout(LOOK_S)
        return udp, instance
    raise FirmwareStopped("no free ports for a firmware")


def _start(firmware: FirmwareSetup, setup: WorldSetup, instance: int, out: IO[bytes]) -> subprocess.Popen[bytes]:
    """The firmware's process, at home at the site's origin."""
    folder, site = firmware.folder, setup.site
    (folder / "scripts").mkdir(exist_ok=True)
    for script in firmware.scripts:
        shutil.copy(script, folder / "scripts")
    here = folder / "here.param"
    receiver = {"SIM_RC_FAIL": 0} if setup.receiver_us else {}
    values = {**HERE, **receiver, **firmware.parameters}
    here.write_text("".join(f"{name},{value:g}\n" for name, value in values.items()), encoding="utf-8")
    files = ",".join(str(path) for path in [*firmware.parameter_files, here])
    home = f"{site.lat_deg},{site.lon_deg},0,0"
    words = [firmware.binary, "--model", "JSON:127.0.0.1", "--home", home, "--speedup", 1000, f"-I{instance}", "-w",
             "--defaults", files]  # fmt: skip
    # It ends with this process: that of a killed run would keep its ports and answer the next one.
    return subprocess.Popen(
        [*map(str, words)], cwd=folder, stdout=out, stderr=subprocess.STDOUT,
        preexec_fn=partial(end_with, os.getpid(), signal.SIGKILL),  # noqa: PLW1509 - of the one thread here
    )  # fmt: skip
