"""Evidence for safety: in whatever order the devices and programs come up, all are online soon after the last one.

Four come up: the simulator (autopilot and tag), the tag's cable, the companion (idle), and the shore: a zenoh router
as a process (deploy/zenoh/router.py) and a console that listens through it.

Online: the companion says so of both links, and the console hears the boat's telemetry. A program is up once it says so
itself: the simulator's line, the companion's first word about its links, after it has built the controller, the
console's session with the router; how long that takes from its start is told beside it.
"""

from __future__ import annotations

import contextlib
import itertools
import random
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import zenoh

from companion.core.messages import LinkStatus
from companion.core.telemetry.structs import telemetry_key
from companion.logs.log_file import LogFile
from companion.python_child import python
from tests.evidence.line import Line, at_most, exactly, information
from tests.evidence.safe.pen import Pen
from tests.evidence.safe.trial import ARITRA, ENV, ROOT, free_port, run_file
from tests.evidence.safe.wire import TagWire

WHO = ("simulator", "companion", "tag", "shore")
ORDERS, SEED = 10, 1
PAUSE_S = 0.2, 3.0
"""Between two of them: drawn anew each time."""
ONLINE_S = 3.0
WATCH_S = 8.0
"""How long after the last one the end is looked at."""
UP_S, END_S = 60.0, 20.0
ALL = 3
"""Both links of the companion, and the console."""
STALE_NS = 2_000_000_000
"""A console that has heard nothing for so long at the end is not online: topics come at 10 Hz and 1 Hz; assumed."""
ROUTER = ROOT / "deploy/zenoh/router.py"
_QUIET = "scouting: {multicast: {enabled: false}, gossip: {enabled: false}}"
_ROUTER = f'{{mode: "router", listen: {{endpoints: ["tcp/127.0.0.1:%d"]}}, {_QUIET}}}'
_CLIENT = f'{{mode: "client", connect: {{endpoints: ["tcp/127.0.0.1:%d"]}}, {_QUIET}}}'


class Shore:
    """A console that listens through the router at `port`. `up_ns`: session open; `heard_ns`: first and last sample."""

    def __init__(self, port: int):
        self.up_ns: int | None = None
        self.heard_ns: tuple[int, int] | None = None
        self._config = zenoh.Config.from_json5(_CLIENT % port)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop listening."""
        self._ended.set()
        self._thread.join(5)

    def _listen(self) -> None:
        while not self._ended.is_set():
            with contextlib.suppress(zenoh.ZError), zenoh.open(self._config) as session:
                self.up_ns = time.monotonic_ns()
                session.declare_subscriber(telemetry_key("*", "*"), self._hear)
                self._ended.wait()
            self._ended.wait(0.05)  # a router that is not up yet

    def _hear(self, sample: zenoh.Sample) -> None:
        now_ns = time.monotonic_ns()
        self.heard_ns = (self.heard_ns or (now_ns, 0))[0], now_ns


@dataclass(frozen=True)
class Boot:
    """What became of one order. Times [ns]: `asked` to come up, `up`, `online`; `moved`: a thruster ever turned."""

    order: Sequence[str]
    asked: dict[str, int]
    up: dict[str, int]
    online: dict[str, int]
    stayed: bool
    moved: bool
    exit_code: int | None

    @property
    def online_s(self) -> float:
        """From the last one up to all online; inf if not."""
        return self._since(max(self.up.values()))

    @property
    def from_asked_s(self) -> float:
        """The same from when the last one was started: with a program's own start."""
        return self._since(max(self.asked.values()))

    def _since(self, t_ns: int) -> float:
        return (max(self.online.values()) - t_ns) * 1e-9 if len(self.online) == ALL else float("inf")


