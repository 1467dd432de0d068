"""`aritra excite design | info | next | fly`: manoeuvres that make the boat's parameters visible.

`aritra run --excite FILE` flies a plan on the boat; `fly` flies it in the simulator, as fast as it computes.
polars and matplotlib are optional (extra `analysis`): modules that need them are imported at first use.
"""

from __future__ import annotations

import argparse
import json
import shlex
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from companion.boat.load_run import EXAMPLES, RunSetup
from companion.cli.options.extras import how_to_install
from companion.cli.options.files import any_log, excitation_file, run_file, site_file, text_of, vessel_file
from companion.cli.options.outputs import add_out, new_file, new_in_folder, picture
from companion.cli.options.setup import setup_instead
from companion.cli.options.values import number
from companion.cli.simulator.world_options import add_world_arguments
from companion.core.configuration.tables import ConfigError
from companion.core.excitation.file import Excitation, excitation_toml, load_excitation
from companion.core.excitation.pen import Pen
from companion.logs.log_file import LogError

if TYPE_CHECKING:
    from sim.fitting.excite.information import Knowledge

DONE, FAILED, BAD_INPUT = 0, 1, 2
LIBRARY = EXAMPLES / "excitations" / "library.toml"
PLAN, DESIGN = "deploy/excitations/library.toml", "design --minutes 3 --out plan.toml"
FLOWN = ("run.mcap", "truth.mcap", "flight.json", "picture.png")
"""What a flight leaves in its folder."""
EXIT_CODES = "Exit code 0: done; 1: the flight did not come to its end; 2: bad input."


def add_parser(commands) -> None:
    """Add `excite` and its subcommands to the command line."""
    p = commands.add_parser(
        "excite",
        help="manoeuvres for identification: choose, judge beforehand, fly in the simulator",
        description="Excitation: manoeuvres inside the fence from which a boat's parameters can be identified. "
        "`aritra run --excite FILE` flies a plan on the boat. " + EXIT_CODES,
        example=f"aritra excite {DESIGN}",
    )
    kinds = p.add_subparsers(dest="kind", required=True, metavar="WHAT")
    d = _subcommand(kinds, "design", "choose manoeuvres for the time there is", design, DESIGN)
    _boat(d)
    _library(d)
    d.add_argument(
        "--minutes",
        type=number(0.25, 120.0, "a number of minutes"),
        default=5.0,
        metavar="MIN",
        help="time there is (default: 5)",
    )
    d.add_argument("--criterion", choices=("d", "worst"), default="d", help="all parameters, or the worst-known one")
    add_out(d, "PLAN", "excitation file (TOML) to write", required=True)
    d.add_argument("--picture", type=picture, metavar="PNG", help="draw the plan as the file's own boat would fly it")
    i = _subcommand(kinds, "info", "what a plan would tell of each parameter, before it is flown", info, f"info {PLAN}")
    i.add_argument("plan", type=excitation_file, metavar="PLAN", help="excitation file (TOML)")
    _boat(i)
    _logs(i)
    n = _subcommand(
        kinds, "next", "what is still undetermined, and what to fly next", propose, "next --log out/demo/run.mcap"
    )
    _boat(n)
    _library(n)
    f = _subcommand(
        kinds,
        "fly",
        "fly a plan in the simulated world; writes logs and a picture",
        fly,
        f"fly {PLAN} --out out/flight",
    )
    f.add_argument("plan", type=excitation_file, metavar="PLAN", help="excitation file (TOML)")
    _boat(f)
    add_out(f, "DIR", "folder for " + ", ".join(FLOWN), required=True)
    add_world_arguments(f)
    f.set_defaults(start=None)


def _subcommand(kinds, name: str, text: str, function, example: str) -> argparse.ArgumentParser:
    about = f"{text[0].upper()}{text[1:]}. {EXIT_CODES}"
    p = kinds.add_parser(name, help=text, description=about, example=f"aritra excite {example}")
    p.set_defaults(function=_guarded(function))
    return p


def _boat(p: argparse.ArgumentParser) -> None:
    p.add_argument("--config", type=run_file, metavar="FILE", default=EXAMPLES / "aritra.toml", help="run file (TOML)")
    p.add_argument("--vessel", type=vessel_file, metavar="FILE", help="vessel file instead of the run file's")
    p.add_argument("--site", type=site_file, metavar="FILE", help="site file instead of the run file's")


