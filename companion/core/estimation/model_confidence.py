"""Whether the ranges still bear out what the vessel file says of its model's error.

    g = max(0, g + min(d2, 9) - 1.5)      after each range or coordinate, d2 = nu^2 / S

d2 has a mean of 1 where filter and world agree. A cumulative sum (Page 1954) that reaches `doubt_limit` ends the trust,
until the filter starts afresh: from then on the latent force is as large as the filter's own tuning has it. Files
without `model_error` are never in doubt.
"""

from __future__ import annotations

from collections.abc import Iterable

from msgspec.structs import replace

from companion.core.estimation.filter_state import LATENT, FilterState
from companion.core.estimation.ranging.ranges import inflate
from companion.core.estimation.tuning import EstimatorTuning
from companion.core.messages import Innovation

MOST = 9.0
"""Three sigma: one wild range is not the model's fault; assumed."""
SLACK = 1.5
"""Errors half as large again in the mean square are let pass; assumed."""


def update_confidence(belief: FilterState, innovations: Iterable[Innovation], tuning: EstimatorTuning) -> FilterState:
    """The belief after its UWB innovations, in doubt or not."""
    if tuning.model_error is None or is_in_doubt(belief, tuning):
        return belief
    g = belief.doubt
    for innovation in innovations:
        g = max(0.0, g + min(innovation.d2, MOST) - SLACK)
    if g < tuning.doubt_limit:
        return replace(belief, doubt=g)
    P = belief.P
    for i, sigma in zip(range(LATENT.start, LATENT.stop), tuning.wary_latent_sigma, strict=True):
        P = inflate(P, (i,), sigma)
    return replace(belief, doubt=tuning.doubt_limit, P=P)


def is_in_doubt(belief: FilterState, tuning: EstimatorTuning) -> bool:
    """Whether the trust has ended."""
    return belief.doubt >= tuning.doubt_limit
