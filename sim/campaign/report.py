"""The report on a campaign: what was run, what failed, how its figures are distributed. One self-contained page."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
import polars as pl

from sim.campaign import pictures
from sim.campaign.cases import Case
from sim.campaign.file import Campaign
from sim.campaign.inputs import Inputs
from sim.campaign.runners.job import CaseOutcome
from sim.campaign.tables import failures, results
from sim.fitting.validate.report import Section, page
from sim.fitting.validate.table import ScoreTable

MAIN = {
    "missions": (
        "cross_track_rms_m", "overshoot_m", "surge_rms_error_m_s", "farthest_m", "station_error_m",
        "station_error_deg", "position_rmse_m", "velocity_rmse_m_s", "heading_rmse_deg", "nees",
    ),
    "identify": ("relative_error_structured", "intervals_that_hold", "iterations"),
    "diagnose": ("gain_position", "gain_heading", "gain_yaw_rate", "gain_surge_accel", "gain_sway_accel"),
}  # fmt: skip
"""Figures that are drawn; every figure stands in the table and in results.parquet."""
WORDS = {"missions": ("mode",), "identify": ("believe",), "diagnose": ("verdict", "causes")}
"""Figures that are words and worth counting."""
COUNTED = {"finished": "finished", "waypoints_missed": "waypoint missed"}
"""Figures of which it is told in how many cases they are above 0, and how that is called."""
NARROW = ("figure", "cases", "least", "median", "95 %", "most")
"""Columns of `quantiles` that fit into a terminal of 80 characters."""
WIDTH, GAP = 80, 2
"""Characters of a terminal, and between two columns of a table there."""
PARTS = 12
"""More points of a grid than this are not told apart in pictures."""
LISTED = 100


def summary(
    inputs: Inputs, cases: Sequence[Case], outcomes: Mapping[str, CaseOutcome], program: Mapping[str, str]
) -> str:
    """The page, as text."""
    table, failed = results(cases, outcomes), failures(cases, outcomes)
    sections = [_state(inputs.campaign, cases, outcomes, table, len(failed)), *_failed(failed)]
    if table.height:
        sections += [*_pictures(inputs.campaign, table), _every(table, cases)]
    sections.append(_origin(inputs, program))
    return page(f"Campaign {inputs.campaign.name}", sections)


def quantiles(table: pl.DataFrame, names: Sequence[str]) -> ScoreTable:
    """Of each figure: how many, mean, spread, quantiles, extremes."""
    rows = []
    for name in names:
        values = _numbers(table, name)
        values = values[np.isfinite(values)]
        if not len(values):
            rows.append((name, "0", *["-"] * 7))
            continue
        five, most = (pictures.not_exceeded(values, share) for share in (0.05, 0.95))
        ends = (values.min(), five, np.median(values), most, values.max())
        statistics = (values.mean(), values.std(ddof=1) if len(values) > 1 else np.nan, *ends)
        rows.append((name, str(len(values)), *(f"{v:.4g}" if np.isfinite(v) else "-" for v in statistics)))
    return ScoreTable(("figure", "cases", "mean", "sd", "least", "5 %", "median", "95 %", "most"), tuple(rows))


def narrow(campaign: Campaign, table: pl.DataFrame) -> ScoreTable:
    """Main figures for a terminal: by point of the grid where the points fit beside each other, else of all cases."""
    names, parts = main_figures(campaign, table), parts_of(campaign, table)
    if len(parts) > 1:
        beside = by_part(parts, names)
        beside = ScoreTable(("median (95 %)", *beside.head[1:]), beside.rows)
        widths = [max(map(len, column)) for column in zip(beside.head, *beside.rows, strict=True)]
        if sum(widths) + GAP * (len(widths) - 1) <= WIDTH:
            return beside
    every = quantiles(table, names)
    columns = [every.head.index(name) for name in NARROW]
    return ScoreTable(NARROW, tuple(tuple(row[k] for k in columns) for row in every.rows))


def main_figures(campaign: Campaign, table: pl.DataFrame) -> list[str]:
    """Those of the kind's main figures that this campaign has."""
    return [n for n in MAIN[campaign.kind] if n in table.columns and np.isfinite(_numbers(table, n)).any()]


def parts_of(campaign: Campaign, table: pl.DataFrame) -> dict[str, pl.DataFrame]:
    """The table by points of the grid; one part where there is no grid, or too many points."""
    keys = [key for key, values in campaign.grid.items() if len(values) > 1]
    rows = table.select(keys).unique().sort(keys).rows() if keys else []
    if not 1 < len(rows) <= PARTS:
        return {"all cases": table}
    names, out = short_names(keys), {}
    for row in rows:
        label = ", ".join(f"{name} {value}" for name, value in zip(names, row, strict=True))
        here = pl.all_horizontal([pl.col(key).eq_missing(value) for key, value in zip(keys, row, strict=True)])
        out[label] = table.filter(here)
    return out


def short_names(keys: Sequence[str]) -> list[str]:
    """Of each dotted key as few of its last steps as no other key ends with."""
    out = []
    for key in keys:
        steps = key.split(".")
        ends = (".".join(steps[k:]) for k in range(len(steps) - 1, -1, -1))
        out.append(next((end for end in ends if sum(f".{k}".endswith(f".{end}") for k in keys) == 1), key))
    return out


def ended(table: pl.DataFrame) -> str:
    """How many missions ended in time, and missed a waypoint, in a sentence; of other kinds nothing."""
    if not set(COUNTED) <= set(table.columns):
        return ""
    many, missed = (_above_zero(table, name) for name in COUNTED)
    return f"{many} of {table.height} missions ended in time; in {missed} a waypoint was missed."


