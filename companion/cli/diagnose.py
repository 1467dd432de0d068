"""`aritra diagnose LOG...`: errors of the simulation, their causes, and the gain of correcting them.

polars and matplotlib are optional (extra `analysis`): modules that need them are imported at first use.
"""

from __future__ import annotations

import argparse
import sys
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec.structs import replace
from rich.console import Console
from rich.table import Table
from rich.text import Text

import deploy
from companion.cli.analysis import (
    REFUSED,
    bars,
    now_utc,
    one_thread,
    opened,
    progress_of,
    refuse,
    versions,
)
from companion.cli.options.extras import how_to_install
from companion.cli.options.files import any_log, python_file, site_file, text_of, vessel_file
from companion.cli.options.outputs import add_out
from companion.cli.options.values import seconds, seed
from companion.core.excitation.file import load_excitation

if TYPE_CHECKING:
    from sim.fitting.diagnose.job import Diagnosis

DONE, LOOK = 0, 1
SETTLED = ("none", "named")
LIBRARY = Path(deploy.__file__).parent / "excitations" / "library.toml"


def add_parser(commands) -> None:
    """Add `diagnose` to the command line."""
    p = commands.add_parser(
        "diagnose",
        help="say what the simulation gets wrong, why, and what correcting it is worth",
        description="Compares a vessel file with logs of the boat, names what is wrong with it (a thruster, a current, "
        "a compass ..) with sizes and intervals, and writes extended.toml (the vessel file with the causes), "
        "refitted.toml, extended_numbers.toml, report.html and findings.json. Existing files are never overwritten. "
        "Exit code 0: nothing is wrong, or what is wrong is named; 1: done, but something is left unexplained, cannot "
        "be told apart, or may be the log's own fault; 2: bad input.",
        example="aritra diagnose out/demo/run.mcap --vessel deploy/boats/aritra.toml --out out/diagnosis",
    )
    p.add_argument(
        "logs", type=any_log, nargs="+", metavar="LOG", help=".mcap, .csv, .parquet, .bin, .tlog of one boat"
    )
    p.add_argument("--vessel", type=vessel_file, required=True, metavar="FILE", help="vessel file: what is believed")
    add_out(p, "DIR", "folder for the results", required=True)
    p.add_argument("--reference", type=any_log, metavar="LOG", help="log of the same boat while all was well, in calm")
    held = p.add_mutually_exclusive_group()
    by = "log to judge by, seen by no fit (repeatable; default: the last quarter of each log)"
    held.add_argument("--held-out", type=any_log, action="append", default=[], metavar="LOG", help=by)
    held.add_argument(
        "--block", type=seconds(0.1, 1e6), metavar="S", help="hold out every other block of S seconds instead"
    )
    p.add_argument("--catalogue", type=python_file, metavar="FILE.py", help="effects of your own; the file is run")
    p.add_argument(
        "--without", action="append", default=[], metavar="ID", help="an effect that shall not be known (repeatable)"
    )
    p.add_argument(
        "--believe", action="append", default=[], metavar="ID", help="a cause that is known to be there (repeatable): "
        "how large it is is found, and no other is looked for"
    )  # fmt: skip
    p.add_argument("--as-found", action="store_true", help="tell wrong signs and sides, but put none of them right")
    p.add_argument("--site", type=site_file, metavar="FILE", help="site file (default: the one in the log)")
    p.add_argument("--plan", action="store_true", help="write manoeuvre.toml also where no named cause is in doubt")
    p.add_argument("--no-report", action="store_true", help="findings and vessel files only, which is quicker")
    p.add_argument("--seed", type=seed, default=0, metavar="N", help="of the intervals by resampling")
    p.set_defaults(function=diagnose)


