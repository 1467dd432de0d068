"""What causes of chance leave behind: functions that say nothing new beside them, to whoever asks what is left over."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from sim.fitting.diagnose.selection.candidate_score import DECISIVE_NATS

GUSTY_NATS = 24.0  # one gust is felt in many windows, which count as so many: assumed


@dataclass(frozen=True)
class Masking:
    """What causes of chance leave behind, which says nothing new beside them.

    `names`: how the names of such groups begin; `within`: what varies within a window; `far_out`: fixes far out;
    `limit` [nats]: what a group must reach.
    """

    names: tuple[str, ...] = ()
    within: bool = False
    outliers: bool = False
    limit: float = DECISIVE_NATS

    @staticmethod
    def of(causes: Iterable[str]) -> Masking:
        """Of all `causes` (names) together."""
        every = [MASKED_BY[name] for name in causes if name in MASKED_BY]
        names = tuple(name for echo in every for name in echo.names)
        limit = max((echo.limit for echo in every), default=DECISIVE_NATS)
        return Masking(names, any(e.within for e in every), any(e.outliers for e in every), limit)


NO_MASKING = Masking()
MASKED_BY = {
    "waves": Masking(("force, periodic",), within=True),
    "gusty_wind": Masking(("force, periodic", "force over time", "water over time", "force over position",
                          "pull over position", "place error over position", "force over speed"), limit=GUSTY_NATS),
    "nlos": Masking(("place error", "scale of places"), outliers=True),
}  # fmt: skip
"""By cause. A boat that is blown about is pushed by other forces at other times, and so at other places and speeds."""
