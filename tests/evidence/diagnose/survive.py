"""Evidence for diagnosis: logs that are not as they should be end in a clear refusal or the right cause."""

from __future__ import annotations

import contextlib
import io
import math
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path

import msgspec
import numpy as np
import polars as pl
from msgspec.structs import replace
from rich.console import Console

from companion.cli.diagnose import add_parser, diagnose
from companion.cli.options.parser import Parser
from companion.core.configuration.vessel_file import VesselFile
from companion.core.model.load_vessel import load_vessel
from companion.logs.readers.table import write_run
from companion.logs.runs.run import Run
from sim.world.teleop_log import Habits, KeyboardPilot, teleop_run
from tests.evidence.line import Line, at_most, exactly

BOATS = Path(__file__).resolve().parents[3] / "deploy" / "boats"
SEED = 6101
SECONDS = 100.0
HOUR_S = 3600.0
MINUTES = 10.0
"""Of process time, for an hour's log."""
WEAK = 0.6
"""Gain of the thruster that is wrong where something is."""
SPINS = partial(KeyboardPilot, habits=Habits(most=(12.0, 12.0, 9.0), use=(0.5, 0.3, 0.95)))
Table = pl.DataFrame
Alter = Callable[[Table], Table]
ABSTAINED = ("unknown", "ambiguous", "partial")


@cache
def vessel(name: str) -> VesselFile:
    return load_vessel((BOATS / f"{name}.toml").read_text(), name=f"{name}.toml")


@cache
def log(boat: str, weak: str, seed: int, seconds: float, uwb_hz: float, spins: bool) -> Run:
    """Teleoperation of `boat` with the thruster `weak` at `WEAK` of its force (empty: none), without the truth."""
    base = vessel(boat)
    true = replace(
        base, thrusters=tuple(replace(t, gain=t.gain * WEAK if t.name == weak else t.gain) for t in base.thrusters)
    )
    sigma_m, pilot = (0.07 if uwb_hz > 1 else 0.10), (SPINS if spins else KeyboardPilot)
    run = teleop_run(true, seed, seconds, uwb_hz=uwb_hz, sigma_m=sigma_m, pilot=pilot, believed=base)
    return Run(run.table.select(c for c in run.table.columns if not c.startswith("true_")), run.meta)


@dataclass(frozen=True)
class Case:
    """One thing that goes wrong with logs. `right`: the causes that may be named; `words`: that a refusal must hold.

    `wiring`: the fault of signs and sides that is put right beforehand. `silent`: whether a verdict without a name is
    also an answer (where the log holds no cause, it always is).
    """

    what: str
    alter: Alter = lambda table: table
    right: tuple[str, ...] = ()
    wiring: tuple[str, ...] = ()
    words: tuple[str, ...] = ()
    boat: str = "aritra"
    weak: str = ""
    believed: str = ""
    seconds: float = SECONDS
    uwb_hz: float = 5.0
    spins: bool = False
    logs: int = 1
    meta: dict[str, object] = field(default_factory=dict)
    silent: bool = False


@dataclass(frozen=True)
class Outcome:
    """Exit code, what was said of a refusal, verdict and names, process time [s]; `crash`: the exception, if one.

    `wiring`: faults of sensors that were put right beforehand.
    """

    code: int
    said: str
    verdict: str
    names: tuple[str, ...]
    cpu_s: float
    crash: str = ""
    wiring: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        """In a line."""
        if self.crash:
            return f"traceback: {self.crash}"
        if self.code == 2:
            return f"refused: {self.said}"
        return f"{self.verdict}: {', '.join((*self.wiring, *self.names)) or 'no name'}, {self.cpu_s:.0f} s"


def outcome(case: Case) -> Outcome:
    """What the command makes of the case's files."""
    with tempfile.TemporaryDirectory() as folder:
        here, paths = Path(folder), []
        for i in range(case.logs):
            run = log(case.boat, case.weak, SEED + i, case.seconds, case.uwb_hz, case.spins)
            paths.append(here / f"drive{i + 1}.csv")
            _write(run, case.alter(run.table), case.meta, paths[-1])
        return command(paths, BOATS / f"{case.believed or case.boat}.toml", here / "out")


def _write(run: Run, table: Table, meta: dict[str, object], path: Path) -> None:
    """As a file, whatever the table has become: what a Run refuses is written all the same."""
    whole = Run(run.table[:1], msgspec.structs.replace(run.meta, **meta))
    write_run(whole, path)
    head = [line for line in path.read_text().splitlines() if line.startswith("#") and "data_hash" not in line]
    path.write_text("\n".join(head) + "\n" + table.write_csv())


