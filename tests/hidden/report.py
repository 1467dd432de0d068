"""Results of many cases as the goals table, a confusion matrix and a list of what failed."""

from __future__ import annotations

import csv
import io
import math
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from tests.hidden.names import FAMILIES, family
from tests.hidden.scoring import confusion_cells

Result = dict[str, Any]


def wilson(hits: int, n: int) -> tuple[float, float]:
    """95 % interval of a share. Source: Wilson, J. Am. Stat. Assoc. 22 (1927) 209."""
    if n == 0:
        return 0.0, 1.0
    z, p = 1.959964, hits / n
    middle, half = p + z * z / (2 * n), z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    return max(0.0, (middle - half) / (1 + z * z / n)), min(1.0, (middle + half) / (1 + z * z / n))


def share(results: Sequence[Result], test: Callable[[Result], bool]) -> str:
    """'93 % (28 of 30; 79-98)'."""
    hits, n = sum(bool(test(r)) for r in results), len(results)
    if not n:
        return "no cases"
    low, high = wilson(hits, n)
    return f"{100 * hits / n:.0f} % ({hits} of {n}; {100 * low:.0f}-{100 * high:.0f})"


def goals(results: Sequence[Result]) -> list[tuple[str, str, str]]:
    """(quantity, goal, reached) for every line of the goals table."""
    of: dict[str, list[Result]] = defaultdict(list)
    for r in results:
        of[r["kind"]].append(r)
    gains, of_structure = (
        [r["gain"][key] for r in results if key in r.get("gain", {})] for key in ("gain", "to_structure")
    )
    parameters = [p for r in results for p in r["parameters"]]
    sizes = [p["relative_error"] for p in parameters if "relative_error" in p]
    covered = [p["covered"] for p in parameters if p.get("covered") is not None]
    slow = [r for r in of["medium"] if r["uwb_hz"] == 1]
    exact: Callable[[Result], bool] = lambda r: r["exact"]  # noqa: E731
    worst = worst_family(of["medium"])
    return [
        ("one medium cause, exact set", ">= 95 %", share(of["medium"], exact)),
        ("  the least found family", ">= 80 %", worst),
        ("small cause named", ">= 85 %", share(of["small"], exact)),
        ("  wrong name", "<= 2 %", share(of["small"], lambda r: bool(r["wrong"]))),
        ("two medium causes, exact set", ">= 90 %", share(of["two"], exact)),
        ("three medium causes, exact set", ">= 75 %", share(of["three"], exact)),
        ("nothing hidden: any name", "<= 2 %", share(of["none"], lambda r: bool(r["named"]))),
        ("  false unknown", "<= 3 %", share(of["none"], lambda r: r["outcome"] == "false_unknown")),
        *_by_tilt(of, exact),
        ("outside: not falsely confirmed", ">= 95 %", share(of["outside"], lambda r: not r.get("falsely_confirmed"))),
        ("  right dependency first", ">= 85 %", share(of["outside"], lambda r: bool(r.get("dependency_right")))),
        ("other form: family named", ">= 85 %", share(of["variant"], lambda r: bool(r["hits"]))),
        ("  and flagged", "flagged", share([r for r in of["variant"] if r["hits"]], lambda r: bool(r.get("flagged")))),
        ("gain relative to the true structure, median / p10", ">= 0.98 / >= 0.90", _gain(of_structure)),
        ("  relative to the truth itself, which no fit knows", "", _gain(gains)),
        ("parameter error, median", "<= 3 %", f"{100 * np.median(sizes):.1f} % (n {len(sizes)})" if sizes else "none"),
        ("95 % intervals that cover", ">= 90 %", _counted(covered)),
        ("one medium cause, UWB 1 Hz 10 cm", ">= 85 %", share(slow, exact)),
        ("time per case, median / worst", "<= 30 / 120 s", _two([r["wall_s"] for r in results if "wall_s" in r], "s")),
        ("  processor time", "", _two([r["cpu_s"] for r in results if "cpu_s" in r], "s")),
        ("memory, worst", "<= 1000 MB", f"{max((r.get('memory_mb', 0) for r in results), default=0):.0f} MB"),
        ("failures (no findings.json)", "0", share(results, lambda r: r["outcome"] == "failure")),
        ("points per case", "", f"{np.mean([r['points'] for r in results]):.3f}" if results else "no cases"),
    ]


