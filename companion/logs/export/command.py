"""`aritra log export`: any log -> one aligned table (docs/run-format.md), and what is wrong with it; or one of our own

logs -> a table a topic (`tables`), its track on the earth (`geojson`), or what other programs show (`foxglove`,
`rosbag2`).

polars, foxglove-sdk and rosbags are optional dependencies: modules that need them are imported at first use.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
from rich.console import Console
from rich.table import Table
from rich.text import Text

from companion.cli.options.extras import how_to_install
from companion.cli.options.files import any_log, aritra_log, log_beside, site_file, text_of, truth_log, vessel_file
from companion.cli.options.outputs import AWAY, add_out, making, new_file, reason
from companion.cli.options.values import number
from companion.core.configuration.site_file import load_site
from companion.core.model.load_vessel import load_vessel
from companion.logs.export import geojson as log_geojson
from companion.logs.log_file import LogError, LogFile, open_truth

if TYPE_CHECKING:
    from companion.logs.runs.run import LogProblem, Run

OK, DAMAGED = 0, 1
NEEDS_POLARS = f"export needs polars: {how_to_install('analysis')}"
NEEDS_FOXGLOVE = f"export --foxglove needs foxglove-sdk: {how_to_install('shore')}"
NEEDS_ROSBAGS = f"export --rosbag2 needs rosbags: {how_to_install('analysis')}"
DESCRIPTION = """Without --csv, --parquet, --geojson, --foxglove or --rosbag2: one table on one time axis, as
identification reads it (docs/run-format.md), and what is wrong with it. With them see docs/logs.md."""
Command = Callable[[argparse.Namespace], int]


@dataclass(frozen=True)
class Extras:
    """What goes with the log: files, and how a UWB log is read and shifted (see `read_run.ReadOptions`)."""

    vessel: Path | None = None
    site: Path | None = None
    truth: Path | None = None
    uwb: Path | None = None
    uwb_format: str | None = None
    uwb_offset_s: float | None = None


def export(path: Path, out: Path, extras: Extras | None = None, *, as_json: bool = False) -> int:
    """Write the run in `path` to `out`; print its contents and problems. Returns the exit code.

    Raises LogError: it cannot be read or written, or polars is not installed.
    """
    try:
        from polars.exceptions import PolarsError

        from companion.logs.readers.read_run import read_run
        from companion.logs.readers.table import write_run
        from companion.logs.runs.problems import problems
    except ImportError:
        raise LogError(NEEDS_POLARS) from None
    if out.exists() and out.samefile(path):
        raise LogError(f"{out}: this is the log itself")
    new_file(out)
    try:
        run = read_run(path, _beside(extras or Extras()))
        with making(out, PolarsError):
            write_run(run, out)
    except (ValueError, OSError) as error:  # RunError, ConfigError and an unknown wire format are ValueErrors
        raise LogError(reason(error, path) if isinstance(error, OSError) else str(error)) from None
    console, found = Console(), problems(run)
    if as_json:
        console.file.write(json.dumps({"out": str(out), **summary(run, found)}, indent=2) + "\n")
    else:
        _print(run, found, out, console)
    return DAMAGED if any(p.kind == "damaged" for p in found) else OK


def summary(run: Run, found: list[LogProblem]) -> dict[str, Any]:
    """The run in figures, for scripts."""
    return {
        "vessel": run.meta.vessel,
        "rows": run.table.height,
        "duration_s": run.duration_s,
        "thrusters": run.thrusters,
        "rates_hz": run.rates_hz(),
        "data_hash": run.data_hash,
        "problems": msgspec.to_builtins(found),
    }


def export_topics(path: Path, folder: Path, form: str, *, truth: Path | None = None) -> int:
    """Write a file a topic, `form` csv or parquet, into `folder`; the exit code. Raises LogError, ConfigError."""
    try:
        from companion.logs.export import tables
    except ImportError:
        raise LogError(NEEDS_POLARS) from None
    log, console = LogFile(path), Console()
    simulator = open_truth(truth, log) if truth else None
    taken = [*sorted(folder.glob(f"*.{form}")), *folder.glob(tables.INDEX)] if folder.is_dir() else []
    if taken:
        raise LogError(f"{taken[0]}: {AWAY}")
    with console.status(f"reading {path}") as status:
        found = tables.tables(log, simulator, lambda n: status.update(f"reading {path}: {n} messages"))
    if not found.by_topic:
        raise LogError(f"{path}: no message in it")
    about = {"log": path.name, **{k: v for k, v in log.metadata.items() if not k.startswith("config/")}}
    written = tables.write(found, folder, form, about)
    rows = sum(table.height for table in found.by_topic.values())
    size = sum(p.stat().st_size for p in written) / 1e6
    summary_line = f"wrote {len(found.by_topic)} tables, {rows} rows, {size:.1f} MB to {folder}"
    return _end(console, summary_line, [*log.damage, *(simulator.damage if simulator else ())])


def export_track(path: Path, out: Path, *, site: Path | None = None, truth: Path | None = None) -> int:
    """Write the track as GeoJSON. Returns the exit code. Raises LogError, ConfigError."""
    log = LogFile(path)
    simulator = open_truth(truth, log) if truth else None
    new_file(out)
    try:
        chosen = load_site(text_of(site), name=str(site)) if site else None
        found = log_geojson.features(log, chosen, simulator)
    except OSError as error:
        raise LogError(reason(error, path)) from None
    with making(out):
        out.write_bytes(log_geojson.collection(path.stem, found, msgspec.json.encode))
    summary_line = f"wrote {out}: {len(found)} features, {out.stat().st_size / 1e6:.1f} MB"
    return _end(Console(), summary_line, [*log.damage, *(simulator.damage if simulator else ())])


def export_foxglove(path: Path, out: Path) -> int:
    """Write what Foxglove's panels show to `out`, a new file. Returns the exit code. Raises LogError, ConfigError."""
    try:
        from companion.logs.export import foxglove
    except ImportError:
        raise LogError(NEEDS_FOXGLOVE) from None
    log = LogFile(path)
    new_file(out)
    with making(out):
        count = foxglove.write(log, out)
    return _end(Console(), f"wrote {out}: {count} samples, {out.stat().st_size / 1e6:.1f} MB", log.damage)