class Bench:
    """A folder in which each of `WHO` may be brought up."""

    def __init__(self, folder: Path):
        self._folder, self._udp, self._router = folder, free_port(), free_port(socket.SOCK_STREAM)
        self._stack = contextlib.ExitStack()
        self._config = run_file(folder, {}, f'\n[telemetry]\nconnect = ["tcp/127.0.0.1:{self._router}"]\n')
        self._shore: Shore | None = None
        self._companion: subprocess.Popen | None = None
        self._asked: dict[str, int] = {}
        self._up: dict[str, int] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def bring_up(self, who: str) -> None:
        """Start one; the time is noted."""
        self._asked[who] = time.monotonic_ns()
        {
            "simulator": self._start_simulator,
            "companion": self._start_companion,
            "tag": self._plug_tag,
            "shore": self._open_shore,
        }[who]()

    def result(self, order: Sequence[str]) -> Boot:
        """Wait, end the companion, and read what happened."""
        self._wait(lambda: self._read("simulator").startswith("simulator:"))
        self._wait(lambda: bool(self._links()))
        assert self._companion and self._shore
        self._wait(lambda: self._shore and self._shore.up_ns)
        time.sleep(WATCH_S)
        heard_ns, end_ns = self._shore.heard_ns, time.monotonic_ns()
        self._companion.send_signal(signal.SIGINT)
        code = self._companion.wait(END_S)
        links = self._links()
        up = {**self._asked, "simulator": self._sim_up_ns(), "companion": min(m.t_ns for m in links),
              "shore": self._shore.up_ns or 0}  # fmt: skip
        online: dict[str, int] = {}
        for name in ("mavlink", "uwb"):
            told = [m for m in links if m.link == name]
            if told[-1].state == "online":
                online[name] = next(m.t_ns for m in reversed(told) if m.state == "online")
        if heard_ns and end_ns - heard_ns[1] < STALE_NS:
            online["shore"] = heard_ns[0]
        pen = Pen(self._folder / "pen.txt").read()
        moved = any(step.off_neutral() for step in pen.steps)
        return Boot(order, self._asked, up, online, len(online) == ALL, moved, code)

    def _start_simulator(self) -> None:
        words = ["sim", "--udp-to", f"127.0.0.1:{self._udp}", "--uwb", f"{self._folder}/tag", "--wiring", "gate"]
        command = python("-m", "tests.evidence.safe.watched_sim", *words)
        self._process("simulator", command, PYTHONPATH=str(ROOT), SIM_PEN=f"{self._folder}/pen.txt")

    def _start_companion(self) -> None:
        wires = ["--mavlink", f"udpin:127.0.0.1:{self._udp}", "--uwb", f"serial:{self._folder}/uwb:115200"]
        command = [*ARITRA, "run", "--config", str(self._config), *wires, "--log", f"{self._folder}/run.mcap"]
        self._companion = self._process("companion", command)

    def _plug_tag(self) -> None:
        self._stack.callback(TagWire(self._folder / "tag", self._folder / "uwb").close)

    def _open_shore(self) -> None:
        config = self._folder / "router.json5"
        config.write_text(_ROUTER % self._router)
        self._process("router", [sys.executable, str(ROUTER), str(config)])
        self._shore = Shore(self._router)
        self._stack.callback(self._shore.close)

    def _process(self, name: str, command: Sequence[str], **more: str) -> subprocess.Popen:
        with (self._folder / f"{name}.txt").open("w") as out:
            child = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=out, stderr=subprocess.STDOUT, env={**ENV, **more}
            )
        self._stack.callback(_end, child)
        return child

    def _read(self, name: str) -> str:
        return (self._folder / f"{name}.txt").read_text()

    def _links(self) -> list[LinkStatus]:
        log = self._folder / "run.mcap"
        if not log.exists() or not log.stat().st_size:
            return []
        return list(LogFile(log).messages(LinkStatus))

    def _sim_up_ns(self) -> int:
        return Pen(self._folder / "pen.txt").read().steps[0].t_ns

    def _wait(self, condition: Callable[[], bool]) -> None:
        end = time.monotonic() + UP_S
        while not condition():
            if time.monotonic() > end:
                raise RuntimeError(f"not up within {UP_S:g} s: {self._read('simulator')} {self._read('companion')}")
            time.sleep(0.1)


def _end(child: subprocess.Popen) -> None:
    if child.poll() is None:
        child.terminate()
    try:
        child.wait(END_S)
    except subprocess.TimeoutExpired:
        child.kill()
        child.wait()


def booted(order: Sequence[str], pauses_s: Sequence[float]) -> Boot:
    """Bring them up in this order."""
    with tempfile.TemporaryDirectory() as folder, Bench(Path(folder)) as bench:
        for who, pause_s in zip(order, pauses_s, strict=True):
            bench.bring_up(who)
            time.sleep(pause_s)
        return bench.result(order)


def lines(full: bool) -> Iterator[Line]:
    """Ten of the 24 orders, by seed; with `full` all."""
    rng = random.Random(SEED)
    orders = list(itertools.permutations(WHO))
    if not full:
        orders = rng.sample(orders, ORDERS)
    boots = []
    for order in orders:
        boot = booted(order, [*(rng.uniform(*PAUSE_S) for _ in order[1:]), 0.0])
        boots.append(boot)
        note = f"{boot.from_asked_s:.1f} s from its start; came last: {max(boot.up, key=boot.up.__getitem__)}"
        yield at_most(f"{', '.join(order)}: online after the last one", boot.online_s, ONLINE_S, "s", note)
    yield exactly("orders that did not stay online", sum(not b.stayed for b in boots), 0)
    yield exactly("orders in which a thruster moved", sum(b.moved for b in boots), 0)
    yield exactly("companions that did not end in order", sum(b.exit_code != 0 for b in boots), 0)
    yield information(
        "worst from the start of the last one, its own start-up counted", max(b.from_asked_s for b in boots), "s"
    )
