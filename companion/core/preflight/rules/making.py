"""How the rules make their rows."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from companion.core.preflight.rows import Level, ParameterSet, Row, number, numbers
from companion.core.preflight.wiring import Companion, Output, Wiring

AREA = "autopilot"
PROVISION = "`aritra provision --wiring gate`, then reboot the autopilot"

Rule = Callable[[ParameterSet, Wiring, Companion], Iterator[Row]]


def row(name: str, level: Level, found: str, needed: str, why: str, fix: str) -> Row:
    """One row of the autopilot's parameters; nothing is to be done where it is ok."""
    return Row(area=AREA, name=name, level=level, found=found, needed=needed, why=why, fix="" if level == "ok" else fix)


def expected(p: ParameterSet, name: str, value: float, otherwise: Level, why: str) -> Iterator[Row]:
    """A parameter that should have one value."""
    found = p.get(name)
    yield row(name, "ok" if found == value else otherwise, number(found), f"{value:g}", why, f"set it to {value:g}")


def row_of_several(
    stem: str, key: str, values: dict[int, int], bad: list[int], level: Level, needed: str, why: str, fix: str
) -> Row:
    """One row for a parameter of several outputs or channels."""
    shown = {n: values[n] for n in bad} or values
    found = " ".join(map(str, shown.values())) if len(set(shown.values())) > 1 else str(next(iter(shown.values())))
    return row(f"{stem}{numbers(shown)}_{key}", level, found, needed, why, fix)


def function_row(p: ParameterSet, outputs: tuple[Output, ...], level: Level, needed: str, why: str, fix: str) -> Row:
    """One row for the SERVOn_FUNCTION of `outputs`, which are of one kind."""
    values = {o.number: o.function for o in outputs}
    name, found = f"SERVO{numbers(values)}_FUNCTION", numbers(values.values())
    return row(name, level, f"{found} ({outputs[0].kind})", needed, why, fix)
