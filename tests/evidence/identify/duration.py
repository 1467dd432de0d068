"""Evidence for identification: how long a fit takes, and scipy's least_squares beside it."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np

from sim.bench.scipy_fit import scipy_fit
from sim.fitting.engine.parameters import HULL, file_values
from sim.fitting.engine.smoothing import SmootherNoise
from sim.fitting.identify.result import fit_structured
from sim.fitting.taylor.pipeline import paper_samples
from sim.fitting.taylor.regression import least_squares
from sim.world.teleop_log import teleop_run
from tests.evidence.identify.paper import SAMPLES, SEED, known_boat, reference_vessel, training_run
from tests.evidence.line import Line, at_least, at_most, exactly, information

ROUNDS = 3
BENCH_S = 120.0
"""scipy with finite differences takes minutes for 13,840 samples: without --full both fit so much of a log."""


def timing(full: bool) -> Iterator[Line]:
    """Time for 13,840 samples, this machine as it is; scipy least_squares with finite differences in turn with ours"""
    vessel, train = reference_vessel(), training_run()
    file, settings = known_boat()
    told: list[float] = []
    took, cpu = [], []
    for _ in range(ROUNDS):
        told.clear()
        began = time.process_time()
        result = fit_structured([train], file, settings, say=lambda text, share: told.append(share))
        cpu.append(time.process_time() - began)
        took.append(result.seconds)
    yield at_most(f"structured fit, fastest of {ROUNDS}", min(took), 10.0, "s", _spread(took, cpu))
    yield at_least("reports of progress in a fit", len(told), result.iterations)
    samples = [paper_samples(train, vessel, SmootherNoise.of(vessel))]
    took, cpu = [], []
    for _ in range(5 * ROUNDS):
        began, began_cpu = time.perf_counter(), time.process_time()
        n = least_squares(samples).n
        took.append(time.perf_counter() - began)
        cpu.append(time.process_time() - began_cpu)
    yield exactly("samples of the regression", n, SAMPLES)
    yield at_most(f"regression, fastest of {5 * ROUNDS}", min(took), 0.5, "s", _spread(took, cpu))
    yield from _against_scipy(full)


def _against_scipy(full: bool) -> Iterator[Line]:
    """Both on the same log, in turn."""
    vessel = reference_vessel()
    run = training_run() if full else teleop_run(vessel, SEED, BENCH_S)
    seconds = run.table["t_s"].max()
    true = file_values(vessel)
    file, settings = known_boat()
    ours, theirs = [], []
    for _ in range(1 if full else ROUNDS):
        result = fit_structured([run], file, settings)
        peer = scipy_fit(run, file)
        ours.append(result.seconds)
        theirs.append(peer.seconds)
    n = len(HULL)
    errors = [100 * np.median(np.abs(q[:n] / true[:n] - 1)) for q in (result.q, peer.q)]
    ratios = np.array(theirs) / np.array(ours)
    note = (
        f"{seconds:.0f} s of log; ours {np.median(ours):.1f} s, scipy {np.median(theirs):.1f} s, {peer.simulations} "
        f"simulations, states of windows not free; median error of the hull {errors[0]:.2f} and {errors[1]:.2f} %"
    )
    yield information("scipy least_squares, 2-point, over ours: time", float(np.median(ratios)), "", note)


def _spread(took: list[float], cpu: list[float]) -> str:
    return f"median {np.median(took):.2f}, slowest {max(took):.2f}; processor {min(cpu):.2f} to {max(cpu):.2f} s"


PARTS = (timing,)
