"""Evidence for safety: the kill matrix, in real processes. Each row is a simulator and a companion of its own.

A row without --full is one of the everyday ones; with it there are all. The table at the end says what the thrusters
did, by the simulated autopilot's own outputs.
"""

from __future__ import annotations

import math
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from tests.evidence.line import Line, at_most, exactly, information
from tests.evidence.safe.acts import disk_of
from tests.evidence.safe.cases import CASES, PLAIN, Case
from tests.evidence.safe.trial import ALL_RULES, ARITRA, ENV, Trial

HEAD = "| | broken | thrusters at the end | time | goal | last mode | rules | what it said |"
TOLD = 90
LEASE_S = 0.3
"""A boat that drives on is never so long without an override: `control.lease_s`."""
AT_ONCE = 2
"""Rows at the same time: as many as the machine has cores to spare."""


@dataclass(frozen=True)
class Row:
    """What became of one case. `time_s`: to rest, or to the mode; `thrusters`, `mode`: in the end.

    `gap_s`: the longest time without an override on the wire.
    `after_override_s`: the part of it that is the autopilot's own, see `Trial.after_override_s`.
    """

    case: Case
    time_s: float
    after_override_s: float
    thrusters: str
    mode: str
    told: str
    broken: dict[str, int]
    exit_code: int | None
    gap_s: float = math.inf

    @property
    def safe(self) -> bool:
        """Whether the row's own condition holds."""
        if self.thrusters in ("not begun", "not seen"):
            return False
        match self.case.must:
            case "rest" | "mode hold":
                return self.time_s <= self.case.goal_s
            case "on":
                return self.thrusters == "drive on" and self.gap_s <= LEASE_S
            case "never":
                return self.time_s == 0.0 and self.exit_code == 1
            case "rules":
                return True

    def markdown(self) -> str:
        """One line of the table."""
        time = "-" if self.case.must == "on" or math.isinf(self.time_s) else f"{self.time_s:.2f} s"
        goal = {"rest": f"<= {self.case.goal_s:.1f} s", "mode hold": f"`hold` <= {self.case.goal_s:.1f} s"}
        wanted = goal.get(
            self.case.must, {"on": "drives on", "never": "no motion, exit code 1"}.get(self.case.must, "-")
        )
        rules = "kept" if not any(self.broken.values()) else ", ".join(f"{k} {n}" for k, n in self.broken.items() if n)
        verdict = "" if self.safe else " **falls short**"
        cells = (
            self.case.group,
            self.case.name,
            self.thrusters,
            f"{time}{verdict}",
            wanted,
            self.mode,
            rules,
            self.told,
        )
        return "| " + " | ".join(cells) + " |"


def tried(case: Case) -> Row:
    """Run one case; where it cannot even be begun, the row says so and falls short."""
    try:
        return _tried(case)
    except RuntimeError as error:
        print(f"{case.group}: {case.name}: {error}", file=sys.stderr)
        return Row(
            case, math.inf, math.inf, "not begun", "?", str(error).splitlines()[0], dict.fromkeys(ALL_RULES, 0), None
        )


def _tried(case: Case) -> Row:
    with tempfile.TemporaryDirectory() as name, disk_of(Path(name), case.disk_mb) as log:
        folder = Path(name)
        with Trial(folder, case.sim, [*case.run, *case.config(folder)], case.fault, log) as trial:
            case.before(trial)
            if case.ends_s is None:
                trial.until_driving()
            t0_ns = trial.now() if case.ends_s is None else 0
            case.act(trial)
            if case.ends_s is None:
                trial.observe(case.observe_s)
            else:
                trial.boat.wait(case.ends_s)
            end_ns, printed = trial.now(), trial.printed()
        since_ns = case.since(trial, t0_ns)
        to_mode = case.must == "mode hold"
        mode, why = trial.mode(end_ns)
        alert = trial.alert(since_ns, end_ns) or printed
        told = (why if mode in ("safe", "hold") else alert).replace("|", "/").partition("->")[0]
        return Row(
            case,
            trial.mode_after_s("hold", since_ns) if to_mode else trial.to_rest_s(since_ns, end_ns, case.rest),
            trial.after_override_s(end_ns),
            trial.thrusters(end_ns, case.rest),
            mode,
            told.strip()[:TOLD],
            trial.broken_rules(),
            trial.exit_code,
            trial.longest_gap_s(since_ns, end_ns),
        )


def lines(full: bool) -> Iterator[Line]:
    """Lines of evidence, then the table."""
    found: list[Row] = []
    with ThreadPoolExecutor(AT_ONCE) as pool:
        for row in pool.map(tried, [case for case in CASES if full or case.quick]):
            found.append(row)
            yield _line(row)
    for key, text in (
        ("outside", "overrides outside 1100-1900 us on a thruster's channel"),
        ("elsewhere", "overrides on other channels, but neutral on 1 to 4"),
        ("unleased", "ticks without a lease while running"),
    ):
        yield exactly(f"all rows: {text}", sum(row.broken[key] for row in found), 0)
    late = sum(not row.safe for row in found if row.case.must in ("rest", "never"))
    yield exactly("all rows: motion after neutral was due", late, 0, "rows")
    yield exactly("aritra check on plain pass-through: exit code (1: refused)", _check_plain(), 1)
    print(f"\n{HEAD}\n{'|---' * HEAD.count(' | ')}|---|")
    print("\n".join(row.markdown() for row in found))


def _line(row: Row) -> Line:
    case, what = row.case, f"{row.case.group}: {row.case.name}"
    note = "; ".join(filter(None, [row.thrusters, f"mode {row.mode}", row.told]))
    if case.must in ("rest", "mode hold"):
        return at_most(what, row.time_s, case.goal_s, "s", note)
    if case.must == "rules" and row.safe:
        return information(what, row.time_s, "s", note)
    return exactly(f"{what}: as it must be (1: yes)", float(row.safe), 1, "", note)


def _check_plain() -> int:
    """`aritra check` against an autopilot with plain pass-through."""
    with tempfile.TemporaryDirectory() as name, Trial(Path(name), PLAIN, ["--start"]) as trial:
        trial.boat.wait(60)
        command = [*ARITRA, "check", "--mavlink", f"tcp:127.0.0.1:{trial.tcp}", "--uwb", f"serial:{name}/uwb:115200"]
        done = subprocess.run(command, env=ENV, capture_output=True, text=True, check=False, timeout=120)
        if done.returncode != 1:
            print(done.stdout, done.stderr, file=sys.stderr)
        return done.returncode