def export_rosbag2(path: Path, out: Path, *, truth: Path | None = None) -> int:
    """Write a rosbag2 folder `out`. Returns the exit code. Raises LogError, ConfigError."""
    try:
        from companion.logs.export import rosbag2
    except ImportError:
        raise LogError(NEEDS_ROSBAGS) from None
    log = LogFile(path)
    simulator = open_truth(truth, log) if truth else None
    new_file(out, is_folder=True)
    with making(out):
        count, left_out, refused = rosbag2.write(log, out, simulator)
    size = sum(p.stat().st_size for p in out.iterdir()) / 1e6
    odd = f", {left_out} left out: a number in them is beyond what ROS holds" if left_out else ""
    odd += f"; no path and no forces: {refused}" if refused else ""
    summary_line = f"wrote {out}: {count} messages, {size:.1f} MB{odd}"
    return _end(Console(), summary_line, [*log.damage, *(simulator.damage if simulator else ())])


def add_parser(commands: Any, guarded: Callable[[Command], Command], exit_codes: str) -> None:
    """Add `export` to the commands of `aritra log`."""
    what = "for other programs: CSV, Parquet, GeoJSON, Foxglove, rosbag2"
    p = commands.add_parser(
        "export",
        help=what,
        description=DESCRIPTION,
        epilog=exit_codes,
        example="aritra log export out/demo/run.mcap --geojson --out track.geojson",
    )
    p.add_argument("log", type=any_log, metavar="LOG", help="log of aritra run (.mcap); aligned also .bin, .tlog, ...")
    form = p.add_mutually_exclusive_group()
    form.add_argument("--csv", action="store_const", const="csv", dest="form", help="a CSV file a topic, into --out")
    parquet = {"action": "store_const", "const": "parquet", "dest": "form"}
    form.add_argument("--parquet", **parquet, help="a Parquet file a topic, into --out")
    geojson = {"action": "store_const", "const": "geojson", "dest": "form"}
    form.add_argument("--geojson", **geojson, help="the track on the earth, for QGIS and the like")
    foxglove = {"action": "store_const", "const": "foxglove", "dest": "form"}
    form.add_argument("--foxglove", **foxglove, help="what Foxglove's 3D and map panels show, as MCAP")
    rosbag2 = {"action": "store_const", "const": "rosbag2", "dest": "form"}
    form.add_argument("--rosbag2", **rosbag2, help="a ROS 2 bag of standard messages, into the new folder --out")
    out = (
        "folder of --csv, --parquet, --rosbag2; else file to write: .geojson, .mcap; aligned: .csv, .csv.gz or .parquet"
    )
    add_out(p, "PATH", out, required=True)
    p.add_argument("--truth", type=truth_log, metavar="LOG", help="the simulator's own log of the same run")
    p.add_argument("--site", type=site_file, metavar="FILE", help="site file (default: the one in the log)")
    aligned = p.add_argument_group("for the aligned table only")
    aligned.add_argument("--vessel", type=vessel_file, metavar="FILE", help="vessel file (default: the one in the log)")
    aligned.add_argument(
        "--uwb", type=log_beside, metavar="LOG", help="UWB log beside a .bin or .tlog: .mcap, or lines"
    )
    aligned.add_argument("--uwb-format", metavar="NAME", help="wire format of its lines (default: the vessel file's)")
    aligned.add_argument(
        "--uwb-offset", type=number(-1e10, 1e10), metavar="S", help="add to its Unix stamps to have the log's clock"
    )
    aligned.add_argument("--json", action="store_true", help="one JSON object instead of tables")
    p.set_defaults(function=guarded(_run_command), form=None)


