"""The force of a thruster that is known to stick, by all that has come since it was named.

A verdict comes within seconds, by speeds of a filter that reckoned without the thruster: its force may be a third off
then. Every hypothesis of the bank goes on estimating it; the estimate counts where it surely is another force, and one
that makes a difference.
"""

from __future__ import annotations

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.core.pilot.trust.thrusters.hypothesis_bank import BankState
from companion.core.pilot.trust.thrusters.remaining_thrust import ThrusterHealth

SURE_SIGMAS = 2.0
"""By so many sigmas another force must differ from the one that was believed; assumed: 1 in 20 by chance."""
NO_FORCE_SHARE = 0.08
"""Less than this share of a thruster's limit is as good as no force; assumed."""


def another_force(bank: BankState, health: ThrusterHealth, vessel: VesselFile) -> tuple[int, float] | None:
    """Index and force [N] of the first thruster that sticks, but at another force than `health` says."""
    for i, (believed_n, thruster) in enumerate(zip(health.stuck_n, vessel.thrusters, strict=True)):
        if believed_n is not None:
            force_n, sigma_n = float(bank.mean[0, 3 + i]), float(np.sqrt(bank.P[0, 3 + i, 3 + i]))
            if abs(force_n - believed_n) > max(SURE_SIGMAS * sigma_n, NO_FORCE_SHARE * thruster.most_N):
                return i, force_n
    return None
