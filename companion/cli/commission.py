"""`aritra commission`: from a first vessel file to one that drives well, stage by stage, on a boat or a simulated one.

Fits and flights of the simulator are imported at first use (extra `analysis`).
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec.structs import replace
from rich.console import Console
from rich.text import Text

from companion.boat.load_run import EXAMPLES, RunSetup
from companion.cli.analysis import now_utc, one_thread, refuse
from companion.cli.boat.wires import add_wires, devices_of_run, port_of
from companion.cli.options.extras import how_to_install
from companion.cli.options.files import excitation_file, mission_file, run_file, site_file, text_of, vessel_file
from companion.cli.options.outputs import add_out
from companion.cli.options.run_file_text import absolute, toml_of
from companion.cli.options.setup import setup_instead
from companion.cli.options.values import number
from companion.cli.simulator.world_options import add_world_arguments, given_of_world, world_setup
from companion.core.configuration.site_file import Site
from companion.core.configuration.tables import ConfigError
from companion.core.excitation.file import load_excitation

if TYPE_CHECKING:
    from sim.commission.boats import Boat, RealBoat, SimulatedBoat
    from sim.commission.job import CommissionOutcome, CommissionTask
    from sim.commission.journal import FlightJournal

DONE, NOT_REACHED = 0, 1
LEAST_MINUTES = 9.0
"""Those that are kept for proof and missions, and two flights of the signs."""
COUNTDOWN_S = 10
"""Before each flight of a boat that somebody may be holding; assumed."""
LIBRARY = EXAMPLES / "excitations" / "library.toml"
COMMISSIONED, REPORT = "commissioned.toml", "report.html"
BY = "aritra commission"
PROVEN_HEAD = f"By `{BY}`: proven."
EXAMPLE = "aritra commission --vessel deploy/boats/aritra.toml --site deploy/sites/basin.toml --out out/commission"


def add_parser(commands) -> None:
    """Add `commission` to the command line."""
    p = commands.add_parser(
        "commission",
        help="from a first vessel file to one that drives well",
        description="Flies what is worth most, fits all logs, and goes on until more is not worth its minutes: which "
        "thruster pushes where, delays, hull and gains, places of the sensors, current and wind; then proves the "
        "new vessel file on a manoeuvre that no fit has seen, and drives the mission with it. Started again with "
        "the same --out it goes on where it was stopped. Exit code 0: commissioned; 1: not, and it says why; 2: bad "
        "input.",
        example=EXAMPLE,
    )
    p.add_argument("--config", type=run_file, metavar="FILE", default=EXAMPLES / "aritra.toml", help="run file (TOML)")
    p.add_argument("--vessel", type=vessel_file, metavar="FILE", help="first vessel file instead of the run file's")
    p.add_argument("--site", type=site_file, metavar="FILE", help="site file instead of the run file's")
    p.add_argument("--mission", type=mission_file, metavar="FILE", help="mission to drive instead of the run file's")
    minutes = number(LEAST_MINUTES, 240.0, "minutes")
    p.add_argument("--minutes", type=minutes, default=30.0, metavar="MIN", help="of flight at most (default: 30)")
    p.add_argument("--library", type=excitation_file, default=LIBRARY, metavar="FILE", help="manoeuvres to choose from")
    add_out(p, "DIR", f"folder of the commissioning: {COMMISSIONED}, {REPORT}, logs", required=True)
    p.add_argument(
        "--simulate",
        type=vessel_file,
        metavar="FILE",
        help="no boat: a simulated one that is as this vessel file says, off it by --mismatch",
    )
    add_wires(p)
    add_world_arguments(p, start=None)
    p.set_defaults(function=commission)


def commission(args: argparse.Namespace, console: Console | None = None) -> int:
    """Commission, write and print what came of it; the exit code."""
    try:
        from sim.commission.job import CommissionTask
        from sim.commission.journal import FlightJournal
        from sim.commission.stages import check_library
    except ImportError as error:
        return refuse("commission", f"{error}; {how_to_install('analysis')} brings what it needs")
    console = console or Console()
    setup = _setup(args)
    library = load_excitation(text_of(args.library), name=str(args.library))
    setup.pilot.pen.check(library.margin_m, library.return_m, name=str(args.library))
    check_library(library, name=str(args.library))
    task = CommissionTask(
        files={**setup.files, "run.toml": _beside(setup, args.config.parent)},
        vessel=setup.pilot.vessel,
        site=setup.pilot.site,
        points=tuple(setup.pilot.mission.path.points),
        library=library,
        minutes=args.minutes,
        date=now_utc()[:10],
    )
    try:
        boat = _boat(args, setup)
        journal = FlightJournal(args.out, task.files, boat.name)
        with journal.held(), one_thread():
            outcome = _carried_out(task, boat, journal, console)
            files = write(outcome, args.out, journal, task.site)
    except OSError as error:
        print(f"aritra commission: {error.filename}: {error.strerror}", file=sys.stderr)
        return 2
    _print(outcome, args.out, files, console)
    return DONE if outcome.reached else NOT_REACHED


def _carried_out(task: CommissionTask, boat: Boat, journal: FlightJournal, console: Console) -> CommissionOutcome:
    """Run it, with what it says on the terminal."""
    from sim.commission.boats import RealBoat
    from sim.commission.job import Commissioning

    def say(text: str) -> None:
        console.print(Text(text), soft_wrap=True)

    if isinstance(boat, RealBoat):  # `aritra run` has the terminal
        return Commissioning(task, boat, journal, say).run()
    with console.status("begins") as status:
        return Commissioning(task, boat, journal, say, status.update).run()


def _setup(args: argparse.Namespace) -> RunSetup:
    """The run file's setup with the files of the command line, without an excitation. Raises ConfigError."""
    instead = {"vessel.toml": args.vessel, "site.toml": args.site}
    return setup_instead(args.config, instead, "commissioning flights", mission=args.mission)


