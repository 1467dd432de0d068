"""Read any log as a run, by its file name: .mcap, .csv, .csv.gz, .parquet, .bin, .tlog."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path

from companion.core.configuration.site_file import Site
from companion.core.configuration.vessel_file import VesselFile
from companion.logs.readers.aritra import read_mcap
from companion.logs.readers.cse1 import is_cse1, read_cse1
from companion.logs.readers.table import read_csv, read_parquet
from companion.logs.readers.text_table import csv_lines
from companion.logs.readers.uwb import read_uwb
from companion.logs.runs.run import Run, RunError


@dataclass(frozen=True)
class ReadOptions:
    """What is needed beside a log to read it.

    vessel, site  instead of those in the log
    truth         the simulator's log, for .mcap
    uwb           a UWB log (.mcap or text), for .bin and .tlog
    uwb_format    wire format of its lines; default: the vessel's
    uwb_offset_s  log's clock minus its Unix stamps (.bin: needed without GPS; .tlog: default 0)
    """

    vessel: VesselFile | None = None
    site: Site | None = None
    truth: Path | None = None
    uwb: Path | None = None
    uwb_format: str | None = None
    uwb_offset_s: float | None = None


def read_run(path: Path, beside: ReadOptions | None = None) -> Run:
    """The run in `path`. Raises RunError or LogError naming file and place in it, OSError."""
    options = beside or ReadOptions()
    name = path.name.lower()
    kind = name.removesuffix(".gz").rpartition(".")[2]
    if name.endswith(".gz") and kind != "csv":
        raise RunError(f"{path}: is compressed, which only .csv.gz may be: unpack it with gunzip")
    if options.truth and kind != "mcap":
        raise RunError(f"{path}: a log with the truth goes with a .mcap log only")
    if options.uwb and kind not in ("bin", "tlog"):
        raise RunError(f"{path}: a UWB log is joined to a .bin or .tlog only")
    if kind == "mcap":
        return read_mcap(path, options.vessel, options.site, options.truth)
    if kind == "parquet":
        return read_parquet(path)
    if kind == "csv":
        lines = csv_lines(path)
        return read_cse1(path) if is_cse1(lines[0].decode(errors="replace")) else read_csv(path)
    uwb = None
    if options.uwb:
        uwb_spec = options.vessel.sensors.uwb if options.vessel else None
        wire_format = options.uwb_format or (uwb_spec.wire_format if uwb_spec else None)
        uwb = partial(read_uwb, options.uwb, wire_format, options.site, uwb_spec.z_m if uwb_spec else 0.0)
    if kind == "bin":
        from companion.logs.readers.dataflash import read_dataflash_run  # noqa: PLC0415 - pymavlink is slow to load

        return read_dataflash_run(path, options.vessel, options.site, uwb, options.uwb_offset_s)
    if kind == "tlog":
        from companion.logs.readers.tlog import read_tlog  # noqa: PLC0415 - pymavlink, too

        return read_tlog(path, options.vessel, options.site, uwb, options.uwb_offset_s or 0.0)
    raise RunError(f"{path}: expected .mcap, .csv, .csv.gz, .parquet, .bin or .tlog")
