"""The commands of docs/sitl.md, "Step by step", run as printed: real processes in real time, the firmware of ARDUROVER.

The build is left out: the named binary stands where the build would have put it. `~` is a folder of the test's own.
"""

import contextlib
import os
import re
import signal
import socket
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from tests.support.autopilots.firmware_rig import binaries
from tests.support.boat_processes import wait_for

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "sitl.md"
PORTS = ((socket.SOCK_DGRAM, 9002), (socket.SOCK_STREAM, 5760))
PATIENT_S = 900.0
"""For each event, on however busy a machine."""


def blocks():
    """The shell commands of "Step by step", block by block."""
    section = PAGE.read_text().split("## Step by step")[1].split("\n## ")[0]
    return [re.sub(r"^ {3}", "", block, flags=re.M) for block in re.findall(r"```sh\n(.*?)```", section, flags=re.S)]


def taken():
    """Ports of the page that somebody else has."""
    busy = []
    for kind, port in PORTS:
        with socket.socket(socket.AF_INET, kind) as probe:
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                busy.append(port)
    return busy


@contextlib.contextmanager
def terminal(block, out, environment):
    """A shell that runs a block; its whole session is ended at the end."""
    with out.open("w") as file:
        shell = subprocess.Popen(
            ["bash", "-ec", block], cwd=environment["HOME"], env=environment, stdin=subprocess.DEVNULL, stdout=file,
            stderr=subprocess.STDOUT, start_new_session=True,
        )  # fmt: skip
        try:
            yield shell
        finally:
            for number in (signal.SIGINT, signal.SIGKILL):
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(shell.pid, number)
                with contextlib.suppress(subprocess.TimeoutExpired):
                    shell.wait(30)


@pytest.fixture
def home(tmp_path):
    """A home where the page's paths lead to this checkout; the cache of machine code stays the user's."""
    (tmp_path / "aritra").symlink_to(ROOT)
    (tmp_path / "ardupilot/build/sitl/bin").mkdir(parents=True)
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    cache = os.environ.get("XDG_CACHE_HOME", str(Path.home() / ".cache"))
    return {**os.environ, "HOME": str(tmp_path), "PATH": path, "XDG_CACHE_HOME": cache, "PYTHONUNBUFFERED": "1",
            "PYTHONSAFEPATH": "1"}  # fmt: skip


def test_the_page_has_its_five_steps():
    found = blocks()
    assert [len(block.splitlines()) > 0 for block in found] == [True] * 5
    assert "waf rover" in found[0] and "gate.lua" in found[1] and "aritra sim" in found[2]
    assert "ardurover" in found[3] and "aritra check" in found[4] and "aritra run" in found[4]


@pytest.mark.long
@pytest.mark.real_time
@pytest.mark.firmware
@pytest.mark.flaky(reruns=1)
@pytest.mark.skipif(not binaries(), reason="ARDUROVER names no firmware (a desktop build of ArduPilot Rover)")
@pytest.mark.parametrize("binary", binaries(), ids=lambda path: path.parent.name)
def test_as_printed_the_boat_drives(binary, home, tmp_path):
    if busy := taken():
        pytest.skip(f"the page's ports {busy} are taken by another program")
    (tmp_path / "ardupilot/build/sitl/bin/ardurover").symlink_to(binary)
    _, prepare, sim, firmware, drive = blocks()
    done = subprocess.run(["bash", "-ec", prepare], cwd=tmp_path, env=home, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    outs = {name: tmp_path / f"{name}.txt" for name in ("sim", "firmware", "drive")}
    with terminal(sim, outs["sim"], home):
        wait_for(lambda: "waiting for ArduPilot" in outs["sim"].read_text(), PATIENT_S, outs["sim"].read_text)
        with terminal(firmware, outs["firmware"], home):
            said = partial(outs["firmware"].read_text, errors="replace")
            wait_for(lambda: "SERIAL0 on TCP port 5760" in said(), PATIENT_S, said)
            with terminal(drive, outs["drive"], home) as shell:
                said = outs["drive"].read_text
                wait_for(lambda: "waypoint 1/" in said() or shell.poll() is not None, PATIENT_S, said)
                assert "waypoint 1/" in said(), said()[-3000:]
    assert "frame 0" in outs["sim"].read_text()