def _by_tilt(of: Mapping[str, list[Result]], exact: Callable[[Result], bool]) -> list[tuple[str, str, str]]:
    """Lines for cases with and without roll and pitch in their logs, where there are both."""
    tilted = {bool(r.get("tilt", True)) for results in of.values() for r in results}
    return [
        line
        for told, words in ((True, "with"), (False, "without"))
        if len(tilted) == 2
        for line in (
            (f"{words} roll and pitch: one medium cause", ">= 92 %", share(_told(of["medium"], told), exact)),
            ("  wrong or false extra name", "<= 3 %", share(_told(of["medium"], told), lambda r: bool(r["wrong"]))),
            ("  nothing hidden: any name", "<= 3 %", share(_told(of["none"], told), lambda r: bool(r["named"]))),
        )
    ]


def _told(results: Sequence[Result], tilt: bool) -> list[Result]:
    return [r for r in results if bool(r.get("tilt", True)) == tilt]


def worst_family(results: Sequence[Result]) -> str:
    """The family with the least share of exact answers."""
    by: dict[str, list[bool]] = defaultdict(list)
    for r in results:
        by[family(r["truth"][0])].append(r["exact"])
    if not by:
        return "no cases"
    name = min(by, key=lambda k: (sum(by[k]) / len(by[k]), k))
    below = sum(sum(v) / len(v) < 0.8 for v in by.values())
    return f"{name} {sum(by[name])} of {len(by[name])}; {below} of {len(by)} families below 80 %"


def _gain(gains: Sequence[float]) -> str:
    if not gains:
        return "none measured"
    return f"{np.median(gains):.3f} / {np.percentile(gains, 10):.3f} (n {len(gains)})"


def _counted(flags: Sequence[bool]) -> str:
    return f"{100 * sum(flags) / len(flags):.0f} % (n {len(flags)})" if flags else "none"


def _two(values: Sequence[float], unit: str) -> str:
    return f"{np.median(values):.1f} / {max(values):.1f} {unit}" if values else "none"


def confusion(results: Sequence[Result]) -> tuple[list[str], list[str], Counter]:
    """Rows, columns, counts."""
    cells = Counter(cell for r in results for cell in confusion_cells(r))
    order = {name: i for i, name in enumerate(FAMILIES)}
    rows = sorted({r for r, _ in cells}, key=lambda n: (order.get(n, 99), n))
    columns = sorted({c for _, c in cells}, key=lambda n: (order.get(n, 99), n))
    return rows, columns, cells


def confusion_csv(results: Sequence[Result]) -> str:
    """Confusion matrix as CSV: a row for what was true, a column for what was said."""
    rows, columns, cells = confusion(results)
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["true", *columns])
    writer.writerows([row, *(cells[row, column] for column in columns)] for row in rows)
    return out.getvalue()


def markdown(results: Sequence[Result], head: dict[str, Any]) -> str:
    """Summary for people: goals, the matrix off its diagonal, every case that is not right."""
    lines = ["# Hidden-effect cases", "", *(f"- {k}: {v}" for k, v in head.items()), ""]
    lines += ["| quantity | goal | reached |", "|---|---|---|", *(f"| {a} | {b} | {c} |" for a, b, c in goals(results))]
    lines += ["", "## What was said of what was true", "", "| true | right | else |", "|---|---|---|"]
    rows, columns, cells = confusion(results)
    for row in rows:
        other = ", ".join(f"{c} {cells[row, c]}" for c in columns if c != row and cells[row, c])
        lines.append(f"| {row} | {cells[row, row]} | {other} |")
    lines += ["", "## Not right", "", "| case | kind | true | said | outcome |", "|---|---|---|---|---|"]
    for r in results:
        if r["outcome"] in ("exact", "unknown_right"):
            continue
        true = ", ".join(r["truth"]) or r["outside"] or "nothing"
        said = ", ".join(r["named"]) or r["verdict"]
        lines.append(f"| {r['index']} | {r['kind']} | {true} | {said} | {r['outcome']} {r.get('why', '')} |")
    return "\n".join(lines) + "\n"
