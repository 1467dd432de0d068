"""`aritra watch`: each mission's log refines the vessel file of a boat at work, and changes are told.

polars and matplotlib are optional (extra `analysis`): modules that need them are imported at first use.
"""

from __future__ import annotations

import argparse
import time
from typing import TYPE_CHECKING

from rich.console import Console
from rich.text import Text

from companion.cli.analysis import REFUSED, bars, one_thread, progress_of, refuse
from companion.cli.options.extras import how_to_install
from companion.cli.options.files import any_log, site_file, text_of, vessel_file
from companion.cli.options.outputs import output
from companion.core.configuration.site_file import load_site
from companion.core.configuration.tables import ConfigError
from companion.core.model.actuators.propulsion import only_fixed
from companion.core.model.load_vessel import load_vessel

if TYPE_CHECKING:
    from sim.commission.watch.history import History
    from sim.commission.watch.job import Outcome

DONE, LOOK = 0, 1
NAME = "watch"


def add_parser(commands) -> None:
    """Add `watch` to the command line."""
    p = commands.add_parser(
        "watch",
        help="refine the file of a boat at work by its logs, and tell what has changed",
        description="Takes the logs that are not yet in the boat's history into it, in order of their time; tells what "
        "has changed (a thruster, drag, load, delay), since when, with evidence; writes proposed.toml, a vessel file "
        "with what is believed now, its gain on missions that it had not seen, and history.html. Nothing is put in "
        "force without --accept, which writes the proposed file under a new name. Stopped at any moment it goes on "
        "where it was. Exit code 0: done; 1: a change was told, or a log could not be used or is doubtful; 2: bad "
        "input.",
        example="aritra watch out/demo/run.mcap --vessel deploy/boats/aritra.toml --history out/history",
    )
    p.add_argument(
        "logs", type=any_log, nargs="*", metavar="LOG", help=".mcap, .csv, .parquet, .bin, .tlog of one boat"
    )
    p.add_argument("--vessel", type=vessel_file, required=True, metavar="FILE", help="vessel file in force")
    p.add_argument("--history", type=output, required=True, metavar="DIR", help="folder of the boat's history")
    p.add_argument("--site", type=site_file, metavar="FILE", help="site file (default: the one in the log)")
    p.add_argument("--accept", action="store_true", help="yes to the proposed file: write it under a new name")
    p.set_defaults(function=watch)


def watch(args: argparse.Namespace, console: Console | None = None) -> int:
    """Take the logs in, print what is new; the exit code."""
    try:
        from sim.commission.watch import job
        from sim.commission.watch.history import History
    except ImportError as error:
        return refuse(NAME, f"{error}; {how_to_install('analysis')} brings what a watch needs")
    console = console or Console()
    try:
        text = text_of(args.vessel)
        vessel = load_vessel(text, name=str(args.vessel))
        only_fixed(vessel, str(args.vessel), "watches")
        site = load_site(text_of(args.site), name=str(args.site)) if args.site else None
        if args.accept and args.logs:
            raise ConfigError("--accept: goes without a LOG, so that what is accepted has been looked at")
        if args.history.exists() and not args.history.is_dir():
            raise ConfigError(f"--history {args.history}: is a file; name a folder")
        if not args.logs and not args.history.is_dir():
            raise ConfigError(f"--history {args.history}: there is no such folder; name a LOG to begin one")
        history = History(args.history, vessel, text)
        with progress_of(console) as progress, one_thread():
            say = bars(progress, ("logs",))
            outcome = job.watch(
                history, args.logs, site, lambda what, share: say("logs", what, share), now_unix_s=time.time()
            )
            say("logs", "", 1.0)
        _print(outcome, history, console)
        if args.accept:
            path = job.accept(history, time.time())
            console.print(Text(f"wrote {path}: use it as the vessel file from now on"), soft_wrap=True)
    except REFUSED as error:
        return refuse(NAME, error)
    return LOOK if outcome.told or outcome.unusable or outcome.doubtful else DONE


def _print(outcome: Outcome, history: History, console: Console) -> None:
    """What was taken in, what has changed, what the proposed file is worth."""
    from sim.commission.watch.history import PAGE, PROPOSED
    from sim.commission.watch.sentences import change_sentence, counted, proposal_sentences

    def line(text: str, style: str = "") -> None:
        console.print(Text(text, style=style), soft_wrap=True)

    for text in outcome.unusable:
        line(f"left out: {text}", "bold yellow")
    for text in outcome.in_part:
        line(f"known already: {text}", "bold yellow")
    for text in outcome.doubtful:
        line(f"look: {text}", "bold yellow")
    if history.given != outcome.in_force:
        now = history.folder / outcome.in_force
        line(f"look: --vessel is {history.given} of this history; in force, and what missions are judged by, is {now}: "
             "the boat is to drive by that one, name it", "bold yellow")  # fmt: skip
    known = f", {len(outcome.known)} known already" if outcome.known else ""
    taken, missions = counted(len(outcome.taken), "log"), counted(len(history.entries), "mission")
    line(f"{taken} taken in{known}; {missions} in {history.folder}")
    if outcome.course is None:
        return
    for i, change in enumerate(outcome.course.changes):
        line(change_sentence(change, history.entries), "bold yellow" if i in outcome.told else "")
    if not outcome.course.changes:
        line("Nothing has changed that these missions can show.")
    for text in proposal_sentences(outcome.course, outcome.since):
        line(text)
    line(f"wrote {history.folder / PROPOSED}, {history.folder / PAGE}; in force: {outcome.in_force}")
