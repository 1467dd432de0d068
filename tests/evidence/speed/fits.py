"""Evidence for the speed of the structured fit: 13,840 samples, and scipy's least_squares on the same problem."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from sim.fitting.identify.result import FitResult, fit_structured
from sim.fitting.identify.structured_fit import FitPoint, FitSettings, StructuredFit, solve
from sim.studies.peers.casadi_fit import CasadiFit, PlainFit, casadi_fit, plain_fit
from sim.studies.peers.casadi_problem import CasadiProblem
from tests.evidence.identify.paper import known_boat, training_run
from tests.evidence.line import Line, at_least, at_most, information

ROUNDS, FULL_ROUNDS = 2, 5
BETWEEN = 3
"""Fits of ours before each of scipy's, and after the last."""
PLAIN_S = 60.0
"""Processor time after which a plain call of scipy is given up."""
SAME_NATS, SAME_SIGMAS = 0.1, 0.2


def fit_13840(full: bool) -> Iterator[Line]:
    """Structured fit of 13,840 samples (1384 s), and scipy with CasADi Jacobians on the same problem, in turn"""
    (file, settings), train = known_boat(), training_run()
    wall, cpu, peers = [], [], []
    found = fit_structured([train], file, settings)
    fit, point = _settled(found.window_s, settings)
    problem = CasadiProblem(fit.windows, fit.parameters, fit.noise)
    every, _ = _settled(found.window_s, replace(settings, inertial_hz=np.inf))
    whole = CasadiProblem(every.windows, every.parameters, every.noise)

    def ours() -> None:
        for _ in range(BETWEEN):
            began, began_cpu = time.perf_counter(), time.process_time()
            fit_structured([train], file, settings)
            wall.append(time.perf_counter() - began)
            cpu.append(time.process_time() - began_cpu)

    for _ in range(FULL_ROUNDS if full else ROUNDS):
        ours()
        peers.append(casadi_fit(problem))
    ours()
    plain = plain_fit(problem, PLAIN_S)
    ours()
    as_logged = casadi_fit(whole)
    ours()
    note = f"median {np.median(wall):.2f} s; processor {min(cpu):.2f} s, median {np.median(cpu):.2f} s"
    yield at_most(f"structured fit of 13,840 samples, fastest of {len(wall)}", min(wall), 0.5, "s", note)
    yield from _same(fit, point, found, peers[-1])
    yield from _ratios(peers, plain, as_logged.processor_s, float(np.median(cpu)), peers[-1].cost)
    yield information("  samples of the log, none averaged", every.windows.samples())


def _ratios(
    peers: list[CasadiFit], plain: PlainFit, as_logged_s: float, ours_s: float, optimum: float
) -> Iterator[Line]:
    """Processor time of scipy's calls over the median of ours."""
    best = min(peer.processor_s for peer in peers)
    end = "ended" if plain.ended else "given up, not ended"
    note = (
        f"{end} after {plain.processor_s:.0f} s, {plain.residuals} residuals, {plain.cost - optimum:.2g} nats too high"
    )
    yield at_least("over scipy least_squares with CasADi Jacobians", plain.processor_s / ours_s, 20, "", note)
    note = f"whitened, steps and ties by our own ideas: casadi_fit.py; {peers[0].jacobians} Jacobians, {best:.1f} s"
    yield information(f"  over the same as well as we could help it, fastest of {len(peers)}", best / ours_s, "", note)
    note = f"{as_logged_s:.1f} s"
    yield information("  over that on every sample of the log", as_logged_s / ours_s, "", note)


def _settled(window_s: float, settings: FitSettings) -> tuple[StructuredFit, FitPoint]:
    """The same fit, then steps under its last noise until none promises anything."""
    fit = StructuredFit([training_run()], known_boat()[0], replace(settings, window_s=window_s))
    point, _ = solve(fit)
    fit.settings = replace(fit.settings, tolerance_nats=1e-3)
    for _ in range(20):
        after, _ = fit.step(point)
        if after is point:
            break
        point = after
    return fit, point


def _same(fit: StructuredFit, point: FitPoint, found: FitResult, peer: CasadiFit) -> Iterator[Line]:
    """Both at one optimum: else no comparison of times means anything."""
    chain, cost, _ = fit.assemble(point, fit.noise)
    se = np.sqrt(np.diag(np.linalg.inv(chain.solve()[2])))
    off = np.abs(peer.w - point.w) / se
    note = f"{cost:.1f} nats, {len(peer.w)} parameters and {peer.z.size} unknowns of {len(peer.z)} nodes"
    yield at_most("cost where scipy ends, above ours", peer.cost - cost, SAME_NATS, "nats", note)
    yield at_most("largest difference of a parameter", off.max(), SAME_SIGMAS, "s.e.", f"median {np.median(off):.2g}")
    at = fit.parameters.file_units(point.w)
    errors = np.abs(found.q - at) / [p.se for p in found.parameters]
    note = f"median {np.median(errors):.2g}"
    yield at_most("the timed fit from that optimum", errors.max(), SAME_SIGMAS, "s.e.", note)


PARTS = (fit_13840,)