def command(paths: Sequence[Path], believed: Path, out: Path) -> Outcome:
    """`aritra diagnose PATHS --vessel BELIEVED --out OUT --no-report` in this process."""
    parser = Parser()
    add_parser(parser.add_subparsers())
    words = ["diagnose", *map(str, paths), "--vessel", str(believed), "--out", str(out), "--no-report"]
    errors, began = io.StringIO(), time.process_time()
    try:
        with contextlib.redirect_stderr(errors):
            code = diagnose(parser.parse_args(words), Console(file=io.StringIO()))
    except Exception as error:
        return Outcome(-1, "", "", (), time.process_time() - began, f"{type(error).__name__}: {error}")
    spent, said = time.process_time() - began, errors.getvalue().strip().replace(str(out.parent) + "/", "")
    if code == 2:
        return Outcome(code, said.removeprefix("aritra diagnose: "), "", (), spent)
    found = msgspec.json.decode((out / "findings.json").read_bytes())
    names = tuple(c["name"] for c in found["causes"])
    put_right = tuple(f["name"] for f in found["wiring"]["findings"] if f["certain"] and not f["thrusters"])
    return Outcome(code, said, found["verdict"], names, spent, wiring=put_right)


def holds(case: Case, found: Outcome) -> bool:
    """A clear refusal where one is due; else nothing but right names, all of them unless it abstains."""
    if found.crash:
        return False
    if found.code == 2:
        return bool(case.words) and all(word in found.said for word in case.words)
    if found.wiring != case.wiring:
        return False
    if case.words and not case.right:
        return found.verdict == "unknown" and not found.names
    if not set(found.names) <= set(case.right):
        return False
    return set(found.names) == set(case.right) or (case.silent and found.verdict in ABSTAINED)


# --- what happens to logs ---------------------------------------------------------------------------------------


def blank(*columns: str) -> Alter:
    return lambda table: table.with_columns(pl.lit(None, pl.Float64).alias(c) for c in columns)


def swapped(one: str, other: str) -> Alter:
    return lambda table: table.with_columns(pl.col(other).alias(one), pl.col(one).alias(other))


def without_rows(begin_s: float, end_s: float) -> Alter:
    return lambda table: table.filter((pl.col("t_s") < begin_s) | (pl.col("t_s") > end_s))


def blank_between(begin_s: float, end_s: float, *columns: str) -> Alter:
    inside = pl.col("t_s").is_between(begin_s, end_s)
    return lambda table: table.with_columns(pl.when(inside).then(None).otherwise(pl.col(c)).alias(c) for c in columns)


def not_numbers(share: float, *columns: str) -> Alter:
    """NaN in that share of the values, the same rows for all columns."""

    def alter(table: Table) -> Table:
        lost = pl.Series(np.random.default_rng(SEED).uniform(size=len(table)) < share)
        return table.with_columns(
            pl.when(lost & pl.col(c).is_not_null()).then(math.nan).otherwise(pl.col(c)).alias(c) for c in columns
        )

    return alter


def moved(column: str, by: float) -> Alter:
    return lambda table: table.with_columns(pl.col(column) + by)


def times(column: str, factor: float) -> Alter:
    return lambda table: table.with_columns(pl.col(column) * factor)


