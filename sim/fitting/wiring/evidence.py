"""Evidence of logs for each way in which a boat may be connected, in nats over the file as it is.

    nats = sum over blocks and axes of  ln (S_file + n s^2) / (S_way + n s^2)  -  distance of the gains  -  prior

S: squared residuals of `regression` in a block of `BLOCK_S`; s^2: what a row has at least. A block counts as two
samples in each axis, whatever its size: neither one violent minute decides nor hours at rest, and where nothing moves
nothing is said.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.logs.runs.run import Run
from sim.fitting.wiring.correction import HEADINGS, MIRRORED, Correction
from sim.fitting.wiring.regression import LogDesign, log_design
from sim.fitting.wiring.thrusters import Way, ways

BLOCK_S = 4.0
RARE_NATS = 3.0  # against each fault beyond the first; assumed


@dataclass(frozen=True)
class Candidate:
    """The file as it is (neither), thrusters connected in another way, or heading or positions in other axes."""

    way: Way | None = None
    motion: Correction | None = None

    @property
    def name(self) -> str:
        """As in reports; empty for the file as it is."""
        return self.way.name if self.way else self.motion.name if self.motion else ""

    @property
    def text(self) -> str:
        """In words."""
        return self.way.text if self.way else self.motion.text if self.motion else "as the file says"

    @property
    def faults(self) -> int:
        """How many things went wrong."""
        return self.way.faults if self.way else 1 if self.motion else 0


def candidates(vessel: VesselFile) -> list[Candidate]:
    """All of them, the file as it is first."""
    found = [Candidate(way=way) if way.faults else Candidate() for way in ways(vessel)]
    return found + [Candidate(motion=m) for m in (*HEADINGS, *MIRRORED)]


def nats_of(run: Run, vessel: VesselFile, tried: Sequence[Candidate]) -> np.ndarray | None:
    """Nats of each candidate over the first, (len(tried),); None where the log holds too little."""
    design, found = log_design(run, vessel), []
    for one in tried:
        own = log_design(one.motion.apply(run), vessel) if one.motion else design
        if own is None:
            return None
        found.append(_misfit(own, one.way.vessel if one.way else vessel))
    prior = np.array([RARE_NATS * max(one.faults - 1, 0) for one in tried])
    return np.array([found[0].over(one) for one in found]) - prior


@dataclass(frozen=True)
class _Misfit:
    """Squared residuals by block, (b,) for plane and yaw, with what a block has at least; distance of the gains."""

    plane: np.ndarray
    yaw: np.ndarray
    far: float

    def over(self, other: _Misfit) -> float:
        """Nats of `other` over this one."""
        better = np.log(self.plane / other.plane).sum() + np.log(self.yaw / other.yaw).sum()
        return float(better + (self.far - other.far) / 2)


def _misfit(design: LogDesign, vessel: VesselFile) -> _Misfit:
    plane, yaw, far = design.residuals(vessel)
    block = ((design.at_s - design.at_s[0]) / BLOCK_S).astype(int)
    rows = np.bincount(block)
    least = rows + (rows == 0)  # a block without rows counts 0
    return _Misfit(
        np.bincount(block, plane) + 2 * least * design.plane.sigma2,
        np.bincount(block, yaw) + least * design.yaw.sigma2,
        far,
    )
