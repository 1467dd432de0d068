"""Which causes held-out readings support, one by one: nats presume that all else is right, predictions do not.

Asked where roll and pitch are not known: there a cause can fit what a boat that leans does to its accelerometers.
"""

from __future__ import annotations

from collections.abc import Callable

from sim.fitting.diagnose.posterior.fit import PosteriorFit
from sim.fitting.diagnose.selection.candidate_score import DECISIVE_NATS
from sim.fitting.diagnose.selection.greedy_selection import Selection, Selector
from sim.fitting.diagnose.selection.held_out import HeldOutScore, ModelUnderTest

JUDGED_S = 10
Score = Callable[[ModelUnderTest, ModelUnderTest], HeldOutScore]
"""Held-out score of two models, as `refit` and `extended`."""


def unsupported(fit: PosteriorFit, selection: Selection, score: Score) -> frozenset[str]:
    """Ids of causes of `selection` without which the rest, refitted, foretells held-out logs as well.

    That is: no reading is surely worse (95 %) up to `JUDGED_S` ahead, nor all, one step ahead, by `DECISIVE_NATS`. None
    where roll and pitch are known.
    """
    if fit.physics.levelled:
        return frozenset()
    whole = ModelUnderTest(selection.final.point.theta, selection.final.noise)
    out = set()
    for cause in selection.causes:
        rest = Selector(fit).without(selection, {cause.id}).final
        found = score(ModelUnderTest(rest.point.theta, rest.noise), whole)
        surely = any(e.gain_ci95[0] > 0 for e in found.errors if e.horizon_s <= JUDGED_S)
        if not surely and found.nats["extended"] - found.nats["refit"] < DECISIVE_NATS:
            out.add(cause.id)
    return frozenset(out)