def diagnose(args: argparse.Namespace, console: Console | None = None) -> int:
    """Diagnose, write and print the results; the exit code."""
    try:
        from companion.logs.readers.read_run import ReadOptions, read_run
        from companion.logs.runs.problems import problem_sentences
        from sim.fitting.diagnose import job
        from sim.fitting.diagnose.catalogue import user
        from sim.fitting.diagnose.report import findings, record
        from sim.fitting.diagnose.selection import distinguishability
        from sim.fitting.engine.split import NamedLog
        from sim.fitting.wiring import check
        from sim.fitting.wiring.record import VESSEL
        from sim.whole_file import write_all_or_none
    except ImportError as error:
        return refuse("diagnose", f"{error}; {how_to_install('analysis')} brings what a diagnosis needs")
    console = console or Console()
    try:
        reference = [args.reference] if args.reference else []
        inputs = opened(args, (*args.logs, *args.held_out, *reference), (*findings.OUTPUTS, findings.MANOEUVRE, VESSEL))
        vessel, site = inputs.vessel, inputs.site
        more = user.user_effects(args.catalogue) if args.catalogue else (lambda _vessel: ())
        more(vessel)  # says what is wrong with it before a log is read
        library = load_excitation(text_of(LIBRARY), name=str(LIBRARY))
        identifiability = partial(distinguishability.distinguishability, library=library, site=site, always=args.plan)
        beside = ReadOptions(vessel, site)
        with progress_of(console) as progress, one_thread():
            say = bars(progress, ("reading", "signs and sides", *job.STEPS, "report"))

            def read(path: Path) -> NamedLog:
                say("reading", path.name, 0.0)
                run = read_run(path, beside)
                return NamedLog(str(path), type(run)(run.table, replace(run.meta, source=str(path))))

            logs, held_out, calm = ([read(p) for p in paths] for paths in (args.logs, args.held_out, reference))
            say("reading", "", 1.0)
            swaps = any(name.startswith("swapped_pair") for name in (*args.believe, *args.without))
            found = check.checked(
                logs, held_out, vessel, reference=calm, as_found=args.as_found or swaps,
                say=partial(say, "signs and sides"),
            )  # fmt: skip
            calm = [log.run for log in found.reference]
            diagnosis = job.diagnose(
                [log.run for log in found.logs], found.vessel, reference=calm[0] if calm else None,
                held_out=[log.run for log in found.held_out], block_s=args.block, more=more, without=args.without,
                known=args.believe, identifiability=identifiability, say=say, seed=args.seed, clock=time.monotonic,
            ).with_wiring(found.wiring, vessel)  # fmt: skip
            say("report", "" if args.no_report else "tables and pictures", 0.0)
            files = record.outputs(
                diagnosis, inputs.vessel_text, versions(), sys.argv[1:], now_utc(), not args.no_report
            )
            write_all_or_none(args.out, files)
            say("report", "", 1.0)
    except REFUSED as error:
        return refuse("diagnose", error)
    _print(diagnosis, args.out, files, console)
    told_only = [f for f in diagnosis.wiring.findings if f not in diagnosis.wiring.corrected]
    is_doubtful = told_only or problem_sentences(diagnosis.problems)
    return DONE if diagnosis.verdict in SETTLED and not is_doubtful else LOOK


def _print(diagnosis: Diagnosis, out: Path, files: dict[str, bytes], console: Console) -> None:
    """Print sentences, causes, gain and the files written."""
    from sim.fitting.diagnose.report.sentences import sentences

    console.print()
    first, *others = sentences(diagnosis)
    console.print(Text(first, style="bold" if diagnosis.verdict in SETTLED else "bold yellow"))
    for line in others:
        console.print(Text(line))
    if diagnosis.causes:
        console.print(_causes(diagnosis))
    console.print(_gain(diagnosis))
    for name, data in files.items():
        console.print(Text(f"wrote {out / name} ({len(data) / 1000:.0f} kB)"), soft_wrap=True)


def _causes(diagnosis: Diagnosis) -> Table:
    table = Table(box=None, pad_edge=False)
    for head in ("cause", "parameter", "value", "95 % interval", "unit", "nats"):
        table.add_column(head, justify="left" if head in ("cause", "parameter") else "right", no_wrap=True)
    for n in diagnosis.causes:
        for i, (key, number) in enumerate(n.numbers.items()):
            low, high = number.ci95
            cells = (f"{number.value:.4g}", f"{low:.4g} to {high:.4g}", number.unit)
            table.add_row(n.effect.name if i == 0 else "", key, *cells, f"{n.candidate.nats:.0f}" if i == 0 else "")
        if not n.numbers:
            table.add_row(n.effect.name, "", "", "", "", f"{n.candidate.nats:.0f}")
    return table


def _gain(diagnosis: Diagnosis) -> Table:
    """Errors on held-out logs after 10 s."""
    from sim.fitting.diagnose.report.sentences import SHOWN_S

    title = f"Held-out logs, open loop with the same commands: rms errors of readings after {SHOWN_S} s"
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    for head in ("channel", "as given", "refitted", "with causes", "gain"):
        table.add_column(head, justify="left" if head == "channel" else "right", no_wrap=True)
    for e in (e for e in diagnosis.held_out.errors if e.horizon_s == SHOWN_S):
        cells = (f"{e.rms[m]:.3g}" for m in ("base", "refit", "extended"))
        table.add_row(f"{e.channel} [{e.unit}]".replace("[", r"\["), *cells, f"{100 * e.gain:.0f} %")
    return table
