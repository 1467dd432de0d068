"""`aritra log info | plot | page | recover | export`. Exit codes: 0 sound log, 1 damaged log, 2 error."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import msgspec
from rich.console import Console
from rich.table import Table
from rich.text import Text

from companion.cli.options.extras import how_to_install
from companion.cli.options.files import aritra_log, truth_log
from companion.cli.options.outputs import add_out, new_file, picture
from companion.cli.options.values import number
from companion.logs.export import command as log_export
from companion.logs.log_file import LogError, LogFile, open_truth
from companion.logs.page import command as log_page
from companion.logs.recover import recover as recover_log
from companion.logs.summary import LogSummary, summarise

OK, DAMAGED, IMPOSSIBLE = 0, 1, 2
LOG = "out/demo/run.mcap"
EXIT_CODES = "Exit codes: 0 all well; 1 the log is damaged (what is readable was used); 2 it cannot be done."


def info(path: Path, *, as_json: bool = False) -> int:
    """Print what is in the log: as tables, or as one JSON object. Returns the exit code."""
    summary, console = summarise(LogFile(path)), Console()
    if as_json:
        console.file.write(json.dumps(msgspec.to_builtins(summary), indent=2) + "\n")
    else:
        _print_summary(summary, console)
    return DAMAGED if summary.damage else OK


def plot(
    path: Path,
    out: Path | None = None,
    *,
    truth: Path | None = None,
    print_mm: float | None = None,
    console: Console | None = None,
) -> int:
    """Draw the log into a picture (default: a PNG beside it); `truth`: the simulator's log. Returns the exit code.

    `print_mm`: as a figure for print, so wide.
    """
    try:
        from companion.logs.export import figure
        from companion.logs.export import plot as log_plot
    except ImportError:
        raise LogError(f"plots need matplotlib: {how_to_install('analysis')}") from None
    log, console = LogFile(path), console or Console()
    simulator = open_truth(truth, log) if truth else None
    out = out or path.with_suffix(".pdf" if print_mm else ".png")
    new_file(out)
    if print_mm:
        figure.figure(log, out, print_mm, truth=simulator)
    else:
        log_plot.plot(log, out, truth=simulator)
    damage = [*log.damage, *(simulator.damage if simulator else ())]
    for line in (f"wrote {out}", *damage):
        console.print(line, soft_wrap=True, highlight=False, markup=False)
    return DAMAGED if damage else OK


def recover(path: Path, out: Path | None = None) -> int:
    """Write a sound, indexed copy of a damaged or rotated log; print what was kept. Returns the exit code."""
    out = out or path.with_name(f"{path.stem}.recovered{path.suffix}")
    new_file(out)
    report, console = recover_log(path, out), Console()
    lines = [
        f"wrote {report.out}",
        f"kept {report.messages} messages, {report.kept_bytes} bytes, from {report.parts} file(s)",
        f"lost {report.lost_bytes} bytes",
    ]
    if report.without_channel:
        lines.append(f"lost {report.without_channel} messages whose channel stood in a damaged chunk")
    if report.last_t_ns is not None and report.last_log_time_ns is not None:
        lines.append(f"last message at t = {report.last_t_ns / 1e9:.3f} s, wall clock {_utc(report.last_log_time_ns)}")
    for line in (*lines, *report.damage):
        console.print(line, soft_wrap=True, highlight=False, markup=False)
    return DAMAGED if report.damage else OK


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `log` with its commands; each sets `function`: parsed arguments -> exit code."""
    log = subparsers.add_parser(
        "log", help="look into, plot, play, repair or export a log", epilog=EXIT_CODES, example=f"aritra log info {LOG}"
    )
    commands = log.add_subparsers(required=True, metavar="info|plot|page|recover|export")

    show = commands.add_parser(
        "info",
        help="what is in a log: topics, rates, gaps, alerts",
        epilog=EXIT_CODES,
        example=f"aritra log info {LOG}",
    )
    show.add_argument("--json", action="store_true", help="one JSON object instead of tables")
    show.set_defaults(function=_guarded(lambda args: info(args.log, as_json=args.json)))

    draw = commands.add_parser(
        "plot",
        help="one picture: track, speeds, PWM, timing",
        epilog=EXIT_CODES,
        example=f"aritra log plot {LOG} --truth out/demo/truth.mcap --out run.png",
    )
    draw.set_defaults(
        function=_guarded(lambda args: plot(args.log, args.out, truth=args.truth, print_mm=args.print_mm))
    )
    draw.add_argument("--truth", type=truth_log, metavar="LOG", help="the simulator's own log of the same run")
    wide = "a figure for print, so wide: `column` (88 mm), `page` (180 mm), or millimetres; default: LOG.pdf"
    draw.add_argument("--print", dest="print_mm", type=_width_mm, metavar="WIDTH", help=wide)

    repair = commands.add_parser(
        "recover",
        help="sound, indexed copy of a damaged or rotated log",
        epilog=EXIT_CODES,
        example=f"aritra log recover {LOG} --out sound.mcap",
    )
    repair.set_defaults(function=_guarded(lambda args: recover(args.log, args.out)))

    log_export.add_parser(commands, _guarded, EXIT_CODES)
    log_page.add_parser(commands, _guarded, EXIT_CODES)
    add_out(draw, "FILE", "default: LOG.png beside it", picture)
    add_out(repair, "FILE", "default: LOG.recovered.mcap beside it")
    for command in (show, draw, repair):
        command.add_argument("log", type=aritra_log, metavar="LOG", help="first file of the log (NAME.mcap)")


