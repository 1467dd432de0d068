"""Masking: groups of residual functions that a stochastic cause explains and that adequacy does not count beside it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from sim.fitting.diagnose.selection.candidate_score import DECISIVE_NATS

GUSTY_NATS = 24.0  # limit beside gusts: residuals of the many windows of one gust are correlated; assumed


@dataclass(frozen=True)
class Masking:
    """What stochastic causes mask.

    names       prefixes of the names of masked groups
    within      whether variation within a window is masked: groups are taken by their means over windows
    outliers    whether outlying fixes are masked
    limit       nats that a group must reach beside them
    """

    names: tuple[str, ...] = ()
    within: bool = False
    outliers: bool = False
    limit: float = DECISIVE_NATS

    @staticmethod
    def of(causes: Iterable[str]) -> Masking:
        """Masking by all of `causes` (names) together."""
        maskings = [MASKED_BY[name] for name in causes if name in MASKED_BY]
        names = tuple(name for masking in maskings for name in masking.names)
        limit = max((masking.limit for masking in maskings), default=DECISIVE_NATS)
        return Masking(names, any(e.within for e in maskings), any(e.outliers for e in maskings), limit)


NO_MASKING = Masking()
MASKED_BY = {
    "waves": Masking(("force, periodic",), within=True),
    "gusty_wind": Masking(("force, periodic", "force over time", "water over time", "force over position",
                          "pull over position", "place error over position", "force over speed"), limit=GUSTY_NATS),
    "nlos": Masking(("place error", "scale of places"), outliers=True),
}  # fmt: skip
"""By name of the cause. Gusts vary in time, and with it, by chance, over positions and speeds."""
