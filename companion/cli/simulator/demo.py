"""`aritra demo`: simulator and companion as two processes on real wires, one mission, and how it went."""

from __future__ import annotations

import argparse
import contextlib
import fcntl
import json
import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from itertools import count
from pathlib import Path
from typing import IO

from rich.console import Console

from companion.boat.load_run import EXAMPLES, RunSetup, load_setup
from companion.cli.options.extras import how_to_install
from companion.cli.options.files import mission_file, run_file
from companion.cli.options.outputs import add_out, new_in_folder
from companion.cli.options.values import seconds
from companion.cli.simulator.fleet import FleetBoat, device_urls
from companion.cli.simulator.fleet_options import add_fleet_arguments, boats_of, folders_of
from companion.cli.simulator.world_options import add_world_arguments, check_start, world_arguments
from companion.core.configuration.tables import ConfigError
from companion.logs.log_file import LogError
from companion.python_child import dependent_aritra
from drivers.devices import devices_of

STATION_S = 5.0
"""How long the boat keeps station after the mission before the demo ends."""
RESULTS = ("summary.json", "picture.png", "run*.mcap", "truth*.mcap")
"""What a demo leaves in its folder, as patterns."""
MADE_OF_LOGS = ("run.html", "run.png", "run.pdf")
"""What `aritra log` makes of its log beside it; it goes with the log."""
LIMIT_S = 300.0
"""A demo that has not ended by then has failed."""


def add_parser(commands) -> None:
    """Add `demo` to the command line."""
    p = commands.add_parser(
        "demo",
        help="drive a mission in the simulator, no boat needed",
        description="Starts a simulated boat and the companion, two processes that talk MAVLink over UDP and the "
        "bytes of sensors over ptys, and drives a mission. Writes summary.json, picture.png, run.mcap and truth.mcap. "
        "With --boats several pairs, each with results of its own in OUT/NAME. "
        "Exit code 0: every waypoint passed, and driving was not stopped; 1: not; 2: bad input.",
        example="aritra demo --wind 4 270 --mismatch 0.1 --seed 3",
    )
    add_out(p, "DIR", "folder for the results (default: out/demo)", default=Path("out/demo"))
    p.add_argument("--config", type=run_file, metavar="FILE", default=EXAMPLES / "aritra.toml", help="run file (TOML)")
    p.add_argument("--mission", type=mission_file, metavar="FILE", help="mission instead of the run file's")
    add_world_arguments(p)
    add_fleet_arguments(p).add_argument(
        "--stagger", type=seconds(0.0, LIMIT_S), default=5.0, metavar="S", help="between the starts of two boats"
    )
    p.set_defaults(function=demo)


def demo(args: argparse.Namespace) -> int:
    """Drive, score, show; the exit code."""
    setup = load_setup(args.config, mission=args.mission)
    check_start(args, setup)
    with contextlib.ExitStack() as held:
        for folder in folders_of(args, setup).values() or [args.out]:
            held.enter_context(_alone_in(folder))
        return _demo(args, setup)


@contextlib.contextmanager
def _alone_in(folder: Path) -> Iterator[None]:
    """Make the folder, and keep other demos from taking away what is written there. Raises ConfigError."""
    new_in_folder(folder, ())
    try:
        held = os.open(folder, os.O_RDONLY)
    except OSError as error:
        raise ConfigError(f"{folder}: {error.strerror}") from None
    try:
        with contextlib.suppress(OSError):  # file systems without locks
            try:
                fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise ConfigError(f"another demo runs in {folder}: choose another --out") from None
        yield
    finally:
        os.close(held)


