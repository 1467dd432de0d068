"""Companion, simulator and router with the locks of telemetry as they are shipped."""

from __future__ import annotations

import contextlib
import os
import secrets
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import zenoh

from companion.boat.load_run import EXAMPLES
from companion.python_child import aritra
from tests.support.zenoh_fixture import config, free_port, wait_for

ROOT = Path(__file__).resolve().parents[3]
ZENOH = EXAMPLES / "zenoh"
BOAT = "aritra"
DENIALS = "warn,zenoh::net::routing::interceptor::access_control=trace"


class Range:
    """Companion, simulator and router, and what an attacker may have: `key`, the boat's command key."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.port, self._stack = folder, free_port(), contextlib.ExitStack()
        self.key, self.log = secrets.token_bytes(32), folder / "run.mcap"
        self.out, self.router_out = folder / "run.txt", folder / "router.txt"

    def __enter__(self) -> Range:
        with self._stack:
            self._certificates()
            router = [sys.executable, ZENOH / "router.py", self.folder / "router.json5"]
            self.router = self._popen(router, self.router_out, RUST_LOG=DENIALS)
            wait_for(lambda: "router" in self.router_out.read_text(), 20, self.router_out.read_text)
            udp, tag = free_port(), self.folder / "tag"
            program = aritra()
            self._popen([*program, "sim", "--udp-to", f"127.0.0.1:{udp}", "--uwb", tag], self.folder / "sim.txt")
            wires = ["--mavlink", f"udpin:127.0.0.1:{udp}", "--uwb", f"serial:{tag}:115200", "--log", self.log]
            self.boat = self._popen([*program, "run", "--config", self._run_file(), *wires], self.out)
            wait_for(lambda: "state estimate healthy" in self.out.read_text(), 180, self.out.read_text)
            wait_for(lambda: "is connected" in self.out.read_text(), 20, self.out.read_text)
            self._stack = self._stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    @contextlib.contextmanager
    def person(self, name: str, pki: Path | None = None, **more: object) -> Iterator[zenoh.Session]:
        """A session with the certificate of `name`; of another authority's folder: `pki`."""
        text = (self.folder / "shore.json5").read_text()
        file = self.folder / f"person-{secrets.token_hex(4)}.json5"
        file.write_text(text.replace(f"{self.folder}/anna.", f"{pki or self.folder}/{name}."))
        made = config(
            "client", connect=[f"tls/127.0.0.1:{self.port}"], file=file, **{"connect/timeout_ms": 1500, **more}
        )
        with zenoh.open(made) as session:
            yield session

    def whole(self) -> bool:
        """Neither companion nor router has ended."""
        return self.boat.poll() is None and self.router.poll() is None

    def _certificates(self) -> None:
        names = [BOAT, "anna", "watch", "stranger"]
        subprocess.run([ZENOH / "make-certificates", self.folder, "127.0.0.1", *names], check=True, capture_output=True)
        for file in ("boat", "shore", "router"):
            text = (ZENOH / f"{file}.json5").read_text().replace("0.0.0.0:7447", f"127.0.0.1:{self.port}")
            for place in ("/etc/aritra/zenoh", "pki"):
                text = text.replace(f'"{place}/', f'"{self.folder}/')
            (self.folder / f"{file}.json5").write_text(text.replace("/boat.", f"/{BOAT}."))

    def _run_file(self) -> Path:
        text = (EXAMPLES / "aritra.toml").read_text()
        for name in ("boats", "sites", "missions"):
            text = text.replace(f'"{name}/', f'"{EXAMPLES}/{name}/')
        key, file = self.folder / "command.key", self.folder / "run.toml"
        key.write_bytes(self.key)
        key.chmod(0o600)
        link = f'connect = ["tls/127.0.0.1:{self.port}"]\nconfig = "boat.json5"\n'
        file.write_text(f'{text}\n[telemetry]\n{link}commands = true\ncommand_key = "command.key"\n')
        return file

    def _popen(self, words: list, out: Path, **more: str) -> subprocess.Popen:
        file = self._stack.enter_context(out.open("w"))
        child = subprocess.Popen(
            list(map(str, words)), stdout=file, stderr=subprocess.STDOUT, env=os.environ | more | {"NO_COLOR": "1"}
        )
        self._stack.callback(end, child)
        return child


def end(child: subprocess.Popen) -> None:
    child.send_signal(signal.SIGINT)
    try:
        child.wait(20)
    except subprocess.TimeoutExpired:
        child.kill()
        child.wait()
