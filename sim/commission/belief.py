"""What is known of a boat: the vessel file by all logs so far, how well, and how carefully it may be flown by it.

    logs -> signs and sides -> structured fit -> belief

Priors are those of a file that nobody measured: hull 50 %, gains 30 %, places of the sensors 0.3 m, compass 0.2 rad
and 0.1 rad by how the boat is turned.
Current and wind are fitted beside the boat and forgotten afterwards: they belong to the day.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from dataclasses import replace as replaced

import numpy as np
from msgspec.structs import replace

from companion.core.configuration.vessel_file import VesselFile
from companion.logs.runs.run import Run
from sim.commission.rivals import settled
from sim.fitting.engine.free_parameters import ADVANCE_LOSS
from sim.fitting.engine.split import NamedLog
from sim.fitting.engine.windows import StructuredFitError
from sim.fitting.excite.information import Knowledge
from sim.fitting.identify.refinements import with_advance_loss
from sim.fitting.identify.result import FitResult, fit_structured
from sim.fitting.identify.structured_fit import UNMEASURED
from sim.fitting.identify.vessel_out import identified_vessel
from sim.fitting.wiring.check import Checked, checked
from sim.fitting.wiring.levelling import levelled
from sim.fitting.wiring.record import WiringReport

CARE = (1.5, 2.5)
"""Least and largest caution: of a boat whose file is right, and of one 50 % heavier with thrusters 40 % weaker."""
SIGMAS = 5.0
"""An advance loss of fewer is none; assumed: with three, logs of pulses alone show one that is not there."""
MOST_FAULTS = 3
"""So often logs are asked again after something was put right; assumed: what is still found then comes and goes."""


@dataclass(frozen=True)
class BoatBelief:
    """What is believed.

    first    the file that commissioning began with, thrusters as they are connected: the prior of all fits
    vessel   the file by all logs
    known    how well its parameters are known
    wiring   what was found of signs and sides
    fit      the last fit; None before the first
    model    what was fitted: `first`, or that with an advance loss to look for
    problem  why a fit was not possible
    logs     what it was learnt from, with columns put right
    """

    first: VesselFile
    vessel: VesselFile
    known: Knowledge
    wiring: WiringReport = field(default_factory=WiringReport)
    fit: FitResult | None = None
    model: VesselFile | None = None
    problem: str = ""
    logs: tuple[NamedLog, ...] = ()

    @classmethod
    def beginning(cls, first: VesselFile) -> BoatBelief:
        """Before any log."""
        return cls(first, first, Knowledge.prior(first, UNMEASURED))

    @property
    def caution(self) -> float:
        """How many times heavier or weaker than the file the boat may be: e^(2 sigma) of acceleration by thrust."""
        names = self.known.parameters.names
        n = len(self.first.thrusters)
        worst = 0.0
        for inertia in ("M11_kg", "M22_kg", "M33_kg_m2"):
            by = np.zeros(len(names))
            by[names.index(inertia)] = 1.0
            by[self.known.parameters.thrusters] = -1.0 / n
            worst = max(worst, float(by @ self.known.covariance @ by))
        return float(np.clip(np.exp(2 * np.sqrt(worst)), *CARE))

    @property
    def signs_known(self) -> bool:
        """Whether every single wiring fault has been ruled out, beside those that have been put right.

        What a finding has `advice` for (the compass) is no matter of signs.
        """
        doubtful = any((not one.certain or one.rivals) and not one.advice for one in self.wiring.findings)
        judged = self.wiring.logs not in (None, 0)
        return judged and not self.wiring.unknown and not doubtful and not self.astray

    @property
    def astray(self) -> str:
        """What is certainly wrong with heading or positions, in words, empty: nothing.

        Logs are put right, the boat is not: it would drive home the wrong way.
        """
        found = (one for one in self.wiring.findings if one.certain and one.nats is not None)
        return "; ".join(one.text for one in found if not one.thrusters and not one.advice)


def learned(
    first: VesselFile, logs: Sequence[NamedLog], date: str, say: Callable[[str], None] = lambda _text: None
) -> BoatBelief:
    """The belief by `first`, as it was given, and all logs. `date`: for the file's `source` keys."""
    say("signs and sides")
    found = settled(signs_checked(logs, first), say)
    logs = levelled(found.logs)
    begun = replaced(BoatBelief.beginning(found.vessel), wiring=found.wiring, logs=logs)
    say("fit")
    try:
        model, fit = fitted(found.vessel, [log.run for log in logs])
    except StructuredFitError as error:
        return replaced(begun, problem=str(error))
    vessel = identified_vessel(model, fit, date=date)
    return replaced(begun, vessel=vessel, known=knowledge_of(model, vessel, fit), fit=fit, model=model)


def fitted(vessel: VesselFile, runs: Sequence[Run]) -> tuple[VesselFile, FitResult]:
    """The model that was fitted, with an advance loss where the runs show one, and its fit.

    Every propeller has it, and where a fit does not know it hull, lever arms and current take its place.
    """
    lossy = with_advance_loss(vessel)
    fit = fit_structured(runs, lossy, UNMEASURED)
    loss = fit[ADVANCE_LOSS.name]
    if lossy == vessel or loss.value > SIGMAS * loss.se:
        return lossy, fit
    return vessel, fit_structured(runs, vessel, UNMEASURED)


def signs_checked(logs: Sequence[NamedLog], first: VesselFile) -> Checked:
    """Logs and vessel with what is wrong put right, and asked again: beside one fault there may be another.

    What is still found after `MOST_FAULTS` is told and not certain.
    """
    found = checked(logs, (), first)
    told = {finding.name: finding for finding in found.wiring.findings}
    for _ in range(MOST_FAULTS):
        if not found.wiring.corrected:
            break
        found = checked(found.logs, (), found.vessel)
        told |= {finding.name: finding for finding in found.wiring.findings}
    told |= {finding.name: replace(finding, certain=False) for finding in found.wiring.corrected}
    return replaced(found, wiring=replace(found.wiring, findings=tuple(told.values())))


def knowledge_of(first: VesselFile, vessel: VesselFile, fit: FitResult) -> Knowledge:
    """Knowledge by a fit of `first`, about the fitted `vessel`: C_w = T^-1 C_q T^-T."""
    parameters = UNMEASURED.parameters(first)
    w = parameters.unconstrained(np.array([fit[name].value for name in parameters.names]))
    T = parameters.jacobian(w)
    precision = T.T @ np.linalg.inv(np.array(fit.covariance)) @ T
    return Knowledge(vessel, (precision + precision.T) / 2, w, UNMEASURED)
