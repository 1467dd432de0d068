"""`aritra bench`: does the controller fit on this computer, and how does it stand beside other solvers?"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable

from rich.console import Console

from companion.boat.load_run import EXAMPLES
from companion.cli.analysis import REFUSED, refuse
from companion.cli.options.files import text_of, vessel_file
from companion.cli.options.outputs import new_file, output, picture
from companion.cli.options.values import seed, whole
from companion.core.configuration.tables import ConfigError
from companion.core.model.actuators.propulsion import only_fixed
from companion.core.model.load_vessel import load_vessel
from companion.logs.metadata import log_metadata

VESSEL = EXAMPLES / "boats" / "aritra.toml"
PROBLEMS = {"production": ("production",), "paper": ("paper",), "both": ("production", "paper")}
NOT_ALL = 1
PLAIN_S = 5.0
"""Period of progress lines without a terminal [s]; assumed."""


def add_parser(commands) -> None:
    """Add `bench` to the command line."""
    p = commands.add_parser(
        "bench",
        help="measure this computer: controller and other solvers, 10 Hz, simulation, fit, start-up",
        description="Measures in one run, in interleaved rounds, with nothing else to do: the controller beside the "
        "solvers that CasADi brings along, hot and at a true 10 Hz; simulation; a fit; start-up and memory. Ratios "
        "are to the fastest round of IPOPT. About two minutes; close other programs before. Exit code 0: done; 1: a "
        "part did not run; 2: bad input.",
        example="aritra bench --only solvers --rounds 1 --json bench.json",
    )
    p.add_argument(
        "--vessel", type=vessel_file, default=VESSEL, metavar="FILE", help="vessel file (default: aritra.toml)"
    )
    p.add_argument("--problem", choices=PROBLEMS, default="production", help="boat's own, the paper's, or both")
    p.add_argument(
        "--solve", type=whole(1, 100_000), default=200, metavar="N", help="recorded states a round and at 10 Hz (200)"
    )
    p.add_argument("--rounds", type=whole(1, 100_000), default=3, metavar="R", help="interleaved rounds (3)")
    p.add_argument("--seed", type=seed, default=1, metavar="N", help="of the drive that is recorded (1)")
    p.add_argument("--json", type=output, metavar="FILE", help="write every figure, and the machine, as JSON")
    p.add_argument("--only", default="", metavar="WORD", help="parts whose name holds WORD: solvers, cadence, "
                   "simulation, fit, start, growth")  # fmt: skip
    p.add_argument("--growth", action="store_true", help="instead: how costs grow with horizon, thrusters, logs and "
                   "catalogue (about five minutes)")  # fmt: skip
    p.add_argument("--picture", type=picture, metavar="FILE", help="draw growth (.png, .svg; extra `analysis`)")
    p.set_defaults(function=bench)


def bench(args: argparse.Namespace) -> int:
    """Measure, show, write; the exit code."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # one thread for every solver; read when IPOPT is first called
    from sim.bench import result, run, table
    from sim.bench.request import BenchRequest

    try:
        vessel = load_vessel(text_of(args.vessel), name=str(args.vessel))
        only_fixed(vessel, str(args.vessel), "benchmarks")
        if not run.chosen(args.only, args.growth):
            known = ", ".join(run.chosen("", args.growth))
            raise ConfigError(f"--only {args.only}: no part has that in its name; there are {known}")
        for path in (args.json, args.picture):
            new_file(path)
    except REFUSED as why:
        return refuse("bench", why)
    out = Console(highlight=False)
    order = BenchRequest(
        vessel, args.vessel, PROBLEMS[args.problem], args.solve, args.rounds, args.solve, args.seed, _progress()
    )
    about = log_metadata("", {})
    program = {"version": about["version"], "git_revision": about["git_revision"]}
    results = run.run(order, args.only, args.growth, program)
    order.progress("")
    table.show(out, results)
    if args.json:
        result.write(args.json, results)
        out.print(f"wrote {args.json}")
    if args.picture:
        from sim.bench.growth.picture import draw

        draw(results, args.picture)
        out.print(f"wrote {args.picture}")
    return NOT_ALL if results.refused else 0


def _progress() -> Callable[[str], None]:
    """The current measurement, on one line of the terminal; without a terminal a line every few seconds."""
    live, next_s = sys.stderr.isatty(), 0.0

    def progress(text: str) -> None:
        nonlocal next_s
        if live:
            sys.stderr.write(f"\r\x1b[2K{text[:78]}")
        elif text and time.monotonic() >= next_s:
            next_s = time.monotonic() + PLAIN_S
            sys.stderr.write(f"{text}\n")
        sys.stderr.flush()

    return progress
