"""`aritra log page`: a log in a browser, as the live console would have shown it; one file, no network."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from rich.console import Console

from companion.cli.options.extras import how_to_install
from companion.cli.options.files import aritra_log, text_of, truth_log, vessel_file
from companion.cli.options.outputs import add_out, making, new_file
from companion.cli.options.values import number, seconds
from companion.core.configuration.tables import ConfigError
from companion.core.model.actuators.propulsion import only_fixed
from companion.core.model.load_vessel import load_vessel
from companion.logs.configuration import setup_in
from companion.logs.log_file import LogError, LogFile

if TYPE_CHECKING:
    from sim.fitting.validate.ghost import Overlay

OK, DAMAGED = 0, 1
EVERY_S = 5.0
"""Time until a ghost is reset to the estimate [s]. Longer pieces show mainly the errors of their start: with the
simulated boat's own model they ended 0.04 m and 4 degrees off after 5 s, 0.35 m and 26 degrees after 10 s (`aritra
demo`, seed 0)."""
NEEDS = f"ghosts need polars: leave them out with --no-ghosts, or {how_to_install('analysis')}"
Command = Callable[[argparse.Namespace], int]


def add_parser(commands: Any, guarded: Callable[[Command], Command], exit_codes: str) -> None:
    """Add `page` to the commands of `aritra log`."""
    p = commands.add_parser(
        "page",
        help="one HTML file: map and plots over time, as the live console shows them, with the simulation as a ghost",
        description="Beside what the boat did the page shows what its model says: open loop under the logged commands, "
        "put back onto the boat every few seconds. A second vessel file makes a second ghost.",
        epilog=exit_codes,
        example="aritra log page out/demo/run.mcap --truth out/demo/truth.mcap --out run.html",
    )
    p.add_argument("log", type=aritra_log, metavar="LOG", help="first file of a log of aritra run (NAME.mcap)")
    add_out(p, "FILE", "default: LOG.html beside it")
    p.add_argument("--vessel", type=vessel_file, metavar="FILE", help="base vessel file (default: the one in the log)")
    p.add_argument(
        "--extended", type=vessel_file, metavar="FILE", help="second vessel file, for example of aritra diagnose"
    )
    every = "seconds until a ghost is put back onto the boat (default: %(default)g)"
    p.add_argument("--every", type=seconds(0.1, 1e6), metavar="S", default=EVERY_S, help=every)
    p.add_argument("--no-ghosts", action="store_true", help="leave the simulation out")
    p.add_argument("--truth", type=truth_log, metavar="LOG", help="the simulator's log: ghosts start from the truth")
    rate = "samples a second (default: 10, fewer in logs of more than 20 minutes)"
    p.add_argument("--rate", type=number(1.0, 10.0, "samples a second"), metavar="HZ", help=rate)
    p.set_defaults(function=guarded(_run))


def _run(args: argparse.Namespace) -> int:
    from companion.logs.page import (
        html,
        view,
    )

    console, log = Console(), LogFile(args.log)
    given = {"--vessel": args.vessel, "--extended": args.extended, "--truth": args.truth}
    if args.no_ghosts and (odd := [name for name, value in given.items() if value]):
        raise LogError(f"{odd[0]} says nothing with --no-ghosts: leave one of them out")
    out = args.out or args.log.with_suffix(".html")
    new_file(out)
    with console.status(f"reading {args.log}") as status:
        length_s = duration_s(log)
        rate_hz = args.rate or view.rate_of(length_s)
        samples = view.samples(log, rate_hz)
        overlay, zero_ns = None, 0
        if not args.no_ghosts:
            overlay, zero_ns = _overlay(log, args, lambda text, _share: status.update(f"ghosts: {text}"))
        status.update("writing")
        data = view.page_data(log, samples, overlay, zero_ns)
        written = html.page(args.log.name, data)
        with making(out):
            out.write_bytes(written)
    ghosts = ", ".join(g.name for g in overlay.ghosts) if overlay else "none"
    size = f"{len(written) / 1e6:.1f} MB, {length_s:.0f} s at {rate_hz:.2g} Hz, ghosts: {ghosts}"
    for line in (f"wrote {out}: {size}", *log.damage):
        console.print(line, soft_wrap=True, highlight=False, markup=False)
    return DAMAGED if log.damage else OK


def duration_s(log: LogFile) -> float:
    """From the first message to the last [s]."""
    begin_ns = end_ns = None
    for entry in log.entries():  # not kept: ten hours have 24 million
        t_ns = entry.publish_time_ns
        begin_ns = t_ns if begin_ns is None else min(begin_ns, t_ns)
        end_ns = t_ns if end_ns is None else max(end_ns, t_ns)
    return 0.0 if begin_ns is None or end_ns is None else (end_ns - begin_ns) * 1e-9


def _overlay(log: LogFile, args: argparse.Namespace, say: Callable[[str, float], None]) -> tuple[Overlay, int]:
    """Ghosts, and the stamp at which their clock begins."""
    try:
        from companion.logs.readers.read_run import ReadOptions, read_run
        from sim.fitting.validate.ghost import GhostModel, overlay
    except ImportError:
        raise LogError(NEEDS) from None
    try:
        own = setup_in(log).pilot.vessel
        base = load_vessel(text_of(args.vessel), name=str(args.vessel)) if args.vessel else own
        only_fixed(base, str(args.vessel or log.path), "ghosts (leave them out with --no-ghosts)")
        GhostModel.of(str(args.vessel), base, own)
        models = [GhostModel.of("simulated (base)", base, base)]
        if args.extended:
            extended = load_vessel(text_of(args.extended), name=str(args.extended))
            GhostModel.of(str(args.extended), extended, base)
            models.append(GhostModel.of("simulated (extended)", extended, base))
        say("reading what was measured", 0.0)
        run = read_run(log.path, ReadOptions(vessel=base, truth=args.truth))
        return overlay(run, base, models, every_s=args.every, say=say), run.meta.zero_ns
    except OSError as error:
        raise LogError(f"{error.filename}: {error.strerror}") from None
    except ConfigError:
        raise
    except ValueError as error:  # RunError and JobError: the run lacks what a simulation needs
        raise LogError(f"{error}; without ghosts: --no-ghosts") from None