def _logs(p: argparse.ArgumentParser) -> None:
    p.add_argument(
        "--log", type=any_log, action="append", default=[], metavar="LOG", help="what is known already (repeat)"
    )


def _library(p: argparse.ArgumentParser) -> None:
    _logs(p)
    p.add_argument(
        "--library", type=excitation_file, default=LIBRARY, metavar="FILE", help="excitation file to choose from"
    )


def _guarded(function):
    """Run a subcommand; its errors become a message and an exit code."""

    def run(args: argparse.Namespace) -> int:
        try:
            return function(args, Console())
        except ImportError as error:
            print(f"aritra excite: {error}; {how_to_install('analysis')} brings what it needs", file=sys.stderr)
        except LogError as error:
            print(f"aritra excite: {error}", file=sys.stderr)
        except OSError as error:
            print(f"aritra excite: {error.filename}: {error.strerror}", file=sys.stderr)
        return BAD_INPUT

    return run


def design(args: argparse.Namespace, console: Console) -> int:
    """Choose a plan, print its expected information, write it; the exit code."""
    from sim.fitting.excite import design as chooser
    from sim.fitting.excite import table
    from sim.fitting.excite.information import planned_information

    for path in (args.out, args.picture):
        new_file(path)
    setup, budget_s = _setup(args), 60.0 * args.minutes
    now, library = _knowledge(args, setup, console), _read(args.library)
    known, left_out = _candidates(library, setup, console)
    chosen = chooser.choose(now, known, budget_s, args.criterion)
    if not chosen:
        shortest = min(c.duration_s for c in known)
        raise ConfigError(f"--minutes: the shortest segment of {args.library} takes {shortest / 60:.2f} min")
    plan, flown = chooser.design(now, library, chosen, setup.pilot.site, budget_s, name=args.out.stem)
    after = now.with_information(planned_information(flown.run, setup.pilot.vessel))
    console.print(table.choices(chosen[: len(plan.segments)], now, chooser.least_share(now, known)))
    console.print(table.expected(now, after, "Expected, by the noise of the vessel file's sensors alone"))
    summary = (
        f"{len(plan.segments)} segments, {flown.duration_s:.0f} s, no nearer than {flown.least_clearance_m:.1f} m "
        f"to the fence; {table.worst_open(after)}"
    )
    comment = (
        f"Made by `aritra excite design` for vessel {setup.pilot.vessel.name}, site {setup.pilot.site.name}.\n{summary}"
    )
    args.out.write_text(excitation_toml(plan, comment), encoding="utf-8")
    for line in (
        *left_out,
        summary,
        f"wrote {args.out}; fly it with `aritra run --excite {shlex.quote(str(args.out))}`",
    ):
        console.print(line, highlight=False, markup=False, soft_wrap=True)
    if args.picture:
        _picture_of_plan(flown, plan, setup, args.picture)
    return DONE


def info(args: argparse.Namespace, console: Console) -> int:
    """Print the expected information of a plan; the exit code."""
    from sim.fitting.excite import table
    from sim.fitting.excite.information import planned_information
    from sim.fitting.excite.nominal import fly_nominal

    setup = _setup(args, args.plan)
    plan = _planned(setup)
    now = _knowledge(args, setup, console)
    flown = fly_nominal(plan, setup.pilot.vessel, setup.pilot.site)
    after = now.with_information(planned_information(flown.run, setup.pilot.vessel))
    console.print(table.expected(now, after, "Expected, by the noise of the vessel file's sensors alone"))
    end = "" if flown.done else "; IT DOES NOT COME TO ITS END"
    console.print(
        f"{flown.duration_s:.0f} s, {flown.least_clearance_m:.1f} m from the fence; {table.worst_open(after)}{end}"
    )
    return DONE if flown.done else FAILED


def propose(args: argparse.Namespace, console: Console) -> int:
    """What to fly next; the exit code."""
    from sim.fitting.excite import design as chooser
    from sim.fitting.excite import table

    setup = _setup(args)
    now = _knowledge(args, setup, console)
    known, left_out = _candidates(_read(args.library), setup, console)
    advice = chooser.advise(now, known)
    console.print(table.next_steps(advice))
    for line in (*table.reasons(advice), *left_out, *table.proposal(advice)):
        console.print(line, highlight=False, markup=False, soft_wrap=True)
    return DONE


