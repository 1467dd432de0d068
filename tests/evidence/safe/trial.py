"""One trial of the kill matrix: simulator, wires and companion as processes of their own, and what became of it.

    with Trial(folder, sim=[...], run=[...]) as trial:
        trial.until_driving()
        t0_ns = trial.now();  trial.boat.kill()
        trial.observe(6.0)
    seen = trial.seen(t0_ns)

Truth is the simulator's: the 16 pulse widths that leave the simulated autopilot, every 10 ms of simulated time, which
is the machine's monotonic clock; and every override that reaches it.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from typing import Any, Self

from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.boat.load_run import EXAMPLES
from companion.core.messages import Alert, ModeStatus, OverrideLease, Tick
from companion.logs.log_file import LogFile
from companion.python_child import aritra, python
from tests.evidence.safe.pen import AT_REST, NEUTRAL_US, Override, Pen
from tests.evidence.safe.wire import TagWire, Wire

ROOT = Path(__file__).resolve().parents[3]
ARITRA = aritra()
ENV = {**os.environ, "PYTHONUNBUFFERED": "1", "OMP_NUM_THREADS": "1"}
DRIVING_US, DRIVING_S = 30, 3.0
"""The boat drives once a thruster has been so far off neutral, and so long afterwards it is broken."""
START_S = 90.0
END_S = 20.0
STEP_S = 0.01
ALL_RULES = ("outside", "elsewhere", "unleased")


class Station:
    """A ground station (system 255) on the simulator's TCP port."""

    def __init__(self, port: int):
        self._socket = socket.create_connection(("127.0.0.1", port), timeout=5)
        self._mav = dialect.MAVLink(None, 255, 190)

    def command(self, number: int, *params: float) -> None:
        """COMMAND_LONG to the autopilot."""
        filled = [*params, *[0.0] * (7 - len(params))]
        message = dialect.MAVLink_command_long_message(1, 1, number, 0, *filled)
        self._socket.sendall(message.pack(self._mav))

    def close(self) -> None:
        self._socket.close()


def free_port(kind: socket.SocketKind = socket.SOCK_DGRAM) -> int:
    """A port that nobody has now."""
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def run_file(folder: Path, replaced: Mapping[str, str], extra: str = "") -> Path:
    """The example's run file in `folder`, its paths made whole, texts `replaced`, `extra` at its end."""
    text = (EXAMPLES / "aritra.toml").read_text()
    for name in ("boats", "sites", "missions"):
        text = text.replace(f'"{name}/', f'"{EXAMPLES}/{name}/')
    for old, new in replaced.items():
        if old not in text:
            raise ValueError(f"the example's run file does not say {old!r}")
        text = text.replace(old, new)
    path = folder / "boat.toml"
    path.write_text(text + extra)
    return path


