"""`aritra identify LOG...`: from logs to a vessel file for the controller, and which model predicts better.

polars, statsmodels and matplotlib are optional (extra `analysis`): modules that need them are imported at first use.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table
from rich.text import Text

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
from companion.cli.options.files import any_log, log_beside, site_file, vessel_file
from companion.cli.options.outputs import add_out
from companion.cli.options.values import number, seconds, seed
from companion.core.configuration.tables import ConfigError

if TYPE_CHECKING:
    from companion.logs.readers.read_run import ReadOptions
    from sim.fitting.engine.split import NamedLog
    from sim.fitting.identify.job import Identification

DONE, LOOK = 0, 1
UNITS = ("", "[m]", "[rad]", "[m/s]", "[m/s]", "[rad/s]", "[%]")


def add_parser(commands) -> None:
    """Add `identify` to the command line."""
    p = commands.add_parser(
        "identify",
        help="fit the boat's model to logs, and judge it on data that no fit has seen",
        description="Fits the structured model of a vessel file and the paper's 23-term Taylor series to logs, runs "
        "both against data that was held out, and writes vessel.toml (identified, loads as it is), taylor.json, "
        "report.html and identify.json. Existing files are never overwritten. Exit code 0: done; 1: done, but "
        "something must be looked at before the model is used (the end of the output says what); 2: bad input.",
        example="aritra identify out/demo/run.mcap --vessel deploy/boats/aritra.toml --out out/identify",
    )
    p.add_argument(
        "logs", type=any_log, nargs="+", metavar="LOG", help=".mcap, .csv, .parquet, .bin, .tlog of one boat"
    )
    p.add_argument(
        "--vessel", type=vessel_file, required=True, metavar="FILE", help="vessel file to start from (the prior)"
    )
    add_out(p, "DIR", "folder for the results", required=True)
    held = p.add_mutually_exclusive_group()
    by = "log to judge by, seen by no fit (repeatable; default: the last quarter of each log)"
    held.add_argument("--held-out", type=any_log, action="append", default=[], metavar="LOG", help=by)
    held.add_argument(
        "--block", type=seconds(0.1, 1e6), metavar="S", help="hold out every other block of S seconds instead"
    )
    p.add_argument("--as-found", action="store_true", help="tell wrong signs and sides, but put none of them right")
    p.add_argument("--no-taylor", action="store_true", help="leave the Taylor series out")
    p.add_argument("--peer", action="store_true", help="pysindy on the same samples as an outside peer")
    p.add_argument("--site", type=site_file, metavar="FILE", help="site file (default: the one in the log)")
    p.add_argument("--uwb", type=log_beside, metavar="LOG", help="UWB log beside a single .bin or .tlog")
    p.add_argument(
        "--uwb-offset", type=number(-1e10, 1e10), metavar="S", help="add to its Unix stamps to have the log's clock"
    )
    p.add_argument("--seed", type=seed, default=0, metavar="N", help="of the noise study and the stability test")
    p.set_defaults(function=identify)


def identify(args: argparse.Namespace, console: Console | None = None) -> int:
    """Fit, validate, write and print the results; the exit code."""
    try:
        from companion.logs.readers.read_run import ReadOptions
        from sim.fitting.identify import (
            job,
            record,
        )
        from sim.fitting.identify.structured_fit import FitSettings
        from sim.fitting.wiring import check
        from sim.fitting.wiring.record import VESSEL
        from sim.whole_file import write_all_or_none
    except ImportError as error:
        return refuse("identify", f"{error}; {how_to_install('analysis')} brings what identification needs")
    console = console or Console()
    try:
        beside_them = [args.uwb] if args.uwb else []
        inputs = opened(args, (*args.logs, *args.held_out, *beside_them), (*record.OUTPUTS, VESSEL))
        vessel = inputs.vessel
        if args.uwb and len(args.logs) + len(args.held_out) > 1:
            raise ConfigError("--uwb goes with a single LOG; join each with its own by `aritra log export` first")
        beside = ReadOptions(vessel, inputs.site, uwb=args.uwb, uwb_offset_s=args.uwb_offset)
        choices = job.Choices(
            block_s=args.block,
            taylor=not args.no_taylor,
            peer=args.peer,
            seed=args.seed,
            settings=FitSettings(compass=not args.as_found),
        )
        with progress_of(console) as progress, one_thread():
            say = bars(progress, ("reading", "signs and sides", *job.STEPS, "report"))
            logs, held_out = _read(args.logs, beside, say, 0.0), _read(args.held_out, beside, say, 0.5)
            say("reading", "", 1.0)
            found = check.checked(logs, held_out, vessel, as_found=args.as_found, say=partial(say, "signs and sides"))
            identification = job.identify(found.logs, found.held_out, found.vessel, choices, now_utc, say)
            identification = identification.with_wiring(found.wiring)
            say("report", "tables and pictures", 0.0)
            files = record.outputs(identification, inputs.vessel_text, versions(), sys.argv[1:])
            write_all_or_none(args.out, files)
            say("report", "", 1.0)
    except REFUSED as error:
        return refuse("identify", error)
    _print(identification, args.out, files, console)
    return LOOK if identification.verdict.attention or identification.wiring.findings else DONE


def _read(
    paths: Sequence[Path], beside: ReadOptions, say: Callable[[str, str, float], None], begin: float
) -> list[NamedLog]:
    from companion.logs.readers.read_run import read_run
    from sim.fitting.engine.split import NamedLog

    logs = []
    for i, path in enumerate(paths):
        say("reading", path.name, begin + 0.5 * i / len(paths))
        logs.append(NamedLog(str(path), read_run(path, beside)))
    return logs


def _print(identification: Identification, out: Path, files: dict[str, bytes], console: Console) -> None:
    """The verdict, one table, what to look at, what was written."""
    console.print()
    for line in identification.wiring.lines:
        console.print(Text(line, style="bold yellow"))
    for line in identification.verdict.lines:
        console.print(Text(line))
    console.print(_models(identification))
    for line in identification.verdict.attention:
        console.print(Text(f"look: {line}", style="bold yellow"))
    for names, manoeuvre in identification.verdict.advice:
        console.print(Text(f"to know more of {', '.join(names)}: {manoeuvre}"))
    for line in identification.wiring.open_lines:
        console.print(Text(line))
    console.print(Text(f"held out: {identification.split.rule}"))
    for name, data in files.items():
        digest = hashlib.sha256(data).hexdigest()[:12]
        console.print(Text(f"wrote {out / name} ({len(data) / 1000:.0f} kB, {digest})"), soft_wrap=True)


def _models(identification: Identification) -> Table:
    """A row for each model: its error over the better baseline's, rms errors 10 s ahead, runs that diverge."""
    from sim.fitting.validate.table import error_rows, stability_rows

    scores, errors = identification.validation.scores, identification.verdict.relative_error
    figures = error_rows(scores, (10,))
    title = "Held-out data, open loop with the same commands: rms errors after 10 s"
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    table.add_column("model", no_wrap=True)
    for head, unit in zip(("error", "position", "heading", "u", "v", "r", "gone"), UNITS, strict=True):
        table.add_column(Text(f"{head}\n{unit}"), justify="right", no_wrap=True)  # as a str, [m] would be markup
    diverged = stability_rows(identification.validation)[0]
    for i, score in enumerate(scores, 1):
        share = errors.get(score.name)
        share_text = "-" if share is None else f"{100 * share:.3g} %" if share < 100 else "gone"
        cells = [share_text, *(row[i] for row in figures), diverged[i].removesuffix(" %")]
        table.add_row(score.name, *(Text(c.strip("*"), style="bold" if c.startswith("**") else "") for c in cells))
    return table
