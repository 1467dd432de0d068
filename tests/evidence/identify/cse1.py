"""Evidence on C/S Enterprise I: what a fit of the recordings predicts where it has not looked. See docs/cse1.md."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from pathlib import Path

from companion.core.configuration.vessel_file import VesselFile
from companion.core.model.load_vessel import load_vessel
from companion.logs.runs.run import Run
from sim.fitting.identify.result import FitResult
from sim.fitting.validate.protocol import CHANNELS, UNITS
from sim.studies.cse1.study import (
    CRUDE,
    HORIZONS_S,
    RUNS,
    STRUCTURED,
    TAYLOR,
    TAYLOR_SAME,
    Errors,
    across,
    across_trimmed,
    blocks,
    recording,
)
from tests.evidence.line import Line, at_least, at_most, exactly, information

ROOT = Path(__file__).resolve().parents[3]
DATA = ROOT.parent / "shared" / "data" / "cse1"
FILE = ROOT / "deploy" / "boats" / "cse1.toml"
JUDGED_S = (10, 20)


def _absent() -> Iterator[Line]:
    yield information("left out: ../shared/data/cse1 beside the checkout is not here", float("nan"))


@cache
def _run(name: str) -> Run:
    return recording(DATA, name)


@cache
def _vessel() -> VesselFile:
    return load_vessel(FILE.read_text(), name=FILE.name)


@cache
def _from(train: str, *tests: str) -> tuple[tuple[Errors, ...], FitResult]:
    errors, found = across(_run(train), [_run(test) for test in tests], _vessel())
    return tuple(errors), found


def _table(errors: Errors) -> None:
    """RMS by model and horizon, as text."""
    print(f"  {errors.title}: rms errors, windows {', '.join(map(str, errors.count))}")
    print(f"  {'model':<32}{'after':>6}" + "".join(f"{f'{c} [{UNITS[c]}]':>16}" for c in CHANNELS))
    for model, rms in errors.rms.items():
        for horizon_s, row in zip(HORIZONS_S, rms, strict=True):
            print(f"  {model:<32}{horizon_s:>4} s" + "".join(f"{value:>16.3f}" for value in row))


def _against_baselines(errors: Errors, *, halve_surge: bool = False, judged: bool = True) -> Iterator[Line]:
    for horizon_s in JUDGED_S:
        for channel in CHANNELS:
            what = f"{channel} at {horizon_s} s: structured over the better baseline"
            best = (
                f"{errors.of(STRUCTURED, channel, horizon_s):.3f} over {errors.best_baseline(channel, horizon_s):.3f}"
            )
            goal = 0.5 if halve_surge and (channel, horizon_s) == ("u", 10) else 1.0
            figure = errors.ratio(STRUCTURED, channel, horizon_s)
            note = f"{best} {UNITS[channel]}"
            yield at_most(what, figure, goal, note=note) if judged else information(what, figure, note=note)


def _beaten(errors: Errors) -> int:
    """How many of the ten figures beat the better baseline."""
    return sum(errors.ratio(STRUCTURED, c, h) < 1 for c in CHANNELS for h in JUDGED_S)


def _rivals(errors: Errors) -> Iterator[Line]:
    for model in (CRUDE, TAYLOR, TAYLOR_SAME):
        lost = sum(errors.ratio(model, c, h) >= 1 for c in CHANNELS for h in JUDGED_S)
        yield information(f"{model}: figures of 10 that do not beat the baseline", lost)


def _fitted(found: FitResult) -> Iterator[Line]:
    note = f"{found.seconds:.0f} s"
    yield exactly("fit converged (1: yes)", found.converged, 1, note=note)
    yield at_most("steps of the fit", found.iterations, 40)


def cse1_blocks(full: bool) -> Iterator[Line]:
    """C/S Enterprise I, alternate 60 s blocks of random_run1: fitted on even ones, predicted on odd ones"""
    if not DATA.is_dir():
        yield from _absent()
        return
    errors, found = blocks(_run(RUNS[0]), _vessel())
    _table(errors)
    yield from _fitted(found)
    yield from _against_baselines(errors, halve_surge=True)
    yield from _rivals(errors)


def cse1_across_runs(full: bool) -> Iterator[Line]:
    """C/S Enterprise I, from one joystick run to the other: random_run1 to random_run3, and the other way round"""
    if not DATA.is_dir():
        yield from _absent()
        return
    for train, test in ((RUNS[0], RUNS[1]), (RUNS[1], RUNS[0])):
        (errors, *_), found = _from(train, test, RUNS[2])
        _table(errors)
        yield from _fitted(found)
        yield from _against_baselines(errors)
        yield from _rivals(errors)


def cse1_dptest(full: bool) -> Iterator[Line]:
    """C/S Enterprise I, station keeping (dptest): a third day at another setting, predicted from the joystick runs"""
    if not DATA.is_dir():
        yield from _absent()
        return
    for train, other in ((RUNS[0], RUNS[1]), (RUNS[1], RUNS[0])):
        (_, errors), found = _from(train, other, RUNS[2])
        _table(errors)
        yield at_least(f"from {train}: figures of 10 that beat the better baseline", _beaten(errors), 10)
        yield from _against_baselines(errors, judged=False)
        trimmed = across_trimmed(found, _run(RUNS[2]), _vessel())
        trimmed = Errors(f"{trimmed.title}, fitted on {train}, trims of the first third", trimmed.rms, trimmed.count)
        _table(trimmed)
        yield at_least(f"from {train}, trims of the day: figures of 10 that beat it", _beaten(trimmed), 10)
        yield from _against_baselines(trimmed, judged=False)


PARTS = (cse1_blocks, cse1_across_runs, cse1_dptest)