PULSES = tuple(f"pwm_{name}" for name in ("front_port", "front_starboard", "rear_port", "rear_starboard"))
WEAK_ONE = {"weak": "rear_port", "right": ("thruster_gain:rear_port",)}
CASES = (
    Case("one log, nothing else wrong", **WEAK_ONE),
    Case("two thrusters, all well", boat="twin"),
    Case("two thrusters, one weak", boat="twin", weak="port", right=("thruster_gain:port",)),
    Case("another boat's log", boat="twin", believed="aritra", words=("drive1.csv", "pwm_port", "front_port")),
    Case("no voltage", blank("battery_v"), **WEAK_ONE),
    Case("UWB at 1 Hz, two logs", uwb_hz=1.0, logs=2, **WEAK_ONE),
    Case("a heading that wraps", spins=True, **WEAK_ONE),
    Case("a heading in 0 to 2 pi", lambda t: t.with_columns(pl.col("psi_rad") % (2 * math.pi)), **WEAK_ONE),
    Case("NaN in two per cent of heading, rate, accelerations",
         not_numbers(0.02, "psi_rad", "r_rad_s", "ax_m_s2", "ay_m_s2"), **WEAK_ONE),
    Case("NaN in two per cent of positions, pulses, voltage",
         not_numbers(0.02, "north_m", "east_m", "battery_v", *PULSES), **WEAK_ONE),
    Case("NaN in half of a position", not_numbers(0.02, "north_m"), **WEAK_ONE),
    Case("NaN for a time", not_numbers(0.001, "t_s"), **WEAK_ONE),
    Case("recording pauses for 30 s", without_rows(40.0, 70.0), seconds=130.0, **WEAK_ONE),
    Case("recording pauses for 30 s in what is held out", without_rows(95.0, 125.0), seconds=140.0, **WEAK_ONE),
    Case("no positions for 30 s", blank_between(20.0, 50.0, "north_m", "east_m"), **WEAK_ONE),
    Case("no IMU for 30 s", blank_between(20.0, 50.0, "psi_rad", "r_rad_s", "ax_m_s2", "ay_m_s2"), **WEAK_ONE),
    Case("north and east swapped", swapped("north_m", "east_m"), wiring=("positions:swapped",)),
    Case("ax and ay swapped", swapped("ax_m_s2", "ay_m_s2"), wiring=("accelerations:swapped",)),
    Case("two columns of pulses swapped", swapped(PULSES[0], PULSES[1]),
         right=("swapped_pair:front_port+front_starboard",)),
    Case("two columns of pulses swapped, fore and aft", swapped(PULSES[1], PULSES[3]),
         right=("swapped_pair:front_starboard+rear_starboard",), silent=True),
    Case("yaw rate in deg/s", times("r_rad_s", 57.29578), words=("drive1.csv", "r_rad_s")),
    Case("yaw rate positive to port", times("r_rad_s", -1.0), wiring=("gyro:reversed",)),
    Case("accelerations in g", lambda t: times("ax_m_s2", 1 / 9.80665)(times("ay_m_s2", 1 / 9.80665)(t)),
         wiring=("accelerations:unit",)),
    Case("first rows before the first command", blank_between(0.0, 6.0, *PULSES), **WEAK_ONE),
    Case("one thruster's commands begin later", blank_between(0.0, 6.0, PULSES[0]), **WEAK_ONE),
    Case("time counted from 1970", moved("t_s", 1.79e9), **WEAK_ONE),
    Case("10 s", seconds=10.0, words=("drive1.csv", "10.0 s", "least")),
    Case("45 s", seconds=45.0, words=("drive1.csv", "45.0 s", "least")),
    Case("three positions", blank_between(0.6, 99.0, "north_m", "east_m"), words=("drive1.csv", "positions")),
    Case("no positions", blank("north_m", "east_m"), words=("drive1.csv", "north_m", "blank")),
    Case("no heading", blank("psi_rad"), words=("drive1.csv", "psi_rad", "blank")),
    Case("no anchors", meta={"anchors_m": {}}, **WEAK_ONE),
    Case("no accelerations", blank("ax_m_s2", "ay_m_s2"), **WEAK_ONE),
    Case("no yaw rate, no roll and pitch", blank("r_rad_s", "phi_rad", "theta_rad"), **WEAK_ONE),
    Case("a boat that lies still", lambda t: t.with_columns(pl.lit(1500.0).alias(c) for c in PULSES), seconds=100.0,
         words=("drive1.csv", "no thruster ever leaves neutral")),
)  # fmt: skip
HOUR = Case("an hour's log", seconds=HOUR_S, **WEAK_ONE)


def rows(cases: Sequence[Case] = CASES) -> Iterator[tuple[str, str, bool]]:
    """What goes wrong, what came of it, and whether that is right."""
    for case in cases:
        found = outcome(case)
        yield case.what, found.text, holds(case, found)


def survive(full: bool) -> Iterator[Line]:
    """Logs with something wrong with them: refused clearly, or the right cause; never another name nor a traceback"""
    print(f"  logs of {SECONDS:.0f} s, seeds {SEED} and {SEED + 1}; one thruster at {WEAK} where a cause is expected")
    for what, text, right in rows():
        yield exactly(what, right, 1, "", text)
    if full:
        found = outcome(HOUR)
        yield exactly(HOUR.what, holds(HOUR, found), 1, "", found.text)
        yield at_most(f"{HOUR.what}: process time", found.cpu_s / 60, MINUTES, "min")


PARTS = (survive,)
