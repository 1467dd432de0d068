"""Evidence of one log for each way in which a boat may be connected, in nats over the file as it is.

    nats = sum over blocks and axes of  ln (S_file + n s^2) / (S_way + n s^2)  -  distance of the gains  -  prior

S: squared residuals of `regression` in a block of `BLOCK_S`, s^2: what a row has at least. A block counts as two samples
for each axis, whatever its size, so that neither one violent minute nor hours at rest decide; and where nothing moves
nothing is said.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.logs.runs.run import Run
from sim.fitting.wiring.regression import LogDesign, log_design
from sim.fitting.wiring.thrusters import Way

BLOCK_S = 4.0
RARE_NATS = 3.0  # against each fault beyond the first; assumed


@dataclass(frozen=True)
class Misfit:
    """Squared residuals by block, (b,) for plane and yaw, with what a block has at least; distance of the gains."""

    plane: np.ndarray
    yaw: np.ndarray
    far: float

    def over(self, way: Misfit) -> float:
        """Nats of `way` over this one."""
        return float(
            np.log(self.plane / way.plane).sum() + np.log(self.yaw / way.yaw).sum() + (self.far - way.far) / 2
        )


def misfit(design: LogDesign, vessel: VesselFile) -> Misfit:
    """Of one way of connecting thrusters to one log."""
    plane, yaw, far = design.residuals(vessel)
    block = ((design.at_s - design.at_s[0]) / BLOCK_S).astype(int)
    rows = np.bincount(block)
    return Misfit(
        np.bincount(block, plane) + 2 * rows * design.plane.sigma2,
        np.bincount(block, yaw) + rows * design.yaw.sigma2,
        far,
    )