def _beside(setup: RunSetup, folder: Path) -> str:
    """The run file, from `folder`, for the folder of a flight: its files are beside it, keys stay where they are."""
    (mission,) = (name for name in setup.files if name.startswith("mission"))
    run = replace(absolute(setup.run, folder), vessel="vessel.toml", site="site.toml", mission=mission, excitation=None)
    return toml_of(run)


def _boat(args: argparse.Namespace, setup: RunSetup) -> RealBoat | SimulatedBoat:
    from companion.core.model.load_vessel import load_vessel
    from sim.commission.boats import RealBoat, SimulatedBoat

    if args.simulate is None:
        if given := given_of_world(args):
            raise ConfigError(f"{given[0]}: only with --simulate: it is about a simulated world")
        port_of(args, "mavlink", setup.run.mavlink.url)
        devices_of_run(args, setup)
        wires = [("--mavlink", args.mavlink), ("--uwb", args.uwb)]
        wires += [("--device", f"{key}={url}") for key, url in args.device]
        return RealBoat(tuple(word for option, url in wires if url for word in (option, url)), fly_on, count_down)
    if args.mavlink or args.uwb or args.device:
        raise ConfigError("--mavlink, --uwb, --device: not with --simulate, which has no wires")
    if args.start is None:
        args.start = (*map(float, setup.pilot.pen.middle), 0.0)
    true = load_vessel(text_of(args.simulate), name=str(args.simulate))
    if len(true.controls) != len(setup.pilot.vessel.controls):
        controls = len(true.controls), len(setup.pilot.vessel.controls)
        raise ConfigError(
            f"--simulate: {args.simulate}: it has not as many thrusters as the first vessel file: {controls[0]}, not "
            f"{controls[1]}; to simulate your own boat name its own file, and --mismatch 0.2"
        )
    return SimulatedBoat(dataclasses.replace(world_setup(args, setup), vessel=true), args.seed)


def count_down() -> None:
    """Time to let go of the boat, or to press Ctrl-C: between flights no other STOP is listened to."""
    for left_s in range(COUNTDOWN_S, 0, -1):
        print(f"\rThrusters may turn in {left_s:2d} s. Ctrl-C: not yet. ", end="", flush=True)
        time.sleep(1.0)
    print("\r" + " " * 50, end="\r", flush=True)


def fly_on(ending: str) -> bool:
    """A person at this terminal, whether to fly on after a flight that ended so; without one: no."""
    if not sys.stdin.isatty():
        return False
    try:
        answer = input(f"The flight ended early ({ending}). Look at the boat: fly on? [y/N] ")
    except EOFError:
        return False
    return answer.strip().lower() in ("y", "yes")


def write(outcome: CommissionOutcome, out: Path, journal: FlightJournal, site: Site) -> dict[str, str]:
    """Vessel file and report; name -> what it is."""
    from sim.commission.report import report
    from sim.whole_file import write_whole

    files = {REPORT: "what each stage told, as a page"}
    # Before signs are known there is nothing to drive with, whatever has been fitted.
    if outcome.belief.fit is not None and outcome.belief.signs_known:
        files = {COMMISSIONED: _written(outcome, out / COMMISSIONED)} | files
    write_whole(out / REPORT, report(outcome, journal, site, files).encode())
    return files


def _written(outcome: CommissionOutcome, path: Path) -> str:
    """Write the vessel file, not over what a person has changed nor over a proven one; what the file there is."""
    from companion.core.model.vessel_text import vessel_toml
    from sim.commission.watch.history import changed_by_hand, marked
    from sim.whole_file import write_whole

    if changed_by_hand(path, BY):
        return "changed by hand and left as it is: move it away, and give the same command for the new one"
    if not outcome.reached and path.exists() and PROVEN_HEAD in path.read_text(encoding="utf-8"):
        return "of an earlier proof and left as it is; what is believed now is NOT PROVEN"
    head = PROVEN_HEAD if outcome.reached else "By `aritra commission`: NOT PROVEN."
    write_whole(path, marked(vessel_toml(outcome.vessel, head), BY).encode())
    return f"the vessel file to drive with, {'proven' if outcome.reached else 'NOT PROVEN'}"


def _print(outcome: CommissionOutcome, out: Path, files: dict[str, str], console: Console) -> None:
    from sim.commission.report import person, verdict

    for line in verdict(outcome):
        console.print(Text(line, style="bold"), soft_wrap=True)
    for line in person(outcome):
        console.print(Text(f"for you: {line}", style="yellow"), soft_wrap=True)
    for name, what in files.items():
        console.print(Text(f"wrote {out / name}: {what}"), soft_wrap=True)