def _above_zero(table: pl.DataFrame, name: str) -> int:
    return int((_numbers(table, name) > 0).sum())


def by_part(parts: Mapping[str, pl.DataFrame], names: Sequence[str]) -> ScoreTable:
    """For each part how many finished; of each figure the median, and the value that 95 % do not exceed.

    Where not all cases of a part have a figure, n is how many do.
    """
    rows = [
        (called, *(f"{_above_zero(table, name)} of {table.height}" for table in parts.values()))
        for name, called in COUNTED.items()
        if all(name in table.columns for table in parts.values())
    ]
    for name in names:
        cells = []
        for table in parts.values():
            values = _numbers(table, name)
            values = values[np.isfinite(values)]
            many = f" n={len(values)}" if len(values) < table.height else ""
            most = pictures.not_exceeded(values, 0.95) if len(values) else np.nan
            cells.append(f"{np.median(values):.3g} ({most:.3g}){many}" if len(values) else "-")
        rows.append((name, *cells))
    return ScoreTable(("figure", *parts), tuple(rows))


def _state(campaign: Campaign, cases: Sequence[Case], outcomes: Mapping[str, CaseOutcome], table: pl.DataFrame,
           failed: int) -> Section:  # fmt: skip
    ran = [outcomes[c.id] for c in cases if c.id in outcomes]
    lines = [f"{len(cases)} cases ({campaign.kind}): {len(ran) - failed} done, {failed} failed, "
             f"{len(cases) - len(ran)} not run yet."]  # fmt: skip
    done = [o for o in ran if not o.error]
    if done:
        seconds = np.array([o.seconds for o in done])
        lines.append(f"One case took {np.median(seconds):.1f} s (median), all of them {seconds.sum() / 3600:.2f} h of "
                     f"one core; processes that took part: {len({o.worker for o in done})}.")  # fmt: skip
    if how := ended(table):
        lines.append(how)
    return Section("What was run", tuple(lines), look=bool(failed) or len(ran) < len(cases))


def _failed(failed: Sequence[tuple[Case, CaseOutcome]]) -> list[Section]:
    if not failed:
        return []
    rows = [
        (case.id, str(case.seed), ", ".join(f"{k} {_short(v)}" for k, v in case.shown.items()), outcome.error)
        for case, outcome in failed[:LISTED]
    ]
    more = f"So it is with {len(failed) - LISTED} more. " if len(failed) > LISTED else ""
    note = f"{more}Where each broke is in failed.json. Mended? The same command with --retry runs them again."
    table = ScoreTable(("case", "seed", "what", "error"), tuple(rows))
    return [Section("Cases that failed", tables=(table,), text=True, note=note)]


def _pictures(campaign: Campaign, table: pl.DataFrame) -> list[Section]:
    parts, names = parts_of(campaign, table), main_figures(campaign, table)
    sections = []
    if names:
        columns = {part: {n: _numbers(rows, n) for n in names} for part, rows in parts.items()}
        one = "Of the cases that have the figure; lines: median and, dashed, the value that 95 % of them do not exceed."
        many = ("For each point of the grid the share of all its cases that are at most so large. Where a curve ends "
                "below 100 %, the other cases have no such figure.")  # fmt: skip
        figure = pictures.distributions(columns, names)
        sections.append(Section("Distributions", figures=((figure, one if len(parts) == 1 else many),)))
    if len(parts) > 1 and names:
        note = "Median (95 %) of the cases that have the figure; n: how many, where not all have it."
        sections.append(Section("By point of the grid", tables=(by_part(parts, names),), note=note))
    for name in (n for n in WORDS[campaign.kind] if n in table.columns and table[n].n_unique() > 1):
        counts = {part: Counter(str(v) if v is not None else "" for v in rows[name]) for part, rows in parts.items()}
        figure = pictures.counts(counts)
        sections.append(Section(f"How often: {name}", figures=((figure, "Cases by what they came to."),)))
    sigmas = _sigmas(table)
    if sigmas:
        caption = "Against the simulated truth: where the bars reach beyond the grey, intervals are too narrow."
        sections.append(Section("Errors of the parameters", figures=((pictures.errors(sigmas), caption),)))
    return sections


def _sigmas(table: pl.DataFrame) -> dict[str, np.ndarray]:
    """Errors over standard errors, of the parameters whose truth is known and which were fitted."""
    out = {}
    for name in (c.removesuffix("_true") for c in table.columns if c.endswith("_true")):
        se = _numbers(table, f"{name}_se")
        with np.errstate(divide="ignore", invalid="ignore"):
            z = (_numbers(table, name) - _numbers(table, f"{name}_true")) / se
        if np.isfinite(z).any() and not name.startswith("warp_"):
            out[name] = z
    return out


def _every(table: pl.DataFrame, cases: Sequence[Case]) -> Section:
    known = {"case", "seed", *(key for case in cases for key in case.shown)}
    names = [c for c in table.columns if c not in known and table[c].dtype != pl.String]
    return Section("Every figure", tables=(quantiles(table, names),), note="Of yes and no: 1 and 0.")


def _origin(inputs: Inputs, program: Mapping[str, str]) -> Section:
    files = ScoreTable(("file", "SHA-256"), tuple((name, digest) for name, digest in sorted(inputs.digests.items())))
    versions = ScoreTable(("program", "version"), tuple(program.items()))
    return Section("What it rests on", tables=(files, versions), preformatted=inputs.text, text=True,
                   note=f"Below: {inputs.name} as it was.")  # fmt: skip


def _numbers(table: pl.DataFrame, name: str) -> np.ndarray:
    return table[name].cast(pl.Float64, strict=False).fill_null(np.nan).to_numpy()


def _short(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
