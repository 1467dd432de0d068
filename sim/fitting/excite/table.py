"""Tables for the console: precision of each parameter now and after a plan, and which manoeuvre to fly next."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from rich.table import Table

from sim.fitting.engine.free_parameters import unit_of
from sim.fitting.excite.design import Advice, CandidateManoeuvre, worth_per_s
from sim.fitting.excite.information import Knowledge, indices_of_interest

FEW = 5


def known_to(known: Knowledge, i: int) -> str:
    """Standard error of a parameter as a share of its value, or in its unit where the value is 0."""
    value, se = float(known.value[i]), float(known.se[i])
    percent = 100 * se / abs(value) if value else 0.0
    if value:
        return f"{percent:.0f} %" if percent >= 10 else f"{percent:.2g} %"
    return f"{se:.2g} {unit_of(known.parameters.names[i])}"


def expected(now: Knowledge, after: Knowledge, title: str) -> Table:
    """Table of all parameters: value, precision now and after a plan, and whether it stays undetermined."""
    table = Table(title=title, title_justify="left")
    for name in ("parameter", "value", "known to", "after", ""):
        table.add_column(name, justify="left" if name in ("parameter", "") else "right")
    for i, name in enumerate(after.parameters.names):
        value = f"{after.value[i]:.4g}"
        mark = "not determined" if after.undetermined[i] else ""
        table.add_row(name, value, known_to(now, i), known_to(after, i), mark)
    return table


def next_steps(advice: Advice) -> Table:
    """Table of the parameters of interest: precision now, and after the most informative manoeuvre."""
    table = Table(title="What would show each parameter (* the proposal is about these)", title_justify="left")
    for name in ("parameter", "known to", "after", "manoeuvre"):
        table.add_column(name, justify="right" if name in ("known to", "after") else "left")
    for row in advice.rows:
        name = row.now.parameters.names[row.index] + (" *" if row.index in advice.about else "")
        table.add_row(name, known_to(row.now, row.index), known_to(row.after, row.index), row.best.segment.name)
    return table


def reasons(advice: Advice) -> list[str]:
    """Reasons of the manoeuvres of `next_steps`, one line each."""
    named = {row.best.segment.name: row.best.segment.why for row in advice.rows}
    return [f"  {name}: {why}" for name, why in named.items() if why]


def proposal(advice: Advice) -> list[str]:
    """The advice as lines of text: what it is about, the manoeuvre, its effect, alternatives."""
    best, known = advice.ranked[0], advice.rows[0].now
    names = [known.parameters.names[i] for i in advice.about]
    open_ = [i for i in advice.about if known.undetermined[i]]
    about = f"not determined yet: {', '.join(names)}" if open_ else f"known least, for what could be known: {names[0]}"
    lines = [about, f"do this next: {best.segment.name} ({best.duration_s:.0f} s): {best.segment.why or 'see table'}"]
    after = known.with_information(best.information)
    falls = sorted(advice.about, key=lambda i: after.share[i] / known.share[i])
    shown = [f"{known.parameters.names[i]} {known_to(known, i)} -> {known_to(after, i)}" for i in falls[:FEW]]
    lines.append(f"  it would bring {', '.join(shown)}")
    others = [f"{c.segment.name} ({c.duration_s:.0f} s)" for c in advice.ranked[1:4]]
    if others:
        lines.append(f"  after that in worth: {', '.join(others)}")
    return lines


def choices(chosen: Sequence[CandidateManoeuvre], start: Knowledge, least: np.ndarray) -> Table:
    """Table of a plan's segments in the order of choice: time, and information gained [nats]."""
    table = Table(title="Chosen, in this order", title_justify="left")
    for name in ("segment", "time", "nats", "why"):
        table.add_column(name, justify="right" if name in ("time", "nats") else "left")
    known = start
    for c in chosen:
        nats = worth_per_s(known, c, least, "d") * c.duration_s
        table.add_row(c.segment.name, f"{c.duration_s:.0f} s", f"{nats:.2f}", c.segment.why)
        known = known.with_information(c.information)
    return table


def worst_open(known: Knowledge) -> str:
    """Number of determined parameters of interest, and the names of the others, as text."""
    of = indices_of_interest(known.vessel)
    names = [known.parameters.names[i] for i in of if known.undetermined[i]]
    return f"{len(of) - len(names)} of {len(of)} parameters determined" + (
        f"; not: {', '.join(names)}" if names else ""
    )
