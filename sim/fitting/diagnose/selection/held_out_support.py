"""Which causes held-out readings support, one by one: nats presume that all else is right, predictions do not.

Asked where roll and pitch are not known: there a cause can fit what a boat that leans does to its accelerometers.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy

import numpy as np

from sim.fitting.diagnose.posterior.fit import PosteriorFit
from sim.fitting.diagnose.selection.candidate_score import DECISIVE_NATS
from sim.fitting.diagnose.selection.greedy_selection import Selection, Selector
from sim.fitting.diagnose.selection.held_out import JUDGED_S, HeldOutScore, ModelUnderTest
from sim.fitting.diagnose.selection.model import Refitter

LEAST_GAIN = 0.01
"""Least share of a reading's error that counts: one of ten is surely better by chance now and then; assumed."""
Score = Callable[[ModelUnderTest, ModelUnderTest], HeldOutScore]
"""Held-out score of two models, as `refit` and `extended`."""


def unsupported(fit: PosteriorFit, selection: Selection, score: Score) -> frozenset[str]:
    """Ids of causes of `selection` without which the rest, refitted, foretells held-out logs as well.

    That is: no reading up to `JUDGED_S` ahead is surely worse (95 %) and by `LEAST_GAIN`. A cause in a sensor may show
    one step ahead instead, by `DECISIVE_NATS`; what moves the boat must show in where it goes, for nats presume that
    the forces' noise is as modelled. None where roll and pitch are known.

    One at a time, the least needed first: beside a false cause others look needed.
    """
    if fit.physics.levelled:
        return frozenset()
    sensors = {e.id for e in fit.effects if e.family == "sensors"}
    left = selection
    while left.causes:
        whole = ModelUnderTest(left.final.point.theta, left.final.noise)
        found = {c.id: score(model_without(fit, left, c.id), whole) for c in left.causes}
        nats = {id_: one.nats["extended"] - one.nats["refit"] for id_, one in found.items()}
        needless = [
            id_ for id_, one in found.items() if not (_seen(one) or (id_ in sensors and nats[id_] >= DECISIVE_NATS))
        ]
        if not needless:
            break
        left = Selector(fit).without(left, {min(needless, key=nats.__getitem__)})
    return frozenset(c.id for c in selection.causes) - {c.id for c in left.causes}


def _seen(found: HeldOutScore) -> bool:
    near = (e for e in found.errors if e.horizon_s <= JUDGED_S)
    return any(e.gain_ci95[0] > 0 and e.gain >= LEAST_GAIN for e in near)


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