def _demo(args: argparse.Namespace, setup: RunSetup) -> int:
    boats = boats_of(args, setup, {}) or [FleetBoat("", args.out, args.config)]
    try:
        for boat in boats:
            _put_away(boat.folder)
    except OSError as error:
        print(f"aritra demo: {args.out}: {error.strerror}", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory(prefix="aritra-") as wires:
        failures = drive(args, boats, Path(wires), devices_of(setup.pilot.vessel.sensors))
    passed = [_score(boat, setup, failure) for boat, failure in zip(boats, failures, strict=True)]
    return 0 if all(passed) else 1


def _put_away(folder: Path) -> None:
    """Move the results of an earlier demo into a folder of their own: nothing is overwritten."""
    old = [path for pattern in (*RESULTS, *MADE_OF_LOGS) for path in sorted(folder.glob(pattern))]
    if old:
        away = next(place for n in count(1) if not (place := folder / f"earlier-{n}").exists())
        away.mkdir()
        for path in old:
            path.rename(away / path.name)
        print(f"the results of an earlier demo are in {away} now")


def _score(boat: FleetBoat, setup: RunSetup, failure: str | None) -> bool:
    """How it went: summary, picture, table, verdict; whether it passed."""
    from companion.cli.simulator import result_table, summary

    console = Console(soft_wrap=True, highlight=False)
    if boat.name:
        console.rule(boat.name, align="left")
    try:
        score = summary.summarise(_run_log(boat), _truth_log(boat), setup.pilot)
    except LogError:
        print(f"aritra demo: {_of(boat)}{failure or 'it left no log'}", file=sys.stderr)
        return False
    figures = json.dumps(summary.for_json(score), indent=2)
    (boat.folder / "summary.json").write_text(figures + "\n", encoding="utf-8")
    try:
        from companion.cli.simulator import picture
    except ImportError as error:
        console.print(f"no picture: {error}; {how_to_install('demo')} brings what draws it", markup=False)
    else:
        if len(score.track.t_s):
            picture.draw(score, setup.pilot, boat.folder / "picture.png")
    for line in result_table.lines(score.figures, score.stopped):
        console.print(line)
    names = ", ".join(path.name for pattern in RESULTS for path in sorted(boat.folder.glob(pattern)))
    console.print(f"in {boat.folder}: {names}", markup=False)
    if failure and not score.stopped:  # else the verdict has said why
        print(f"aritra demo: {_of(boat)}{failure}", file=sys.stderr)
    return not failure and result_table.passed(score.figures, score.stopped)


class _Pair:
    """A boat's two processes, simulator and companion. `name`: what their lines begin with."""

    def __init__(self, boat: FleetBoat, simulator: list[str], companion: list[str], name: str) -> None:
        self._boat, self._stack = boat, contextlib.ExitStack()
        self._simulator = self._stack.enter_context(_process(simulator, name))
        self._companion = self._stack.enter_context(_process(companion, name))
        self._deadline = time.monotonic() + LIMIT_S
        self.failure: str | None = None

    def goes_on(self) -> bool:
        """Whether the mission is still under way; if not, both have ended, and `failure` says what went wrong."""
        if (code := self._companion.poll()) is not None:
            self.failure = f"the companion ended with exit code {code}" if code else None
        elif (code := self._simulator.poll()) is not None:
            self.failure = f"the simulator ended with exit code {code}"
        elif time.monotonic() > self._deadline:
            self.failure = f"the mission was not done after {LIMIT_S:.0f} s; see {_run_log(self._boat)}"
        else:
            return True
        self.close()
        return False

    def close(self) -> None:
        """End what still runs."""
        self._stack.close()


def drive(
    args: argparse.Namespace, boats: Sequence[FleetBoat], wires: Path, keys: Sequence[str] = ("uwb",)
) -> list[str | None]:
    """All boats, one started after the other, until each is done; what went wrong, or None, for each.

    `keys`: sensors with a wire of their own.
    """
    pairs: list[_Pair] = []
    with contextlib.ExitStack() as stack:
        under_way, next_s = list[_Pair](), time.monotonic()
        while under_way or len(pairs) < len(boats):
            if len(pairs) < len(boats) and time.monotonic() >= next_s:
                next_s += args.stagger
                pairs.append(_start(args, boats, len(pairs), wires, keys))
                stack.callback(pairs[-1].close)
                under_way.append(pairs[-1])
            under_way = [pair for pair in under_way if pair.goes_on()]
            time.sleep(0.2)
    return [pair.failure for pair in pairs]


def _start(args: argparse.Namespace, boats: Sequence[FleetBoat], k: int, wires: Path, keys: Sequence[str]) -> _Pair:
    """Both processes of boat k, in a world with a seed of its own."""
    boat, port, uwb = boats[k], free_port(), wires / f"uwb-{k}"
    program = dependent_aritra()
    config = ["--config", str(boat.config)]
    mission = ["--mission", str(args.mission)] if args.mission else []
    own = world_arguments(argparse.Namespace(**vars(args) | {"seed": args.seed + k}))
    world = ["--udp-to", f"127.0.0.1:{port}", "--uwb", str(uwb), "--truth", str(_truth_log(boat))]
    urls = ["--mavlink", f"udpin:127.0.0.1:{port}", *device_options(keys, str(uwb)), "--log", str(_run_log(boat))]
    drive = [*program, "run", *config, *mission, *urls, "--start", "--end-after", str(STATION_S)]
    return _Pair(boat, [*program, "sim", *config, *world, *own], drive, boat.name if len(boats) > 1 else "")


def device_options(keys: Sequence[str], uwb_path: str) -> list[str]:
    """The simulated sensors' wires as options of `aritra run`."""
    urls = device_urls(keys, uwb_path).items()
    options = [("--uwb", url) if key == "uwb" else ("--device", f"{key}={url}") for key, url in urls]
    return [word for option in options for word in option]


def _run_log(boat: FleetBoat) -> Path:
    return boat.folder / "run.mcap"


def _truth_log(boat: FleetBoat) -> Path:
    return boat.folder / "truth.mcap"


def _of(boat: FleetBoat) -> str:
    return f"{boat.name}: " if boat.name else ""


@contextlib.contextmanager
def _process(command: list[str], name: str) -> Iterator[subprocess.Popen]:
    """A child process: SIGTERM, and SIGKILL after 10 s; its output lines begin with `name`, if it has one."""
    pipe = subprocess.PIPE if name else None
    child = subprocess.Popen(command, stdout=pipe, stderr=pipe and subprocess.STDOUT, text=True, errors="replace")
    try:
        if child.stdout:
            threading.Thread(target=_prefix_lines, args=(child.stdout, name), daemon=True).start()
        yield child
    finally:
        child.terminate()
        try:
            child.wait(10)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()


def _prefix_lines(lines: IO[str], name: str) -> None:
    for line in lines:
        print(f"{name}: {line}", end="", flush=True)


def free_port() -> int:
    """A UDP port of this machine that is free now."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]
