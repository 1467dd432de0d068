"""`aritra demo`: simulator and companion as two processes on real wires, one mission, and how it went."""

from __future__ import annotations

import argparse
import contextlib
import json
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from companion.commands.sim import add_world_arguments, world_arguments
from companion.setup import EXAMPLES, load_setup

STATION_S = 5.0
"""How long the boat keeps station after the mission before the demo ends."""
LIMIT_S = 300.0
"""A demo that has not ended by then has failed."""


def add_parser(commands) -> None:
    """Add `demo` to the command line."""
    p = commands.add_parser(
        "demo",
        help="drive a mission in the simulator, no boat needed",
        description="Starts a simulated boat and the companion, two processes that talk MAVLink over UDP and UWB "
        "bytes over a pty, and drives a mission. Writes summary.json, picture.png, run.mcap and truth.mcap. "
        "Exit code 0: every waypoint passed; 1: not; 2: bad input.",
    )
    p.add_argument("--out", type=Path, default=Path("out/demo"), help="folder for the results")
    p.add_argument("--config", type=Path, default=EXAMPLES / "aritra.toml", help="run file (TOML)")
    add_world_arguments(p)
    p.set_defaults(function=demo)


def demo(args: argparse.Namespace) -> int:
    """Drive, score, show; the exit code."""
    from companion import demo_summary  # noqa: PLC0415  (scoring knows the simulator: not for the boat)

    setup = load_setup(args.config)
    run_log, truth_log = args.out / "run.mcap", args.out / "truth.mcap"
    try:
        args.out.mkdir(parents=True, exist_ok=True)
        for old in (run_log, truth_log):
            old.unlink(missing_ok=True)
    except OSError as error:
        print(f"aritra demo: {args.out}: {error.strerror}", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory(prefix="aritra-") as wires:
        failure = _drive(args, Path(wires), run_log, truth_log)
    if failure:
        print(f"aritra demo: {failure}", file=sys.stderr)
        return 1
    score = demo_summary.summarise(run_log, truth_log, setup.pilot)
    (args.out / "summary.json").write_text(json.dumps(demo_summary.finite(score.figures), indent=2) + "\n")
    demo_summary.show(score, args.out)
    try:
        from companion import demo_picture  # noqa: PLC0415  (matplotlib is an extra)
    except ImportError as error:
        print(f"no picture: {error}; `pip install aritra[analysis]` brings what draws it")
    else:
        demo_picture.draw(score, setup.pilot, args.out / "picture.png")
    return 0 if score.figures["waypoints_passed"] == score.figures["waypoints_total"] else 1


def _drive(args: argparse.Namespace, wires: Path, run_log: Path, truth_log: Path) -> str | None:
    """Both processes until the mission is done; what went wrong, or None."""
    port, uwb = _free_port(), wires / "uwb"
    aritra = [sys.executable, "-m", "companion"]
    config = ["--config", str(args.config)]
    world = ["--udp-to", f"127.0.0.1:{port}", "--uwb", str(uwb), "--truth", str(truth_log)]
    boat = ["--mavlink", f"udpin:127.0.0.1:{port}", "--uwb", f"serial:{uwb}:115200", "--log", str(run_log)]
    with (
        _process([*aritra, "sim", *config, *world, *world_arguments(args)]) as simulator,
        _process([*aritra, "run", *config, *boat, "--start", "--end-after", str(STATION_S)]) as companion,
    ):
        deadline = time.monotonic() + LIMIT_S
        while companion.poll() is None:
            if simulator.poll() is not None:
                return f"the simulator ended with exit code {simulator.returncode}"
            if time.monotonic() > deadline:
                return f"the mission was not done after {LIMIT_S:.0f} s; see {run_log}"
            time.sleep(0.2)
        return f"the companion ended with exit code {companion.returncode}" if companion.returncode else None


@contextlib.contextmanager
def _process(command: list[str]) -> Iterator[subprocess.Popen]:
    """A child that is asked to end, and made to after 10 s."""
    child = subprocess.Popen(command)
    try:
        yield child
    finally:
        child.terminate()
        try:
            child.wait(10)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]