PRINT_MM = {"column": 88.0, "page": 180.0}
"""Column widths [mm] of journals with two columns (IEEE 88.9 and 181, Elsevier 90 and 190), with a margin."""
LEAST_MM, MOST_MM = 60.0, 500.0


def _width_mm(text: str) -> float:
    """A width on paper, as an argument."""
    return PRINT_MM.get(text) or number(LEAST_MM, MOST_MM, "column, page, or millimetres")(text)


def _guarded(command: Callable[[argparse.Namespace], int]) -> Callable[[argparse.Namespace], int]:
    def run(args: argparse.Namespace) -> int:
        try:
            return command(args)
        except LogError as error:
            print(f"aritra log: {error}", file=sys.stderr)
            return IMPOSSIBLE

    return run


def _print_summary(summary: LogSummary, console: Console) -> None:
    console.print(_facts(summary))
    console.print(_topics(summary))
    for alert in summary.alerts:
        style = {"error": "bold red", "warning": "yellow"}.get(alert.level, "")
        console.print(Text(f"{alert.t_s:9.2f} s  {alert.level:8}{alert.text}", style=style))
    for line in summary.damage:
        console.print(Text(f"damaged: {line}", style="bold red"))
    if len(summary.damage) > len(summary.undecodable):  # what does not fit its class stays so
        console.print(Text("`aritra log recover` writes a sound copy"))


def _facts(summary: LogSummary) -> Table:
    meta = summary.metadata
    table = Table.grid(padding=(0, 2))
    wanted = (
        ("log", summary.path + (f" (+ {summary.parts - 1} parts)" if summary.parts > 1 else "")),
        ("start", summary.start or "no message"),
        ("duration", f"{summary.duration_s:.2f} s, {summary.messages} messages"),
        ("vessel", meta.get("vessel", "not stated")),
        ("configuration", meta.get("config_sha256", "not stated")[:12]),
        ("version", f"{meta.get('version', 'not stated')}, git {meta.get('git_revision', 'not stated')}"),
        ("attachments", ", ".join(summary.attachments) or "none"),
        ("leases", _counts(summary.leases)),
        ("plans", _counts(summary.plans)),
        ("alerts", str(len(summary.alerts))),
    )
    for name, value in wanted:
        table.add_row(Text(name, style="bold"), Text(value))
    if summary.unknown:
        table.add_row(Text("unknown topics", style="bold yellow"), Text(_counts(summary.unknown)))
    return table


def _topics(summary: LogSummary) -> Table:
    table = Table("topic", title="Messages by topic", title_justify="left")
    for name in ("messages", "rate [Hz]", "largest gap [s]", "missing", "kB"):
        table.add_column(name, justify="right")
    for stats in summary.topics:
        table.add_row(
            Text(stats.topic),
            str(stats.messages),
            f"{stats.rate_hz:.2f}",
            f"{stats.largest_gap_s:.3f}",
            Text(str(stats.missing), style="bold red" if stats.missing else ""),
            f"{stats.bytes / 1000:.1f}",
        )
    return table


def _counts(counts: dict[str, int]) -> str:
    return ", ".join(f"{name} {count}" for name, count in sorted(counts.items())) or "none"


def _utc(wall_ns: int) -> str:
    return datetime.fromtimestamp(wall_ns / 1e9, UTC).isoformat(" ", "milliseconds")
