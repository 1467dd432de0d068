"""Join of sensor streams, each with its own stamps, into one run. Samples that are left out are stated in its notes.

The rows are the union of all stamps. An attitude within 1 ms of an inertial sample takes the row of that sample
(ATTITUDE is stamped in whole ms, the IMU in us: the difference is rounding).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np
import polars as pl

from companion.logs.runs.columns import REQUIRED
from companion.logs.runs.nearest import nearest
from companion.logs.runs.outliers import without_outliers
from companion.logs.runs.run import LogProblem, Run, RunError, RunMeta

BACK_NS = 1_000_000_000
"""A stamp that goes back by more than this is a clock that was set, not a packet that was late (assumed)."""
NEAR_NS = 1_000_000
STRAY_NS = 10_000_000_000
"""A last sample so long after everything else in the log is a damaged stamp, or of no use (assumed)."""


@dataclass(frozen=True)
class Stream:
    """Samples of one sensor.

    t_ns     (n,) int64 stamps; columns: name -> (n,), NaN where unknown
    held     each value is in force until the next
    near     name of the stream whose rows it takes where these are within 1 ms
    outside  may begin before and end after the log proper, and is cut to it
    """

    name: str
    t_ns: np.ndarray
    columns: Mapping[str, np.ndarray]
    held: bool = False
    near: str = ""
    outside: bool = False

    @classmethod
    def of(cls, name: str, columns: Sequence[str], rows: Sequence[tuple[float, ...]], **options) -> Stream:
        """From rows (t_ns, value of each of `columns`)."""
        t_ns = np.array([row[0] for row in rows], dtype=np.int64)
        values = np.array([row[1:] for row in rows], dtype=float).reshape(len(rows), len(columns))
        return cls(name, t_ns, dict(zip(columns, values.T, strict=True)), **options)

    def only(self, which: np.ndarray) -> Stream:
        """The samples of the mask `which` (n,)."""
        return replace(self, t_ns=self.t_ns[which], columns={name: v[which] for name, v in self.columns.items()})


def join(streams: Sequence[Stream], meta: RunMeta) -> Run:
    """One run of all streams that have samples. `zero_ns` of `meta` is set, and notes are appended.

    Raises RunError where nothing was commanded, or where two streams have the same column.
    """
    # 1. Clean streams, cut to the log proper; attitudes moved to the rows of inertial samples.
    notes: list[tuple[int, LogProblem]] = []
    kept = [cleaned for s in streams if len((cleaned := _clean(s, notes)).t_ns)]
    if not any(name.startswith("pwm_") for s in kept for name in s.columns):
        raise RunError(f"{meta.source}: no thruster commands in it")
    for column in dict.fromkeys(name for s in kept for name in s.columns):
        if len(names := [s.name for s in kept if column in s.columns]) > 1:
            raise RunError(f"{meta.source}: {column}: of {' and of '.join(names)}; expected one source")
    kept = _without_stray_ends(kept, notes)
    proper = [s for s in kept if not s.outside]
    zero_ns, end_ns = min(int(s.t_ns[0]) for s in proper), max(int(s.t_ns[-1]) for s in proper)
    kept = [_cut(s, zero_ns, end_ns, notes) for s in kept]
    by_name = {s.name: s for s in kept}
    kept = [_moved(s, by_name[s.near]) if s.near in by_name else s for s in kept]
    # 2. The table: one row per stamp; held columns from the latest stamp, sampled ones at their own.
    rows = np.unique(np.concatenate([s.t_ns for s in kept]))
    table = pl.DataFrame({"t_ns": rows})
    for s in kept:
        frame = pl.DataFrame({"t_ns": s.t_ns, **s.columns}).fill_nan(None)
        table = table.join_asof(frame, on="t_ns") if s.held else table.join(frame, on="t_ns", how="left")
    table = table.sort("t_ns").drop("t_ns").with_columns(t_s=pl.Series((rows - zero_ns) / 1e9))
    blank = pl.lit(None, pl.Float64)
    table = table.with_columns(blank.alias(name) for name in REQUIRED if name not in table.columns)
    # 3. Stamps of the notes on the run's clock.
    placed = [
        msgspec.structs.replace(note, t_s=(at_ns - zero_ns) / 1e9) if note.t_s is not None else note
        for at_ns, note in notes
    ]
    table, slips = without_outliers(table)
    meta = msgspec.structs.replace(meta, zero_ns=zero_ns, notes=(*meta.notes, *placed, *slips))
    return Run(table.select(_order(table.columns)).cast(pl.Float64), meta)


def _order(columns: Sequence[str]) -> list[str]:
    pwm = [name for name in columns if name.startswith("pwm_")]
    rest = [name for name in columns if name not in REQUIRED and name not in pwm]
    return [REQUIRED[0], *pwm, *REQUIRED[1:], *rest]


def _clean(s: Stream, notes: list[tuple[int, LogProblem]]) -> Stream:
    """The stream with strictly increasing stamps; notes on what was changed are appended to `notes`.

    Late samples are sorted in, repeated and damaged stamps dropped; everything after a clock that was set back is left
    out.
    """

    def note(kind: str, at: int, text: str) -> None:
        notes.append((int(s.t_ns[at]), LogProblem(kind=kind, text=f"{s.name}: {text}", t_s=0.0, length_s=0.0)))

    if (damaged := _isolated(s.t_ns)).any():
        text = f"{int(damaged.sum())} samples stamped more than {BACK_NS / 1e9:g} s off their neighbours are left out"
        note("damaged", int(damaged.argmax()) - 1, text)
        s = s.only(~damaged)
    keep = np.arange(len(s.t_ns))
    back = np.flatnonzero(s.t_ns[1:] < np.maximum.accumulate(s.t_ns)[:-1] - BACK_NS) + 1
    if len(back):
        at = int(back[0])
        step_s = (s.t_ns[at - 1] - s.t_ns[at]) / 1e9
        left = len(keep) - at
        note("clock jump", at - 1, f"the clock goes back by {step_s:.3f} s; {left} samples after it are left out")
        keep = keep[:at]
    order = np.argsort(s.t_ns[keep], kind="stable")
    if moved := int((np.diff(s.t_ns[keep]) < 0).sum()):
        at = int((np.diff(s.t_ns[keep]) < 0).argmax()) + 1
        note("out of order", at, f"{moved} samples came after later ones; sorted in")
    keep = keep[order]
    t_ns = s.t_ns[keep]
    again = np.zeros(len(keep), dtype=bool)
    if s.held:
        again[:-1] = t_ns[1:] == t_ns[:-1]  # of two commands at one instant the last one counts
    else:
        again[1:] = t_ns[1:] == t_ns[:-1]
    if again.any() and not s.held:
        note("duplicate", int(keep[again.argmax()]), f"{int(again.sum())} samples repeat a stamp; the first is kept")
    keep = keep[~again]
    columns = {}
    for name, values in s.columns.items():
        infinite = np.isinf(values[keep])
        if infinite.any():
            note("not a number", int(keep[infinite.argmax()]), f"{name}: {int(infinite.sum())} infinite values; blank")
        columns[name] = np.where(infinite, np.nan, values[keep])
    return Stream(s.name, s.t_ns[keep], columns, s.held, s.near, s.outside)


def _isolated(t_ns: np.ndarray) -> np.ndarray:
    """Mask (n,) of stamps more than `BACK_NS` before the last or after the next one, while these two go on in order.

    So looks a flipped bit. After a clock that was set back, the next stamp is not as far on as a usual step.
    """
    before, t, after = t_ns[:-2], t_ns[1:-1], t_ns[2:]
    found = np.zeros(len(t_ns), dtype=bool)
    if len(t):
        goes_on = after - before >= np.median(np.diff(t_ns))
        found[1:-1] = goes_on & ((t < before - BACK_NS) | (t > after + BACK_NS))
        found[0] = t_ns[0] > t_ns[1] + BACK_NS and t_ns[2] > t_ns[1]  # nothing is before it
    return found


def _without_stray_ends(streams: list[Stream], notes: list[tuple[int, LogProblem]]) -> list[Stream]:
    """Streams without a last sample that stands `STRAY_NS` after all others, their own included; told in `notes`."""
    out = []
    for k, s in enumerate(streams):
        others = [int(o.t_ns[-1]) for o in (*streams[:k], *streams[k + 1 :]) if not o.outside]
        last_ns = max([*others, *s.t_ns[-2:-1].tolist()], default=0)
        away_ns = int(s.t_ns[-1]) - last_ns
        is_stray = bool(others) and not s.outside and away_ns > STRAY_NS
        if is_stray:
            text = f"{s.name}: the last sample, {away_ns / 1e9:g} s after everything else, is left out"
            notes.append((last_ns, LogProblem(kind="damaged", text=text, t_s=0.0, length_s=0.0)))
        out.append(s.only(np.arange(len(s.t_ns)) < len(s.t_ns) - is_stray))
    return [s for s in out if len(s.t_ns)]


def _cut(s: Stream, zero_ns: int, end_ns: int, notes: list[tuple[int, LogProblem]]) -> Stream:
    """An `outside` stream cut to the log proper; others as they are."""
    inside = (s.t_ns >= zero_ns) & (s.t_ns <= end_ns)
    if not s.outside or inside.all():
        return s
    if not inside.any():
        away_s = (s.t_ns[0] - zero_ns) / 1e9
        text = (
            f"{s.name}: none of its {len(inside)} samples falls into the log: it begins {away_s:+.1f} s from its start"
        )
        notes.append((zero_ns, LogProblem(kind="missing", text=text)))
    return s.only(inside)


def _counts(t_ns: np.ndarray) -> np.ndarray:
    """How often each stamp occurs, shape of `t_ns`."""
    _, where, counts = np.unique(t_ns, return_inverse=True, return_counts=True)
    return counts[where]


def _moved(s: Stream, to: Stream) -> Stream:
    """The stream with the stamps of `to` where these are within 1 ms, each used once."""
    if not len(to.t_ns) or not len(s.t_ns):
        return s
    beside_ns = to.t_ns[nearest(to.t_ns, s.t_ns)]
    t_ns = np.where(np.abs(beside_ns - s.t_ns) <= NEAR_NS, beside_ns, s.t_ns)
    again = np.append(False, np.diff(t_ns) == 0)
    t_ns = np.where(again, s.t_ns, t_ns)
    while (clash := (_counts(t_ns) > 1) & (t_ns != s.t_ns)).any():  # one that stands there by itself stays
        t_ns = np.where(clash, s.t_ns, t_ns)
    order = np.argsort(t_ns, kind="stable")
    columns = {name: values[order] for name, values in s.columns.items()}
    return Stream(s.name, t_ns[order], columns, s.held, s.near, s.outside)