class Trial:
    """Processes and wires of one trial. `sim`, `run`: more words for either; `fault`: see companion_that_breaks."""

    def __init__(
        self,
        folder: Path,
        sim: Sequence[str] = (),
        run: Sequence[str] = ("--start",),
        fault: str = "",
        log: Path | None = None,
    ):
        self.folder, self.tcp = folder, free_port(socket.SOCK_STREAM)
        self.log = log or folder / "run.mcap"
        self.pen = Pen(folder / "pen.txt")
        self.exit_code: int | None = None
        self.boat: Any = None
        self._sim_words, self._run_words, self._fault = list(sim), list(run), fault
        self._children: list[subprocess.Popen] = []
        self._undo: list[Callable[[], None]] = []

    def __enter__(self) -> Self:
        try:
            self._begin()
        except BaseException:
            self.__exit__()
            raise
        return self

    def _begin(self) -> None:
        port = free_port()
        self.wire = Wire(port)
        self._undo.append(self.wire.close)
        self.tag = TagWire(self.folder / "tag", self.folder / "uwb")
        self._undo.append(self.tag.close)
        self.sim = self._start_sim()
        self._until(lambda: self.pen.read().steps, "the simulator does not step")
        self.boat = self.companion("run", ["--mavlink", f"udpin:127.0.0.1:{port}"], self._run_words, self._fault)

    def __exit__(self, *_: object) -> None:
        for child in reversed(self._children):
            if child.poll() is None:
                child.send_signal(signal.SIGCONT)
                child.terminate()
            with suppress(subprocess.TimeoutExpired):
                child.wait(END_S)
            if child.poll() is None:
                child.kill()
                child.wait()
            if child.stdin:
                child.stdin.close()
        self.exit_code = self.boat.returncode if self.boat else None
        for undo in reversed(self._undo):
            undo()
        self.pen.read()

    @staticmethod
    def now() -> int:
        """The clock of everything here [ns]."""
        return time.monotonic_ns()

    def companion(self, name: str, wires: Sequence[str], words: Sequence[str], fault: str = "") -> subprocess.Popen:
        """One more `aritra run`; its log is NAME.mcap but for the first."""
        command = [*ARITRA] if not fault else python("-m", "tests.evidence.safe.companion_that_breaks", fault)
        log = self.log if name == "run" else self.folder / f"{name}.mcap"
        command += ["run", *wires, "--uwb", f"serial:{self.folder}/uwb:115200", "--log", str(log), *words]
        return self._start(name, command)

    def station(self) -> Station:
        """A ground station that is closed at the end."""
        station = Station(self.tcp)
        self._undo.append(station.close)
        return station

    def order(self, line: str) -> None:
        """Tell the simulator's hands what to do."""
        assert self.sim.stdin
        self.sim.stdin.write(line.encode() + b"\n")
        self.sim.stdin.flush()

    def until_driving(self) -> None:
        """Until the thrusters turn, and `DRIVING_S` more. RuntimeError with what the companion said."""

        def driving() -> bool:
            step = self.pen.read().steps[-1]
            return step.armed and max(abs(p - NEUTRAL_US) for p in step.thrusters_us) >= DRIVING_US

        self._until(driving, "the boat does not drive")
        time.sleep(DRIVING_S)
        self._until(driving, "the boat does not drive on")

    def until(self, condition: Callable[[Trial], object], seconds: float = START_S) -> bool:
        """Wait for a condition; whether it came."""
        with suppress(RuntimeError):
            self._until(lambda: condition(self), "", seconds)
            return True
        return False

    def observe(self, seconds: float) -> None:
        """Let it go on."""
        time.sleep(seconds)

    def told(self, name: str = "run") -> str:
        """What a process printed."""
        return (self.folder / f"{name}.txt").read_text(errors="replace")

    def _until(self, condition: Callable[[], object], what: str, seconds: float = START_S) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if condition():
                return
            time.sleep(0.02)
        said = "\n".join(self.told(name)[-1500:] for name in ("sim", "run") if (self.folder / f"{name}.txt").exists())
        raise RuntimeError(f"{what} within {seconds:g} s:\n{said}")

    def _start_sim(self) -> subprocess.Popen:
        words = ["sim", "--udp-to", f"127.0.0.1:{self.wire.port}", "--tcp", f"127.0.0.1:{self.tcp}"]
        words += ["--uwb", str(self.folder / "tag"), "--truth", str(self.folder / "truth.mcap"), *self._sim_words]
        command = python("-m", "tests.evidence.safe.watched_sim", *words)
        return self._start("sim", command, SIM_PEN=str(self.pen.path))

    def _start(self, name: str, command: Sequence[str], **more: str) -> subprocess.Popen:
        path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
        with (self.folder / f"{name}.txt").open("w") as out:
            child = subprocess.Popen(
                command,
                stdin=subprocess.PIPE if name == "sim" else subprocess.DEVNULL,
                stdout=out,
                stderr=subprocess.STDOUT,
                env={**ENV, "PYTHONPATH": path, **more},
            )
        self._children.append(child)
        return child

    # --- what became of it -------------------------------------------------------------------------

    def to_rest_s(self, t0_ns: int, end_ns: int, rest: frozenset[int] = AT_REST) -> float:
        """From `t0_ns` to the last motion before `end_ns` [s]: inf where there is motion in the last second."""
        moving = [s.t_ns for s in self.pen.steps if t0_ns <= s.t_ns <= end_ns and s.off_neutral(rest)]
        if not moving:
            return 0.0
        return float("inf") if end_ns - moving[-1] < 1_000_000_000 else (moving[-1] - t0_ns) * 1e-9 + STEP_S

    def after_override_s(self, end_ns: int) -> float:
        """From the last override that reached the autopilot to the last motion [s]; 0 where overrides outlast it."""
        moving = [s.t_ns for s in self.pen.steps if s.t_ns <= end_ns and s.off_neutral()]
        heard = [o.t_ns for o in self.pen.overrides if o.t_ns <= end_ns]
        return max(0.0, (moving[-1] - heard[-1]) * 1e-9 + STEP_S) if moving and heard else 0.0

    def thrusters(self, end_ns: int, rest: frozenset[int] = AT_REST) -> str:
        """What the thrusters did in the last second before `end_ns`."""
        last = [s.thrusters_us for s in self.pen.steps if end_ns - 1_000_000_000 <= s.t_ns <= end_ns]
        pulses = {p for each in last for p in each}
        if not pulses:
            return "not seen"
        if pulses <= AT_REST:
            return "no pulse" if pulses == {0} else "neutral"
        if pulses <= rest:
            return f"the pilot's {' '.join(map(str, sorted(pulses - AT_REST)))} us"
        return f"stay at {' '.join(map(str, last[-1]))} us" if len(set(last)) == 1 else "drive on"

    def broken_rules(self) -> dict[str, int]:
        """Of the whole trial: overrides that never may be, on either side of the wire; ticks without a lease."""
        overrides = [*self.pen.overrides, *(Override(t_ns, channels) for t_ns, channels in self.wire.sent)]
        found = sum(o.outside() for o in overrides), sum(o.elsewhere() for o in overrides), self._unleased()
        return dict(zip(ALL_RULES, found, strict=True))

    def _unleased(self) -> int:
        """Ticks without a lease. The last tick of a run that was killed or broke may be under way."""
        logs = self.parts()
        ticks = {m.index for log in logs for m in _messages(log, Tick)}
        leased = {m.index for log in logs for m in _messages(log, OverrideLease)}
        missing = ticks - leased
        return len(missing - {max(ticks, default=-1)} if self.exit_code != 0 else missing)

    def parts(self) -> list[Path]:
        """The first companion's log, in as many files as it took."""
        return [p for p in sorted(self.log.parent.glob(f"{self.log.stem}*.mcap")) if p.stat().st_size]

    def mode(self, until_ns: int) -> tuple[str, str]:
        """The companion's last mode before `until_ns`, and why, as its log tells."""
        told = [m for log in self.parts() for m in _messages(log, ModeStatus) if m.t_ns <= until_ns]
        return (told[-1].mode, told[-1].why) if told else ("?", "")

    def mode_after_s(self, mode: str, t0_ns: int) -> float:
        """When the companion first told this mode after `t0_ns` [s]; inf if never."""
        times = [
            m.t_ns for log in self.parts() for m in _messages(log, ModeStatus) if m.t_ns >= t0_ns and m.mode == mode
        ]
        return (min(times) - t0_ns) * 1e-9 if times else float("inf")

    def alert(self, since_ns: int, end_ns: int) -> str:
        """The first alert in between, of the worst level there is."""
        told = [m for log in self.parts() for m in _messages(log, Alert) if since_ns <= m.t_ns <= end_ns]
        worst = sorted(told, key=lambda m: ("error", "warning", "info").index(m.level))
        return worst[0].text if worst else ""

    def printed(self) -> str:
        """The last error that the first companion printed; what a lost log cannot hold stands there alone."""
        return next((line for line in reversed(self.told().splitlines()) if line.startswith("error: ")), "")

    def longest_gap_s(self, since_ns: int, end_ns: int) -> float:
        """The longest time without an override from the first companion, on the wire [s]."""
        times = [since_ns, *(t_ns for t_ns, _ in self.wire.sent if since_ns <= t_ns <= end_ns), end_ns]
        return max(after - before for before, after in pairwise(times)) * 1e-9


def _messages(log: Path, kind: type):
    return list(LogFile(log).messages(kind))
