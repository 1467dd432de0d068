"""The image, built and run where a container tool works: the demo drives in it, and compose brings boats and console.

`docker` or `podman`, the first that answers; its settings (storage, network) are the machine's. Ten minutes: `matrix`.
"""

import asyncio
import contextlib
import json
import os
import re
import shutil
import socket
import subprocess
from pathlib import Path

import aiohttp
import pytest

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "deploy" / "container"
BASE = (FOLDER / "Containerfile").read_text().split("FROM ", 1)[1].split()[0]
CONSOLE = "http://127.0.0.1:8470"
IMAGE = "aritra-test"
"""Neither a user's image nor the volume with the results is touched."""

pytestmark = [pytest.mark.real_time, pytest.mark.long, pytest.mark.matrix]


def run(*words, timeout_s=600):
    out = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    env = os.environ | {"ARITRA_IMAGE": IMAGE}
    return subprocess.run(words, check=False, cwd=ROOT, timeout=timeout_s, env=env, **out)


@pytest.fixture(scope="module")
def tool():
    """A container tool that works here and has the base image."""
    tools = [name for name in ("docker", "podman") if shutil.which(name) and run(name, "info").returncode == 0]
    if not tools:
        pytest.skip("no container tool works here: neither `docker info` nor `podman info` answers")
    if run(tools[0], "image", "inspect", BASE).returncode and run(tools[0], "pull", BASE).returncode:
        pytest.skip(f"{tools[0]} cannot have the base image {BASE}")
    return tools[0]


@pytest.fixture(scope="module")
def image(tool):
    """As docs/container.md says."""
    built = run(tool, "build", "-t", IMAGE, "-f", "deploy/container/Containerfile", ".", timeout_s=1200)
    assert built.returncode == 0, built.stdout
    return IMAGE


def test_the_demo_drives_in_it_and_its_files_are_the_users(tool, image, tmp_path):
    user, volume = f"{os.getuid()}:{os.getgid()}", f"{tmp_path}:/data"
    started = [tool, "run", "--rm", "--init", "--user", user, "-v", volume, image]
    driven = run(*started, "demo", "--seed", "7", "--wind", "3", "45")
    assert driven.returncode == 0 and "PASSED" in driven.stdout, driven.stdout
    summary = json.loads((tmp_path / "out/demo/summary.json").read_text())
    assert summary["waypoints_passed"] == summary["waypoints_total"] > 0
    assert (tmp_path / "out/demo/run.mcap").stat().st_uid == os.getuid()
    info = run(*started, "log", "info", "out/demo/run.mcap")
    assert info.returncode == 0 and "run.mcap" in info.stdout, info.stdout


async def _boats(count, patience_s):
    """Names of the boats that the console shows, once they are `count`."""
    names: set[str] = set()
    async with asyncio.timeout(patience_s), aiohttp.ClientSession() as http:
        while True:
            try:
                async with http.ws_connect(f"{CONSOLE}/ws", origin=CONSOLE) as socket:
                    while len(names) < count:
                        names |= set((await socket.receive_json()).get("clocks", {}))
                    return names
            except (aiohttp.ClientError, TypeError):
                await asyncio.sleep(1.0)  # not up yet


@pytest.fixture
def compose(tool, image):
    """Puts words to the compose file. Its boats and its volume are gone at the end."""
    words = {"docker": ("docker", "compose"), "podman": ("podman-compose",)}[tool]
    version = run(*words, "version") if shutil.which(words[0]) else None
    if version is None or version.returncode:
        pytest.skip(f"`{' '.join(words)}` is not installed")
    if tool == "podman" and not re.search(r"version\s+(1\.[1-9]|[2-9])", version.stdout):
        pytest.skip("podman-compose before 1.1 puts no service on the host's network")
    with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", 8470), timeout=1.0):
        pytest.skip("a console runs on this computer: end it first")
    mine = (*words, "-p", IMAGE, "-f", str(FOLDER / "compose.yaml"))
    yield lambda *more: run(*mine, *more)
    run(*mine, "down", "--volumes")


def test_compose_brings_three_boats_to_the_console_and_they_can_be_stopped(compose):
    started = compose("up", "--detach")
    assert started.returncode == 0, started.stdout
    names = asyncio.run(_boats(3, 180.0))
    stopped = compose("exec", "-T", "shore", "aritra", "stop", "--command-key", "/data/")
    assert stopped.returncode == 0 and all(f"{name}: stopped after" in stopped.stdout for name in names), stopped.stdout
