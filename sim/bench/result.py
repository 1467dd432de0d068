"""What a benchmark found, as it is written to JSON: rows, refusals, machine, settings (docs/bench.md)."""

from __future__ import annotations

from pathlib import Path

import msgspec

SCHEMA = 1
"""Rises when a key changes its meaning or goes; a new one does not raise it."""


class BenchRow(msgspec.Struct, frozen=True, kw_only=True):
    """One figure. `p50`, `p99`: of `count` samples, median over the rounds; `p99` None: too few samples for one.

    `times`, `times_p99`: the reference's fastest round over this, where the part has one; `reference`: this is it.
    `off`: p99 of the distance of the first command from the reference's, in the unit of the problem's controls.
    """

    part: str
    problem: str
    name: str
    unit: str
    p50: float
    count: int
    rounds: int = 1
    p99: float | None = None
    times: float | None = None
    times_p99: float | None = None
    reference: bool = False
    off: float | None = None
    unsolved: int = 0
    note: str = ""


class SolverRefused(msgspec.Struct, frozen=True, kw_only=True):
    """What did not run here, and why."""

    part: str
    problem: str
    name: str
    why: str


class GrowthPoint(msgspec.Struct, frozen=True, kw_only=True):
    """Cost at one size."""

    size: float
    value: float


class Growth(msgspec.Struct, frozen=True, kw_only=True):
    """How a cost grows with a size: points, and the exponent of value ~ size^exponent between neighbours and overall.

    `bends_at`: size from which the exponent is another one, None where one power law fits.
    """

    what: str
    by: str
    unit: str
    points: tuple[GrowthPoint, ...]
    exponent: float
    first_exponent: float
    last_exponent: float
    bends_at: float | None
    note: str = ""


class MachineInfo(msgspec.Struct, frozen=True, kw_only=True):
    """Where it ran. Loads are those of the last minute, before and after."""

    cpu: str
    architecture: str
    cores: int
    memory_mb: float
    kernel: str
    python: str
    versions: dict[str, str]
    threads: dict[str, str]
    governor: str
    load_before: float
    load_after: float


class BenchSettings(msgspec.Struct, frozen=True, kw_only=True):
    """What was asked for."""

    vessel: str
    problems: tuple[str, ...]
    solves: int
    rounds: int
    cadence_solves: int
    seed: int
    only: str
    growth: bool


class Bench(msgspec.Struct, frozen=True, kw_only=True):
    """Everything."""

    schema: int
    program: dict[str, str]
    begun_utc: str
    seconds: float
    machine: MachineInfo
    settings: BenchSettings
    rows: tuple[BenchRow, ...]
    refused: tuple[SolverRefused, ...]
    growth: tuple[Growth, ...]


def write(path: Path, bench: Bench) -> None:
    """As JSON, one key a line."""
    path.write_bytes(msgspec.json.format(msgspec.json.encode(bench), indent=1) + b"\n")


def read(path: Path) -> Bench:
    """Of a file that `write` wrote; msgspec.ValidationError where it is none."""
    return msgspec.json.decode(path.read_bytes(), type=Bench)