def fly(args: argparse.Namespace, console: Console) -> int:
    """Fly a plan in the simulated world; the exit code."""
    from companion.cli.simulator.world_options import world_setup
    from sim.fitting.excite import fly as flying
    from sim.fitting.excite import picture

    setup = _setup(args, args.plan)
    if args.start is None:
        args.start = (*map(float, setup.pilot.pen.middle), 0.0)
    world = world_setup(args, setup)
    new_in_folder(args.out, FLOWN)
    begin_unix_ns = time.time_ns()
    with console.status("flies") as status:
        flown = flying.fly(setup, world, args.seed, lambda text: status.update(f"flies: {text}"))
    run, truth = flying.write_logs(flown, setup, args.out, begin_unix_ns)
    for note in flying.notes(flown):
        line = f"{note.t_ns * 1e-9:7.1f} s  {note.level}: {note.text}"
        console.print(line, highlight=False, markup=False, soft_wrap=True)
    figures = {
        "done": flown.done,
        "ending": flown.ending,
        "duration_s": round(flown.duration_s, 2),
        "least_clearance_m": round(flown.least_clearance_m, 3),
        "turned_back": sum("turned back" in note.text for note in flying.notes(flown)),
        "seed": args.seed,
    }
    (args.out / "flight.json").write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
    if flown.statuses:
        title = (
            f"{_planned(setup).name}: {flown.duration_s:.0f} s, {flown.least_clearance_m:.1f} m from the fence at least"
        )
        names = [t.name for t in setup.pilot.vessel.thrusters]
        shown = picture.flight_trace(flown.truths, flown.statuses)
        picture.draw_flight(shown, _planned(setup), setup.pilot.pen, names, title, args.out / "picture.png")
    console.print(f"{flown.ending}; wrote {run}, {truth}", highlight=False, markup=False, soft_wrap=True)
    return DONE if flown.done else FAILED


def _setup(args: argparse.Namespace, plan: Path | None = None) -> RunSetup:
    """The run file's setup with the vessel, site and plan of the command line. Raises ConfigError."""
    instead = {"vessel.toml": args.vessel, "site.toml": args.site, "excitation.toml": plan}
    return setup_instead(args.config, instead, "excitations", driven=False)


def _planned(setup: RunSetup) -> Excitation:
    assert setup.pilot.excitation is not None  # `_setup` was given a plan
    return setup.pilot.excitation


def _read(path: Path) -> Excitation:
    return load_excitation(text_of(path), name=str(path))


def _knowledge(args: argparse.Namespace, setup: RunSetup, console: Console) -> Knowledge:
    """Prior knowledge of the parameters: from logs, or the vessel file alone. Raises ConfigError naming the log."""
    from companion.cli.analysis import REFUSED
    from companion.logs.readers.read_run import ReadOptions, read_run
    from sim.fitting.excite.information import Knowledge, recorded_knowledge

    vessel = setup.pilot.vessel
    if not args.log:
        return Knowledge.prior(vessel)
    with console.status("fits the logs"):
        try:
            runs = [read_run(path, ReadOptions(vessel, setup.pilot.site)) for path in args.log]
            return recorded_knowledge(runs, vessel)
        except REFUSED as error:
            raise ConfigError(str(error)) from None


def _candidates(library: Excitation, setup: RunSetup, console: Console):
    """Segments of the library that this boat can fly here, and a line for each that it cannot."""
    from sim.fitting.excite.design import candidates

    with console.status("flies the library") as status:
        segments, left_out = candidates(library, setup.pilot.vessel, setup.pilot.site, status.update)
    return segments, [f"left out: {text}" for text in left_out]


def _picture_of_plan(flown, plan: Excitation, setup: RunSetup, path: Path) -> None:
    """Draw a nominal flight."""
    from sim.fitting.excite import picture

    far = f"{flown.least_clearance_m:.1f} m from the fence at least"
    title = f"{plan.name}: {flown.duration_s:.0f} s by the vessel file's own boat, {far}"
    names = [t.name for t in setup.pilot.vessel.thrusters]
    pen = Pen(setup.pilot.site)  # a nominal flight knows no other fence
    picture.draw_flight(picture.flight_trace(flown.truths, flown.statuses), plan, pen, names, title, path)
