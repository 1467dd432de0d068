"""Measured UWB ranges through the range-only filter: how far from the RTK track it stays.

One folder holds one run: `A<id>.csv.gz` per anchor (stamp, anchor place, distance) and `trajectory.csv.gz`
(RTK reference, about 8 Hz); format: the uwb_hanyang data set's README. Every range is taken at its own stamp;
the start is the filter's own. The reference is used for the score alone.
"""

from __future__ import annotations

import csv
import gzip
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from sim.studies.ranging.range_filter import RangeFilter, RangeFilterTuning

TAG_DOWN_M = 0.0
"""Height of the tag under the RTK track's zero; assumed (-0.3 m changes the result by 2 cm)."""


@dataclass(frozen=True)
class RangeRun:
    """`anchors_m` (m, 3) x, y, down; `ranges`: (t_ns, anchor number, m) in order; `track` (k, 3): t_s, x, y.

    `t_s` of the track counts from the first range, at `t0_ns`.
    """

    anchors_m: np.ndarray
    ranges: list[tuple[int, int, float]]
    t0_ns: int
    track: np.ndarray


def load_run(folder: Path) -> RangeRun:
    """Read one run. Raises FileNotFoundError where the folder holds none."""
    anchors, ranges = [], []
    for number, path in enumerate(sorted(folder.glob("A*.csv.gz"))):
        rows = _rows(path)
        anchors.append([float(rows[0][f"field.{c}"]) for c in "xyz"])
        ranges += [(int(r["field.stamp"]), number, float(r["field.distanceFromTag"])) for r in rows]
    if not anchors:
        raise FileNotFoundError(f"{folder}: no A*.csv.gz here")
    ranges.sort()
    t0_ns = ranges[0][0]
    reference = _rows(folder / "trajectory.csv.gz")
    track = [((float(r["timestamp"]) - t0_ns) * 1e-9, float(r["x"]), float(r["y"])) for r in reference]
    down = np.array(anchors) * [1.0, 1.0, -1.0]
    return RangeRun(down, ranges, t0_ns, np.array(track))


def _rows(path: Path) -> list[dict[str, str]]:
    """Rows of a gzipped CSV file."""
    with gzip.open(path, "rt", newline="") as file:
        return list(csv.DictReader(file))


def filtered(run: RangeRun, tuning: RangeFilterTuning) -> np.ndarray:
    """Estimates after every range from the start on, (k, 4): t_s, x, y, sigma of the less certain direction [m]."""
    ranges = RangeFilter(run.anchors_m, TAG_DOWN_M, tuning)
    state, rows = ranges.initial(), []
    for t_ns, anchor, range_m in run.ranges:
        state = ranges.step(state, t_ns, anchor, range_m)
        if state.bank:
            best = state.bank[0]
            sigma_m = np.sqrt(np.linalg.eigvalsh(best.P[:2, :2])[-1])
            rows.append(((t_ns - run.t0_ns) * 1e-9, *best.x[:2], sigma_m))
    return np.array(rows)


def covered(run: RangeRun, track: np.ndarray) -> np.ndarray:
    """The estimates that the reference covers."""
    return track[(track[:, 0] >= run.track[0, 0]) & (track[:, 0] <= run.track[-1, 0])]


def planar_errors(run: RangeRun, track: np.ndarray) -> np.ndarray:
    """Distance of each estimate from the reference (k,) [m]."""
    x, y = (np.interp(track[:, 0], run.track[:, 0], run.track[:, i]) for i in (1, 2))
    return np.hypot(track[:, 1] - x, track[:, 2] - y)


def score(run: RangeRun, track: np.ndarray) -> dict[str, float]:
    """Planar error against the reference at every estimate that it covers: RMSE, 95 %, largest [m]."""
    error = planar_errors(run, covered(run, track))
    return {
        "rmse_m": float(np.sqrt((error**2).mean())), "p95_m": float(np.percentile(error, 95)),
        "max_m": float(error.max()), "start_after_s": float(track[0, 0]),
    }  # fmt: skip


def range_filter_scores(folder: Path) -> dict[str, dict[str, dict[str, float]]]:
    """Scores of the runs LOS and NLOS in `folder`: {run: {variant: {rmse_m, p95_m, max_m, ...}}}.

    Variants: gated with bias per anchor (one set of settings for both runs), gated without bias, and neither.
    """
    tuning = RangeFilterTuning()
    bare = msgspec.structs.replace(tuning, bias_sigma_m=1e-6)
    wide_open = msgspec.structs.replace(tuning.gate, limit=1e9)
    variants = {
        "gated": tuning,
        "gated_without_bias": bare,
        "ungated_without_bias": msgspec.structs.replace(bare, gate=wide_open),
    }
    runs = {name: load_run(folder / name) for name in ("LOS", "NLOS")}
    return {
        name: {variant: score(run, filtered(run, t)) for variant, t in variants.items()} for name, run in runs.items()
    }
