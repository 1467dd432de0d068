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
class Connection:
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


def candidates(vessel: VesselFile) -> list[Connection]:
    """All of them, the file as it is first."""
    found = [Connection(way=way) if way.faults else Connection() for way in ways(vessel)]
    return found + [Connection(motion=m) for m in (*HEADINGS, *MIRRORED)]


@dataclass(frozen=True)
class Evidence:
    """What logs say of each candidate. `nats`: over the first, (c,).

    left     squared residuals of plane and yaw, (2, c)
    whole    what there is to explain in either, (2,)
    """

    nats: np.ndarray
    left: np.ndarray
    whole: np.ndarray

    def __add__(self, other: Evidence) -> Evidence:
        return Evidence(self.nats + other.nats, self.left + other.left, self.whole + other.whole)

    @property
    def explained(self) -> np.ndarray:
        """Share of the variance that each candidate explains of plane and yaw, (2, c)."""
        return 1.0 - self.left / np.maximum(self.whole, 1e-12)[:, None]


def evidence(run: Run, vessel: VesselFile, tried: Sequence[Connection]) -> Evidence | None:
    """Of one log for each candidate; None where it holds too little."""
    design, found = log_design(run, vessel), []
    for one in tried:
        own = log_design(one.motion.apply(run), vessel) if one.motion else design
        if own is None:
            return None
        found.append(_misfit(own, one.way.vessel if one.way else vessel))
    assert design is not None
    prior = np.array([RARE_NATS * max(one.faults - 1, 0) for one in tried])
    return Evidence(
        nats=np.array([found[0].over(one) for one in found]) - prior,
        left=np.array([one.left for one in found]).T,
        whole=np.array([design.plane.y @ design.plane.y, design.yaw.y @ design.yaw.y]),
    )


@dataclass(frozen=True)
class _Misfit:
    """Squared residuals by block, (b,) for plane and yaw, with what a block has at least; distance of the gains.

    `left`: the sums of squares themselves, of plane and yaw.
    """

    plane: np.ndarray
    yaw: np.ndarray
    far: float
    left: tuple[float, float]

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
        plane=np.bincount(block, plane) + 2 * least * design.plane.sigma2,
        yaw=np.bincount(block, yaw) + least * design.yaw.sigma2,
        far=far,
        left=(float(plane.sum()), float(yaw.sum())),
    )
