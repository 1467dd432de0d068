"""A log as tables: one a topic, each with the same time base. polars is of the extra `analysis`.

    t_s       seconds since the log's first message, in all tables alike
    unix_s    Unix time as the boat's wall clock had it at the start; blank where the log does not say
    ...       the fields of the message, by their own names, which end in their units

A vector of numbers becomes a column an element (`pwm_us_0`, `pwm_us_1`), a table of names a column a name
(`anchor_bias_m_1151`), a list of records a row a record (ranges of one cycle share their stamp). Lists of vectors
(`/plan_result.x`) stay one column: nested lists, in CSV their JSON.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import polars as pl
from msgspec import inspect

from companion.cli.options.outputs import making
from companion.core.messages import Message
from companion.logs.configuration import zero_ns_of
from companion.logs.log_file import LogFile
from companion.logs.schema import KINDS

BATCH = 2000
"""Messages of a topic that wait as Python objects before they become numbers in a table: bounds memory."""
INDEX = "log.json"
_PARQUET_KEY = "aritra_topic"
_SCALARS: dict[type, Any] = {
    inspect.IntType: pl.Int64,
    inspect.FloatType: pl.Float64,
    inspect.BoolType: pl.Boolean,
    inspect.StrType: pl.String,
    inspect.LiteralType: pl.String,
}
Say = Callable[[int], None]


@dataclass(frozen=True)
class Tables:
    """`by_topic`: without the leading slash. `zero_ns`: `t_ns` at t_s = 0; `wall_offset_ns`: None: not stated."""

    by_topic: Mapping[str, pl.DataFrame]
    zero_ns: int
    wall_offset_ns: int | None


def tables(log: LogFile, truth: LogFile | None = None, say: Say = lambda _count: None) -> Tables:
    """All messages but raw bytes. `truth`: the simulator's log, for its topics that the boat's does not have.

    `say` is called with the number of messages read.
    """
    zero_ns, offset_ns = zero_ns_of(log), log.wall_offset_ns or None
    parts = _frames(log, say)
    if truth:
        parts = {**_frames(truth, say), **parts}
    made = {topic.lstrip("/"): _table(frames, zero_ns, offset_ns) for topic, frames in sorted(parts.items())}
    return Tables(made, zero_ns, offset_ns)


def _frames(log: LogFile, say: Say) -> dict[str, list[pl.DataFrame]]:
    """Each topic's messages, in pieces."""
    waiting: dict[str, list[Message]] = defaultdict(list)
    done: dict[str, list[pl.DataFrame]] = defaultdict(list)
    for count, entry in enumerate(log.entries()):
        if count % BATCH == 0:
            say(count)
        if entry.topic not in KINDS or (message := log.decode(entry)) is None:
            continue
        batch = waiting[entry.topic]
        batch.append(message)
        if len(batch) >= BATCH:
            done[entry.topic].append(_frame(batch))
            batch.clear()
    for topic, batch in waiting.items():
        if batch:
            done[topic].append(_frame(batch))
    return done


def _frame(batch: Sequence[Message]) -> pl.DataFrame:
    """Columns of messages of one class; lists not yet spread over columns."""
    columns = []
    for field in msgspec.structs.fields(type(batch[0])):
        values = [getattr(message, field.name) for message in batch]
        kind = inspect.type_info(field.type)
        if isinstance(kind, inspect.DictType):
            names = sorted({name for value in values for name in value})
            one = dtype_of(kind.value_type)
            columns += [pl.Series(f"{field.name}_{n}", [v.get(n) for v in values], dtype=one) for n in names]
        else:
            columns.append(pl.Series(field.name, msgspec.to_builtins(values), dtype=dtype_of(kind)))
    return pl.DataFrame(columns)


def dtype_of(kind: inspect.Type) -> Any:
    """polars' type of a field. TypeError: a message has a field of a kind that tables have no form for."""
    if isinstance(kind, inspect.UnionType):
        (kind,) = (option for option in kind.types if not isinstance(option, inspect.NoneType))
    if isinstance(kind, inspect.VarTupleType):
        return pl.List(dtype_of(kind.item_type))
    if isinstance(kind, inspect.StructType):
        return pl.Struct({field.name: dtype_of(field.type) for field in kind.fields})
    if type(kind) not in _SCALARS:
        raise TypeError(f"{kind}: no column for it")
    return _SCALARS[type(kind)]


def _table(frames: Sequence[pl.DataFrame], zero_ns: int, wall_offset_ns: int | None) -> pl.DataFrame:
    whole, t_ns = pl.concat(frames, how="diagonal"), pl.col("t_ns")
    unix = (t_ns + wall_offset_ns) / 1e9 if wall_offset_ns is not None else pl.lit(None, pl.Float64)
    columns = [((t_ns - zero_ns) / 1e9).alias("t_s"), unix.alias("unix_s")]
    for name, dtype in whole.schema.items():
        if isinstance(dtype, pl.List) and isinstance(dtype.inner, pl.Struct):
            whole = whole.explode(name).unnest(name)
            columns += [pl.col(field.name) for field in dtype.inner.fields]
        elif isinstance(dtype, pl.List) and not isinstance(dtype.inner, pl.List):
            width = max(whole[name].list.len(), default=0)
            columns += [pl.col(name).list.get(i, null_on_oob=True).alias(f"{name}_{i}") for i in range(width)]
        else:
            columns.append(pl.col(name))
    return whole.select(columns)


def write(found: Tables, folder: Path, form: str, about: Mapping[str, Any]) -> list[Path]:
    """One file a topic in `folder`, `form` csv or parquet, and `log.json`: `about`, the clock, and what is where.

    All of them or none. Raises ConfigError.
    """
    written, listed = [], {}
    with ExitStack() as all_or_none:
        if not folder.is_dir():
            all_or_none.enter_context(making(folder))
            folder.mkdir(parents=True)
        for topic, table in found.by_topic.items():
            path = folder / f"{topic}.{form}"
            all_or_none.enter_context(making(path, pl.exceptions.PolarsError))
            if form == "csv":
                table.with_columns(_as_json(table)).write_csv(path)
            else:
                head = {"topic": f"/{topic}", "zero_ns": found.zero_ns, "wall_offset_ns": found.wall_offset_ns}
                table.write_parquet(path, metadata={_PARQUET_KEY: msgspec.json.encode(head).decode()})
            written.append(path)
            listed[topic] = {"file": path.name, "rows": table.height}
        index = {**about, "zero_ns": found.zero_ns, "wall_offset_ns": found.wall_offset_ns, "topics": listed}
        path = folder / INDEX
        all_or_none.enter_context(making(path))
        path.write_bytes(msgspec.json.format(msgspec.json.encode(index), indent=2) + b"\n")
    return [*written, path]


def _as_json(table: pl.DataFrame) -> list[pl.Series]:
    """Columns of lists as text: CSV has no other place for them."""
    nested = [name for name, dtype in table.schema.items() if isinstance(dtype, pl.List)]
    return [pl.Series(name, [msgspec.json.encode(v).decode() for v in table[name].to_list()]) for name in nested]