def _run_command(args: argparse.Namespace) -> int:
    if args.form:
        given = {"--vessel": args.vessel, "--uwb": args.uwb, "--uwb-format": args.uwb_format}
        given |= {"--uwb-offset": args.uwb_offset, "--json": args.json or None}
        given |= {"--site": args.site} if args.form != "geojson" else {}
        given |= {"--truth": args.truth} if args.form == "foxglove" else {}
        for option, value in given.items():
            if value is not None:
                raise LogError(f"{option} says nothing to --{args.form}: leave it out")
        try:
            aritra_log(str(args.log))
        except argparse.ArgumentTypeError as error:
            raise LogError(f"{error}; without --{args.form} it becomes the aligned table") from None
        if args.form == "geojson":
            return export_track(args.log, args.out, site=args.site, truth=args.truth)
        if args.form == "foxglove":
            return export_foxglove(args.log, args.out)
        if args.form == "rosbag2":
            return export_rosbag2(args.log, args.out, truth=args.truth)
        return export_topics(args.log, args.out, args.form, truth=args.truth)
    extras = Extras(args.vessel, args.site, args.truth, args.uwb, args.uwb_format, args.uwb_offset)
    return export(args.log, args.out, extras, as_json=args.json)


def _beside(extras: Extras) -> Any:
    from companion.logs.readers.read_run import ReadOptions

    vessel = load_vessel(text_of(extras.vessel), name=str(extras.vessel)) if extras.vessel else None
    site = load_site(text_of(extras.site), name=str(extras.site)) if extras.site else None
    return ReadOptions(vessel, site, extras.truth, extras.uwb, extras.uwb_format, extras.uwb_offset_s)


def _end(console: Console, summary_line: str, damage: Sequence[str]) -> int:
    for line in (summary_line, *damage):
        console.print(line, soft_wrap=True, highlight=False, markup=False)
    return DAMAGED if damage else OK


def _print(run: Run, found: list[LogProblem], out: Path, console: Console) -> None:
    from companion.logs.runs.problems import grouped

    changes = len(run.commands()[0])
    console.print(Text(f"wrote {out}: {run.table.height} rows, {run.duration_s:.2f} s, data {run.data_hash[:12]}"))
    console.print(Text(f"vessel {run.meta.vessel}, site {run.meta.site}, {changes} commands to {len(run.thrusters)}"))
    table = Table("column", title="Samples", title_justify="left")
    table.add_column("samples", justify="right")
    table.add_column("rate [Hz]", justify="right")
    for name, rate_hz in run.rates_hz().items():
        count = run.table.height - run.table[name].null_count()
        table.add_row(Text(name), str(count), f"{rate_hz:.2f}")
    console.print(table)
    for kind, ones in grouped(found).items():
        total_s = sum(p.length_s or 0.0 for p in ones)
        head = f"{kind}: {len(ones)}" + (f", {total_s:.1f} s in all" if total_s else "")
        console.print(Text(head, style="bold yellow"))
        for p in ones[:3]:
            at = f"{p.t_s:9.2f} s  " if p.t_s is not None else ""
            length = f" ({p.length_s:.2f} s)" if p.length_s else ""
            console.print(Text(f"  {at}{p.text}{length}"))
        if len(ones) > 3:
            console.print(Text(f"  ... and {len(ones) - 3} more (--json lists all)"))
    if not found:
        console.print(Text("no problems found"))
