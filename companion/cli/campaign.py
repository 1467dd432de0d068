"""`aritra campaign FILE`: many seeded missions, identifications or diagnoses, here or on a Dask cluster.

polars and matplotlib (extra `analysis`) and Dask (extra `campaign`) are optional, imported at first use.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from companion.cli.analysis import refuse
from companion.cli.options.extras import how_to_install
from companion.cli.options.files import campaign_file
from companion.cli.options.outputs import add_out
from companion.cli.options.values import whole
from companion.core.configuration.tables import ConfigError

if TYPE_CHECKING:
    from sim.campaign.cases import Case
    from sim.campaign.inputs import Inputs
    from sim.campaign.journal import Journal
    from sim.campaign.runners.cluster import Cluster
    from sim.campaign.runners.job import CaseOutcome
    from sim.campaign.runners.local import Local
    from sim.fitting.validate.table import ScoreTable

DONE, LOOK, INTERRUPTED = 0, 1, 130
PLAIN_S = 10.0
"""Period of progress lines without a terminal [s]; assumed."""
LISTED = 10


def add_parser(commands) -> None:
    """Add `campaign` to the command line."""
    p = commands.add_parser(
        "campaign",
        help="many seeded missions, fits or diagnoses from one file",
        description="Runs the cases of a campaign file in processes on this machine, or on a Dask cluster, and writes "
        "results.parquet, timings.parquet, failed.json and summary.html. Every case is kept as soon as it is done: "
        "the same command again goes on where it was stopped, however it was. Exit code 0: all cases done; 1: some "
        "failed (listed), or the cluster went away; 2: bad input; 130: interrupted.",
        example="aritra campaign deploy/campaigns/weather.toml --jobs 2",
    )
    p.add_argument("file", type=campaign_file, metavar="FILE", help="campaign file")
    add_out(p, "DIR", "folder for the results (default: out/campaign/FILE)")
    where = p.add_mutually_exclusive_group()
    where.add_argument(
        "--jobs", type=whole(1, 1024), metavar="N", help="processes on this machine (default: one for each core)"
    )
    where.add_argument("--scheduler", metavar="URL", help="Dask scheduler instead, for example tcp://10.0.0.5:8786")
    p.add_argument("--retry", action="store_true", help="run cases again that failed before")
    p.set_defaults(function=campaign)


def campaign(args: argparse.Namespace) -> int:
    """Read the file, run the cases that are left, write and print results; the exit code."""
    try:
        from sim.campaign import campaign as job
        from sim.campaign.inputs import read_campaign
        from sim.campaign.journal import Journal
        from sim.campaign.runners.worker import program
    except ImportError as error:
        return refuse("campaign", f"{error}; {how_to_install('campaign')} brings what campaigns need")
    console = Console()
    inputs, cases = read_campaign(args.file)
    out = args.out or Path("out") / "campaign" / args.file.stem
    try:
        out.mkdir(parents=True, exist_ok=True)
        with Journal(out, inputs.campaign.kind, program()) as journal:
            left = job.to_do(cases, journal, args.retry)
            _begin(console, inputs, cases, journal, left)
            ended = _run(args, console, inputs, left, journal)
            files = job.write(out, inputs, cases, journal, program())
            return _print(console, out, inputs, cases, journal, files, ended)
    except OSError as error:
        return refuse("campaign", error)


def _begin(console: Console, inputs: Inputs, cases: Sequence[Case], journal: Journal, left: Sequence[Case]) -> None:
    here = {case.id for case in cases}
    others = sum(name not in here for name in journal.outcomes)
    done = len(cases) - len(left)
    kept = f", {done} of them there already" if done else ""
    console.print(Text(f"{inputs.campaign.name}: {len(cases)} cases of {inputs.campaign.kind}{kept}"))
    if others:
        note = f"{others} results in {journal.path} are of cases that {inputs.name} does not have: they stay there"
        console.print(Text(note, style="yellow"))


def _run(
    args: argparse.Namespace, console: Console, inputs: Inputs, left: Sequence[Case], journal: Journal
) -> tuple[int, str]:
    """Run the cases that are left; exit code and reason where it ended early."""
    from sim.campaign import campaign as job
    from sim.campaign.runners.job import RunnerLost

    if not left:
        return DONE, ""
    progress = _Progress(console, len(left))
    try:
        with _runner(args, console, len(left)) as runner, progress:
            job.run(inputs, left, journal, runner, progress.see)
    except KeyboardInterrupt:
        return INTERRUPTED, "interrupted: what is done is kept, and the same command goes on with the rest"
    except RunnerLost as error:
        return LOOK, f"{error}; what is done is kept, and the same command goes on with the rest"
    return DONE, ""


def _runner(args: argparse.Namespace, console: Console, many: int) -> Local | Cluster:
    if not args.scheduler:
        from sim.campaign.runners.local import Local

        jobs = min(args.jobs or len(os.sched_getaffinity(0)), many)
        console.print(Text(f"{many} to run in {jobs} processes"))
        return Local(jobs)
    try:
        from sim.campaign.runners.cluster import Cluster
    except ImportError as error:
        raise ConfigError(f"{error}; {how_to_install('campaign')} brings Dask") from None
    cluster = Cluster(args.scheduler)
    console.print(Text(f"{many} to run on {args.scheduler}, {cluster.workers} workers now"))
    return cluster


class _Progress:
    """A bar on a terminal, else a line now and then."""

    def __init__(self, console: Console, total: int):
        self._console, self._total, self._failed, self._done = console, total, 0, 0
        self._begun_s = self._told_s = time.monotonic()
        columns = (BarColumn(24), MofNCompleteColumn(), TextColumn("{task.fields[failed]}"), TimeElapsedColumn(),
                   TextColumn("left"), TimeRemainingColumn())  # fmt: skip
        self._bar = Progress(*columns, console=console) if console.is_terminal else None
        self._task = self._bar.add_task("", total=total, failed="") if self._bar else None

    def __enter__(self) -> _Progress:
        if self._bar:
            self._bar.start()
        return self

    def __exit__(self, *exc: object) -> None:
        if self._bar:
            self._bar.stop()

    def see(self, outcome: CaseOutcome) -> None:
        """One case is done."""
        self._done += 1
        self._failed += bool(outcome.error)
        now = time.monotonic()
        if self._bar and self._task is not None:
            failed = f"{self._failed} failed" if self._failed else ""
            self._bar.update(self._task, completed=self._done, failed=failed)
        elif now - self._told_s >= PLAIN_S or self._done == self._total:
            self._told_s = now
            left_s = (now - self._begun_s) / self._done * (self._total - self._done)
            line = f"{self._done}/{self._total} done, {self._failed} failed, about {left_s:.0f} s left"
            self._console.print(Text(line))


def _print(
    console: Console, out: Path, inputs: Inputs, cases: Sequence[Case], journal: Journal, files: dict[str, bytes],
    ended: tuple[int, str],
) -> int:  # fmt: skip
    """The main figures, what failed, what was written; the exit code."""
    from sim.campaign import report, tables

    table, failed = tables.results(cases, journal.outcomes), tables.failures(cases, journal.outcomes)
    if table.height:
        console.print(_figures(report.narrow(inputs.campaign, table)))
        if how := report.ended(table):
            console.print(Text(how))
    for case, outcome in failed[:LISTED]:
        console.print(Text(f"failed: {case.id} seed {case.seed}: {outcome.error}", style="bold yellow"))
    if len(failed) > LISTED:
        console.print(Text(f".. and {len(failed) - LISTED} more"))
    finished = sum(case.id in journal.outcomes for case in cases)
    console.print(Text(f"{finished - len(failed)} done, {len(failed)} failed, {len(cases) - finished} not run"))
    for name, data in files.items():
        console.print(Text(f"wrote {out / name} ({len(data) / 1000:.0f} kB)"), soft_wrap=True)
    code, why = ended
    if why:
        console.print(Text(why, style="bold yellow"))
    return code or (LOOK if failed else DONE)


def _figures(found: ScoreTable) -> Table:
    out = Table(box=None, pad_edge=False)
    for name in found.head:
        out.add_column(name, justify="left" if name == found.head[0] else "right", no_wrap=True)
    for row in found.rows:
        out.add_row(*row)
    return out
