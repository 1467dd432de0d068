"""A benchmark as a table for a terminal of 80 columns."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from sim.bench.controller.compare import AT_CADENCE
from sim.bench.controller.worlds import TICK_S
from sim.bench.result import Bench, BenchRow, Growth, MachineInfo, SolverRefused

HEADS = {
    "solvers": "Solvers, hot, in turn on the same recorded states",
    "cadence": "Controller at a true 10 Hz (asleep in between: cold caches), and hot",
    "simulation": "Simulation, boat's seconds per second of one core",
    "fit": "Identification, structured fit beside scipy",
    "start": "Fresh process to its first plan",
}


REMARK = " "
ROOM = 0.2
"""Share of a tick that the controller may take; the rest is for filter, links, log, and a crowded moment. Assumed."""
UNITS = {"s": "time", "MB": "memory"}
LEAST_OFF = 1e-6
LEGEND = {
    "solvers": "times: fastest round of IPOPT over the median round of this. off: how far its first command is from "
    "IPOPT's at the same states, p99 [N; paper: kgf].",
    "simulation": "off: largest difference from CasADi's mapaccum of any state over the run.",
}
"""What the columns mean, below their table."""


def show(console: Console, bench: Bench) -> None:
    """Machine, one table a part, refusals, growth."""
    for part in dict.fromkeys(row.part for row in bench.rows):
        rows = [row for row in bench.rows if row.part == part]
        console.print(Text(f"\n{HEADS.get(part, part)}", style="bold"))
        console.print(_table(rows))
        if part in LEGEND:
            console.print(Text(LEGEND[part], style="dim"))
    if bench.growth:
        console.print(Text("\nGrowth: cost ~ size to the power", style="bold"))
        console.print(_growth(bench.growth))
    for one in bench.refused:
        console.print(_refusal(one))
    console.print(Text(f"\n{about(bench.machine)}"))
    if said := fits(bench.rows):
        console.print(Text(said, style="bold"))


def fits(rows: Sequence[BenchRow]) -> str:
    """What the figures mean for a boat: the controller's share of a tick; empty where that was not measured."""
    for row in rows:
        if row.name == AT_CADENCE and row.p99 is not None:
            share = row.p99 / (TICK_S * 1e6)
            word = "The controller fits" if share < ROOM else "The controller does NOT fit"
            return f"{word}: p99 {quantity(row.p99, 'us')} of the {TICK_S * 1e3:.0f} ms of a tick."
    return ""


def about(m: MachineInfo) -> str:
    """The machine in two lines."""
    libraries = ", ".join(f"{name} {version}" for name, version in m.versions.items())
    governor = f", governor {m.governor}" if m.governor else ""
    return (
        f"{m.cpu}, {m.cores} cores, {m.architecture}, {m.kernel}{governor}; load {m.load_before:.1f} before, "
        f"{m.load_after:.1f} after\nPython {m.python}, {libraries}"
    )


def _table(rows: Sequence[BenchRow]) -> Table:
    """Rows of one part, grouped by problem; columns that are empty are left out."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("", no_wrap=True)
    columns = [(head, cell) for head, cell in _columns(rows).items() if any(cell(row) for row in rows)]
    for head, _ in columns:
        table.add_column(head, justify="left" if head == REMARK else "right", no_wrap=head != REMARK)
    several = len({row.problem for row in rows}) > 1
    for problem in dict.fromkeys(row.problem for row in rows):
        if several:
            table.add_row(Text(problem, style="italic"))
        for name in dict.fromkeys(row.name for row in rows if row.problem == problem):
            same = [row for row in rows if (row.problem, row.name) == (problem, name)]
            table.add_row(name, *("".join(cell(row) for row in same) for _, cell in columns))
    return table


def _columns(rows: Sequence[BenchRow]) -> dict[str, Callable[[BenchRow], str]]:
    """Heads, and what stands below. Several units in one part: a column each."""
    tails, units = any(row.p99 is not None for row in rows), dict.fromkeys(row.unit for row in rows)
    several = len(units) > 1

    def of(unit: str) -> Callable[[BenchRow], str]:
        return lambda row: quantity(row.p50, unit) if row.unit == unit else ""

    values = {UNITS.get(u, u): of(u) for u in units} if several else {
        "p50" if tails else "figure": lambda row: quantity(row.p50, row.unit)
    }  # fmt: skip
    return values | {
        "p99": lambda row: "" if row.p99 is None else quantity(row.p99, row.unit),
        "times": lambda row: times(row.times),
        "at p99": lambda row: times(row.times_p99),
        "off": _off,
        REMARK: _remark,
    }


def _off(row: BenchRow) -> str:
    if row.off is None or (row.reference and row.off == 0.0):
        return ""
    return f"{row.off:.1e}" if row.off >= LEAST_OFF else "0"


def _remark(row: BenchRow) -> str:
    return ", ".join([*([f"{row.unsolved} not solved"] if row.unsolved else []), *([row.note] if row.note else [])])


def quantity(value: float, unit: str) -> str:
    """Three digits with a unit that suits: 18.3 us, 17.4 ms, 231 MB."""
    if unit == "us" and value >= 1e3:
        value, unit = value / 1e3, "ms"
    digits = 0 if value >= 100 else 1 if value >= 10 else 2
    return f"{value:,.{digits}f} {unit}"


def times(ratio: float | None) -> str:
    """A ratio with two or three digits."""
    if ratio is None:
        return ""
    return f"{ratio:.0f} x" if ratio >= 20 else f"{ratio:.1f} x" if ratio >= 1 else f"{ratio:.2f} x"


def _growth(growth: Sequence[Growth]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for head in ("", "smallest", "largest", "power", "first", "last", "bends"):
        table.add_column(head, justify="right" if head else "left", no_wrap=True, min_width=len(head))
    before = ""
    for g in growth:
        low, high = g.points[0], g.points[-1]
        if g.by != before:
            table.add_row(Text(f"{low.size:g} to {high.size:g} {g.by}", style="italic"))
            before = g.by
        values = [quantity(p.value, g.unit.split()[0]) for p in (low, high)]
        powers = [f"{power:.2f}" for power in (g.exponent, g.first_exponent, g.last_exponent)]
        table.add_row(g.what, *values, *powers, "" if g.bends_at is None else f"{g.bends_at:g}")
    return table


def _refusal(one: SolverRefused) -> Text:
    what = ", ".join(dict.fromkeys(word for word in (one.part, one.problem, one.name) if word))
    return Text(f"not run: {what}: {one.why}", style="yellow")
