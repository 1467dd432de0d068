"""Evidence that faults are noticed: the list of the design, random single faults and pairs, judged by truth."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from tests.evidence.line import Line, at_least, at_most, exactly, information
from tests.evidence.processes import processes
from tests.fault_lab.draw import draw, push
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
RANDOM_SEED, PAIR_SEED, PUSH_SEED = 10_000, 20_000, 40_000
LATE_S = 8.0
Case = tuple[int, tuple[Fault, ...]]
Trial = tuple[Verdict, Case]


def noticed(full: bool) -> Iterator[Line]:
    """The design's list, seed 1, 40 single faults and 14 pairs at random (--full: ten seeds, 300, 100), as one"""
    sets: dict[str, list[Case]] = {
        "listed": [(seed, (parse(line),)) for line in LISTED for seed in (range(1, 11) if full else (1,))],
        "random": [(seed, (draw(seed),)) for seed in range(RANDOM_SEED, RANDOM_SEED + (300 if full else 40))],
        "pairs": [(s, (draw(s), draw(s + 500))) for s in range(PAIR_SEED, PAIR_SEED + (100 if full else 14))],
    }
    trials: list[Trial] = []
    with processes() as pool:
        for name, cases in sets.items():
            of_set = list(zip(pool.map(_drive, cases), cases, strict=True))
            _tell(of_set)
            for f in _figures(of_set):
                if f.text.startswith("FAILED"):  # of each set, lest one hides behind the others
                    yield f.judge(f"{name}: {f.text}", f.value, f.goal, f.unit, f.note)
                else:
                    yield information(f"{name}: {f.text}", f.value, f.unit, f.note)
            trials += of_set
    for figure in _figures(trials):
        yield figure.judge(figure.text, figure.value, figure.goal, figure.unit, figure.note)


def pushed(full: bool) -> Iterator[Line]:
    """Something pushes the boat with 10 to 40 N for 2 to 60 s: 24 (--full: 100)"""
    seeds = range(PUSH_SEED, PUSH_SEED + (100 if full else 24))
    with processes() as pool:
        verdicts = list(pool.map(_drive, [(seed, (push(seed),)) for seed in seeds]))
    for v in verdicts:
        _tell_failure(v)
    accused = [v for v in verdicts if any(cause == "thruster" for _, cause, _ in v.named)]
    for v in accused:
        print(f"  a thruster is named: seed {v.seed}, {v.faults[0]}: {v.named[0]}")
    count = f"{len(accused)} of {len(verdicts)}"
    yield at_most("a thruster is named", 100 * len(accused) / len(verdicts), 3.0, "%", count)
    yield at_most("FAILED", 100 * sum(v.failed for v in verdicts) / len(verdicts), 2.0, "%")
    stopped = sum(v.mode == "safe" for v in verdicts)
    yield information("ends in neutral", 100 * stopped / len(verdicts), "%")


def _drive(case: Case) -> Verdict:
    return trial(case[0], *case[1])


def _tell(trials: Sequence[Trial]) -> None:
    """Those that failed, and those that were told late."""
    for v, case in trials:
        _tell_failure(v)
        if not v.failed and v.wrong_m > MOVED_M and (delay_s := _delay_s(v, case)) > LATE_S:
            print(
                f"  late: seed {v.seed}, {'; '.join(v.faults)}: told after {delay_s:.1f} s, wrong by {v.wrong_m:.1f} m"
            )


def _tell_failure(v: Verdict) -> None:
    """One that failed."""
    if v.failed:
        print(
            f"  failed: seed {v.seed}, {'; '.join(v.faults)}: healthy and wrong {v.healthy_wrong_s:.1f} s, beyond"
            f" the fence {v.beyond_s:.1f} s, high thrust {v.high_s:.1f} s, ends in {v.mode}"
        )


class Figure(NamedTuple):
    """One figure of a set of trials, and what is asked of it where all sets are one."""

    text: str
    value: float
    judge: Callable[..., Line]
    goal: float
    unit: str = ""
    note: str = ""


def _figures(trials: Sequence[Trial]) -> Iterator[Figure]:
    """How many failed; from fault to alert, of those that moved; what was named."""
    failed = [(v, c) for v, c in trials if v.failed]
    yield Figure("FAILED", 100 * len(failed) / len(trials), at_most, 2.0, "%", f"{len(failed)} of {len(trials)}")
    yield Figure("FAILED without an alert", sum(math.isinf(_alerted_s(v, c)) for v, c in failed), exactly, 0)
    if moved := [(v, c) for v, c in trials if v.wrong_m > MOVED_M]:
        delays = [_delay_s(v, c) for v, c in moved]
        literal = [_alerted_s(v, c) for v, c in moved]
        middle, most = np.percentile(literal, (50, 95))
        note = f"of {len(delays)}; since the first fault began, driving or not: {middle:.1f} s, 95 % {most:.1f} s"
        yield Figure("from fault to alert, median", np.median(delays), at_most, 2.0, "s", note)
        yield Figure("from fault to alert, 95 %", np.percentile(delays, 95), at_most, LATE_S, "s")
    yield from _names([(v, c[0]) for v, (_, c) in trials if len(c) == 1])


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


def _names(trials: Sequence[tuple[Verdict, Fault]]) -> Iterator[Figure]:
    """Kind, and which one, of single faults that were named."""
    named = [(v.named[0], fault) for v, fault in trials if v.named and fault.family in ("sensor", "thruster")]
    right = [_is_right(found[2], fault) for found, fault in named if found[1] == fault.family]
    if not named:
        return
    note = f"of {len(named)} named, of {len(trials)}"
    yield Figure("right kind named", 100 * len(right) / len(named), at_least, 90.0, "%", note)
    if right:
        yield Figure("right sensor or thruster", 100 * float(np.mean(right)), at_least, 80.0, "%", f"of {len(right)}")
    wrong = sum(
        found[1] == "thruster" and not (f.family == "thruster" and _is_right(found[2], f)) for found, f in named
    )
    yield Figure("wrong thruster", 100 * wrong / len(named), at_most, 3.0, "%")


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
        of_it = fault.target == "thruster" and what == THRUSTERS[fault.number - 1]
        return of_it or what in (fault.kind.removesuffix("ped"), fault.kind)
    return what in SENSORS[fault.target]


PARTS = (noticed, pushed)
