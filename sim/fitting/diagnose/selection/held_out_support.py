"""Which causes held-out logs support, one by one: nats presume that all else is right, predictions do not.

Asked where roll and pitch are not known: there a cause can fit what a boat that leans does to its accelerometers. A
cause c is judged against the rest without it, refitted:

    readings        is some reading foretold better with c?
    plausibility    d = 1/2 |w / (k s)|^2 of the rest - the same with c     [nats]

w: what is within tolerance bands, s: their sigmas; k: `REAL_BANDS`. Twenty small faults together can do nearly all that
one cause does, and then foretell as well; that no boat has them is not a matter of these logs.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy

import numpy as np

from sim.fitting.diagnose.posterior.fit import PosteriorFit, stack_parameters
from sim.fitting.diagnose.report.findings import RIVAL_NATS
from sim.fitting.diagnose.selection.candidate_score import DECISIVE_NATS
from sim.fitting.diagnose.selection.greedy_selection import Selection, Selector
from sim.fitting.diagnose.selection.held_out import JUDGED_S, HeldOutScore
from sim.fitting.diagnose.selection.model import Refitter
from sim.fitting.diagnose.selection.smoothed_logs import ModelUnderTest

LEAST_GAIN = 0.01
"""Least share of a reading's error that counts: one of ten is surely better by chance now and then; assumed."""
REAL_BANDS = 2.0
"""Faults that boats have over tolerance bands, whose sigma is 2.5 % for a coefficient and 1.75 % for a thruster's gain:
uniform within 10 % and 6 % of a vessel file has a sigma of 5.8 % and 3.5 %; assumed."""
Score = Callable[[ModelUnderTest, ModelUnderTest], HeldOutScore]
"""Held-out score of two models, as `refit` and `extended`."""


def unsupported(fit: PosteriorFit, selection: Selection, score: Score) -> frozenset[str]:
    """Ids of causes of `selection` without which the rest, refitted, foretells held-out logs as well.

    One at a time, the least needed first: beside a false cause others look needed. None where roll and pitch are known.
    """
    if fit.physics.levelled:
        return frozenset()
    sensors = {e.id for e in fit.effects if e.family == "sensors"}
    left = selection
    while left.causes:
        whole = ModelUnderTest(left.final.point.theta, left.final.noise)
        rests = {c.id: model_without(fit, left, c.id) for c in left.causes}
        found = {id_: score(rest, whole) for id_, rest in rests.items()}
        needless = [id_ for id_, one in found.items()
                    if not is_needed(one, id_ in sensors, implausibility(fit, left, rests[id_], whole))]  # fmt: skip
        if not needless:
            break
        left = Selector(fit).without(left, {min(needless, key=lambda id_: _nats(found[id_]))})
    return frozenset(c.id for c in selection.causes) - {c.id for c in left.causes}


def is_needed(found: HeldOutScore, of_sensor: bool, implausible_nats: float) -> bool:
    """Whether the rest of the causes does not do without this one; `found`: of the rest, and of both.

    1. Not needed if the logs are less likely with it, by `DECISIVE_NATS` one step ahead: better readings may be chance
       then.
    2. Needed if some reading up to `JUDGED_S` ahead is surely better (95 %), and by `LEAST_GAIN`.
    3. Needed if it is a sensor's, and `DECISIVE_NATS` better one step ahead; what moves the boat must show in where it
       goes, for nats presume that the forces' noise is as modelled.
    4. Needed if the rest is less plausible by `RIVAL_NATS`.
    """
    near = [e for e in found.errors if e.horizon_s <= JUDGED_S]
    nats = _nats(found)
    if nats < -DECISIVE_NATS:
        return False
    seen = any(e.gain_ci95[0] > 0 and e.gain >= LEAST_GAIN for e in near)
    return seen or (of_sensor and nats >= DECISIVE_NATS) or implausible_nats >= RIVAL_NATS


def _nats(found: HeldOutScore) -> float:
    return found.nats["extended"] - found.nats["refit"]


def implausibility(fit: PosteriorFit, selection: Selection, rest: ModelUnderTest, whole: ModelUnderTest) -> float:
    """d of the module [nats]: how much less plausible the small faults of `rest` are than those of `whole`."""
    causes = {c.id for c in selection.causes}
    small = [e for e in fit.effects if e.always_free and e.id not in causes]
    prior = fit.prior(small, frozenset())
    apart = prior.cost(stack_parameters(rest.theta, small)) - prior.cost(stack_parameters(whole.theta, small))
    return apart / REAL_BANDS**2


def model_without(fit: PosteriorFit, selection: Selection, gone: str) -> ModelUnderTest:
    """The model of `selection` refitted with the effect `gone` (id) held at zero.

    Within its tolerance band a large one would stay nearly as large: many data outweigh the prior.
    """
    effect = next(e for e in fit.effects if e.id == gone)
    zero = {gone: np.zeros(len(effect.parameters))} if effect.always_free else {}
    kept = frozenset(c.id for c in selection.causes) - {gone}
    held = copy(fit)  # with the degrees of freedom that the fit has counted
    held.effects = tuple(e.held_at_zero() if e is effect else e for e in fit.effects)
    rest = Refitter(held).refit(selection.final, kept, zero)
    return ModelUnderTest(rest.point.theta, rest.noise)
