"""Evidence that faults are noticed: the list of the design, random single faults and pairs, judged by truth."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor

import numpy as np

from tests.evidence.line import Line, at_least, at_most, exactly, information
from tests.fault_lab.draw import draw
from tests.fault_lab.fault import Fault, parse
from tests.fault_lab.trial import MOVED_M, Verdict, trial
from tests.support.drive_fixture import setup

LISTED = (
    "uwb frozen from 40", "uwb frozen from 40 to 50", "thruster 2 reversed from 30", "thruster 2 stuck 1900 from 30",
    "thruster 1 swapped 2 from 30", "thruster 1 swapped 4 from 30", "thrusters reversed from 0",
    "accel noise 0.5 from 30", "heading offset 60 from 0", "heading offset 90 from 40", "heading drift 2 from 40",
    "gyro stuck from 40", "gyro flipped from 30", "uwb mirrored from 0", "uwb rotated 90 from 0",
    "uwb rotated 180 from 0", "uwb noise 1 from 30", "uwb scale 1.1 from 0",
)  # fmt: skip
RANDOM_SEED, PAIR_SEED = 10_000, 20_000
LATE_S = 8.0
Case = tuple[int, tuple[Fault, ...]]


def listed(full: bool) -> Iterator[Line]:
    """The design's list, seed 1 (--full: ten seeds)"""
    seeds = range(1, 11) if full else (1,)
    yield from _lines("listed", [(seed, (parse(line),)) for line in LISTED for seed in seeds])


def single(full: bool) -> Iterator[Line]:
    """Single faults drawn at random: 40 (--full: 300)"""
    seeds = range(RANDOM_SEED, RANDOM_SEED + (300 if full else 40))
    yield from _lines("random", [(seed, (draw(seed),)) for seed in seeds])


def pairs(full: bool) -> Iterator[Line]:
    """Pairs of faults drawn at random: 14 (--full: 100)"""
    seeds = range(PAIR_SEED, PAIR_SEED + (100 if full else 14))
    yield from _lines("pairs", [(seed, (draw(seed), draw(seed + 500))) for seed in seeds])


def _drive(case: Case) -> Verdict:
    return trial(case[0], *case[1])


def _lines(name: str, cases: Sequence[Case]) -> Iterator[Line]:
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        verdicts = list(pool.map(_drive, cases))
    failed = [v for v in verdicts if v.failed]
    for v in failed:
        print(
            f"  failed: seed {v.seed}, {'; '.join(v.faults)}: healthy and wrong {v.healthy_wrong_s:.1f} s, beyond the"
            f" fence {v.beyond_s:.1f} s, high thrust {v.high_s:.1f} s, ends in {v.mode}"
        )
    yield at_most(f"{name}: FAILED", 100 * len(failed) / len(cases), 2.0, "%", f"{len(failed)} of {len(cases)}")
    silent = sum(v.failed and math.isinf(_alerted_s(v, c)) for v, c in zip(verdicts, cases, strict=True))
    yield exactly(f"{name}: FAILED without an alert", silent, 0)
    moved = [(v, c) for v, c in zip(verdicts, cases, strict=True) if v.wrong_m > MOVED_M]
    for v, case in moved:
        if (delay_s := _delay_s(v, case)) > LATE_S:
            print(
                f"  late: seed {v.seed}, {'; '.join(v.faults)}: told after {delay_s:.1f} s, wrong by {v.wrong_m:.1f} m"
            )
    if moved:
        delays, literal = [_delay_s(v, c) for v, c in moved], [_alerted_s(v, c) for v, c in moved]
        yield at_most(f"{name}: from fault to alert, median", float(np.median(delays)), 2.0, "s", f"of {len(delays)}")
        yield at_most(f"{name}: from fault to alert, 95 %", float(np.percentile(delays, 95)), LATE_S, "s")
        since_any = f"{name}: since the first fault began, driving or not: median, 95 %"
        yield information(since_any, float(np.median(literal)), "s", f"{np.percentile(literal, 95):.1f} s")
    if all(len(faults) == 1 for _, faults in cases):
        yield from _names(name, verdicts, [faults[0] for _, faults in cases])


def _alerted_s(verdict: Verdict, case: Case) -> float:
    """Seconds from the beginning of the first fault to the first alert after it."""
    return verdict.first_alert_s(min(f.from_s for f in case[1]))


def _delay_s(verdict: Verdict, case: Case) -> float:
    """Seconds to the alert since a fault could move the boat: since it began, of two the later one that had begun by
    the time the estimate was wrong, and since the boat was allowed to drive: at rest nothing contradicts anything.
    """
    first = min(f.from_s for f in case[1])
    began = max((f.from_s for f in case[1] if f.from_s <= verdict.moved_s), default=first)
    drives = verdict.drives_s if math.isfinite(verdict.drives_s) else 0.0
    return max(0.0, first + verdict.first_alert_s(first) - max(began, drives))


def _names(name: str, verdicts: Sequence[Verdict], faults: Sequence[Fault]) -> Iterator[Line]:
    """Kind, and which one, of those that were named."""
    named = [
        (v.named[0], f) for v, f in zip(verdicts, faults, strict=True) if v.named and f.family in ("sensor", "thruster")
    ]
    if not named:
        return
    kind = [found[1] == fault.family for found, fault in named]
    yield at_least(f"{name}: right kind named", 100 * float(np.mean(kind)), 90.0, "%", f"of {len(named)} named")
    right = [_is_right(found[2], fault) for found, fault in named if found[1] == fault.family]
    if right:
        yield at_least(f"{name}: right sensor or thruster", 100 * float(np.mean(right)), 80.0, "%", f"of {len(right)}")
    wrong = sum(
        found[1] == "thruster" and not (f.family == "thruster" and _is_right(found[2], f)) for found, f in named
    )
    yield at_most(f"{name}: wrong thruster", 100 * wrong / len(named), 3.0, "%")
    yield information(f"{name}: named at all", 100 * len(named) / len(verdicts), "%")


THRUSTERS = tuple(t.name for t in setup(None).pilot.vessel.thrusters)
SENSORS = {
    "uwb": ("position",),
    "anchor": ("position",),
    "heading": ("heading", "position"),  # they contradict each other in both
    "gyro": ("gyro",),
    "accel": ("accel",),
    "imu": ("imu", "gyro", "accel"),  # both are stuck
}


def _is_right(what: str, fault: Fault) -> bool:
    """Whether a name is that of the fault."""
    if fault.family == "thruster":
        return what in (fault.kind.removesuffix("ped"), fault.kind) or what == THRUSTERS[fault.number - 1]
    return what in SENSORS[fault.target]


PARTS = (listed, single, pairs)
