"""Wiring faults that positions and heading leave open, told apart by fits: only one of them makes a boat that can be.

    nats of a way = log p(all data | thrusters connected so), of a fit of hull, gains and sensors to each (Laplace)

Front and rear of one side of an X boat with changed places differ in nothing but which way the boat is pushed aside:
centimetres of a position that is known to decimetres, but several sigmas of an accelerometer at every pulse. The check
itself (`sim.fitting.wiring`) asks no accelerometer, for it may be mounted otherwise than the file says. So the best is
believed only where its fit explains all sensors down to their noise, which no fit does that has the IMU wrong.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace as replaced

import numpy as np
from msgspec.structs import replace

from companion.core.configuration.vessel_file import VesselFile
from companion.logs.runs.run import Run
from sim.fitting.engine.windows import StructuredFitError
from sim.fitting.identify.structured_fit import UNMEASURED, FitPoint, StructuredFit, solve
from sim.fitting.wiring.check import Checked, noted
from sim.fitting.wiring.record import WiringFinding
from sim.fitting.wiring.thrusters import Way, ways

CLEAR_NATS = 30.0
"""Of the best over the next; assumed: five times what the check itself takes for sure, for a fit believes its model."""
MOST_NOISE = 2.0
"""White noise that is left in a sensor over what the file states, at most; assumed."""
MOST = 8
"""Ways that are fitted at most, a few seconds each; assumed: where more are open, another flight tells more."""


def settled(found: Checked, say: Callable[[str], None] = lambda _text: None) -> Checked:
    """`found` with what is open among thrusters decided by fits, where they decide it; else as it is."""
    if any(f.certain and f.rivals for f in found.wiring.findings):
        return found  # the vessel has it put right already, and its rivals are those of the file before
    doubtful = [f for f in found.wiring.findings if not f.advice and not f.certain]
    texts = {*found.wiring.unknown, *(text for f in doubtful for text in (f.text, *f.rivals))}
    open_ways = [way for way in ways(found.vessel) if not way.text or way.text in texts]
    if not texts or len(open_ways) > MOST or texts - {way.text for way in open_ways}:
        return found  # nothing is open, or more than thrusters
    best = _clearly_best(open_ways, [log.run for log in found.logs], say)
    if best is None:
        return found
    way, nats = best
    findings = [f for f in found.wiring.findings if f not in doubtful]
    if way.faults:
        logs = tuple(log.name for log in found.logs)
        nats = round(nats, 1)
        findings.append(WiringFinding(name=way.name, text=way.text, nats=nats, logs=logs, certain=True, thrusters=True))
    wiring = replace(found.wiring, findings=tuple(findings), unknown=())
    return replaced(found, vessel=noted(way.vessel, found.vessel), wiring=wiring)


def _clearly_best(
    open_ways: Sequence[Way], runs: Sequence[Run], say: Callable[[str], None]
) -> tuple[Way, float] | None:
    """The way that is clearly best and explains every sensor, and its nats over the next; None: there is none."""
    tried = []
    for way in open_ways:
        say(f"signs and sides: {way.text or 'as the file says'}?")
        nats, sound = _judged(runs, way.vessel)
        tried.append((nats, sound, way))
    (nats, sound, way), (behind, *_), *_ = sorted(tried, key=lambda one: -one[0])
    return (way, nats - behind) if sound and nats - behind > CLEAR_NATS else None


def _judged(runs: Sequence[Run], vessel: VesselFile) -> tuple[float, bool]:
    """Log evidence of a fit of `vessel` [nats], its white noise counted, and whether it explains every sensor."""
    try:
        fit = StructuredFit(runs, vessel, UNMEASURED)
        point, iterations = solve(fit)
        nats = _evidence(fit, point)
    except (StructuredFitError, np.linalg.LinAlgError):
        return -np.inf, False
    sigmas = (*fit.noise.white, fit.noise.fix_m), (*fit.stated.white, fit.stated.fix_m)
    explained = all(found <= MOST_NOISE * stated for found, stated in zip(*sigmas, strict=True))
    return nats, explained and iterations < UNMEASURED.iterations


def _evidence(fit: StructuredFit, point: FitPoint) -> float:
    """Log evidence: that of `StructuredFit`, which counts residuals in sigmas, less the sigmas' own logarithms."""
    counts = np.isfinite(fit.windows.y).sum(axis=(0, 1))
    sigmas = float(counts @ np.log(fit.noise.white)) + 2 * len(fit.windows.fixes.t_s) * np.log(fit.noise.fix_m)
    return float(fit.evidence(point, fit.noise) - sigmas)
