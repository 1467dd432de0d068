"""A test of the vessel file's `model_error` on the innovations of UWB: a one-sided CUSUM of d2.

    g = max(0, g + min(d2, 9) - 1.5)      after each range or coordinate, d2 = nu^2 / S

d2 has a mean of 1 where the filter is consistent. A cumulative sum (Page 1954) that reaches `doubt_limit` rejects the
file's `model_error` until the filter restarts: the latent force takes the sigma of `wary_latent_sigma`. Files without
`model_error` are not tested.
"""

from __future__ import annotations

from collections.abc import Iterable

from msgspec.structs import replace

from companion.core.estimation.filter_state import LATENT_INDICES, FilterState
from companion.core.estimation.ranging.ranges import inflate
from companion.core.estimation.tuning import EstimatorTuning
from companion.core.messages import Innovation

MOST = 9.0
"""Three sigma: an outlier does not count against the model; assumed."""
SLACK = 1.5
"""Drift of the sum: a mean square 1.5 times the predicted one is tolerated; assumed."""


def update_confidence(belief: FilterState, innovations: Iterable[Innovation], tuning: EstimatorTuning) -> FilterState:
    """The filter state with the sum after UWB innovations; P grows where it reaches the limit."""
    if tuning.model_error is None or is_in_doubt(belief, tuning):
        return belief
    g = belief.doubt
    for innovation in innovations:
        g = max(0.0, g + min(innovation.d2, MOST) - SLACK)
    if g < tuning.doubt_limit:
        return replace(belief, doubt=g)
    P = inflate(belief.P, LATENT_INDICES, tuning.wary_latent_sigma)
    return replace(belief, doubt=tuning.doubt_limit, P=P)


def is_in_doubt(belief: FilterState, tuning: EstimatorTuning) -> bool:
    """Whether the file's `model_error` was rejected."""
    return belief.doubt >= tuning.doubt_limit
