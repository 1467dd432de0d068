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
from sim.fitting.wiring.correction import ENU, HEADINGS, MATHEMATICAL, MIRRORED, Correction
from sim.fitting.wiring.regression import LogDesign, log_design
from sim.fitting.wiring.thrusters import Way, ways

BLOCK_S = 4.0
RARE_NATS = 3.0  # against each fault beyond the first; assumed
BESIDE_ENU = ("reversed:", "mirrored:fore_aft")
"""Faults of thrusters that are tried in a mirrored log, too: those that are tried beside mirrored sides."""


@dataclass(frozen=True)
class Connection:
    """The file as it is (neither), thrusters connected in another way, heading or positions in other axes, or both."""

    way: Way | None = None
    motion: Correction | None = None

    @property
    def name(self) -> str:
        """As in reports; empty for the file as it is."""
        return "+".join(part.name for part in (self.motion, self.way) if part)

    @property
    def text(self) -> str:
        """In words."""
        return ", and ".join(part.text for part in (self.motion, self.way) if part) or "as the file says"

    @property
    def faults(self) -> int:
        """How many things went wrong."""
        return (self.way.faults if self.way else 0) + bool(self.motion)


def candidates(vessel: VesselFile, any_axes: bool = False) -> list[Connection]:
    """All of them, the file as it is first.

    `any_axes`: the logs' axes are those of whoever wrote them. A mirrored log of a boat whose sides are right looks to
    the last digit as a right log of one whose sides are mirrored, and so does each with another fault beside.
    """
    every = ways(vessel)
    found = [Connection(way=way) if way.faults else Connection() for way in every]
    found += [Connection(motion=m) for m in (*HEADINGS, *MIRRORED)]
    if any_axes:
        found += [Connection(motion=m) for m in MATHEMATICAL]
        found += [Connection(way=w, motion=ENU) for w in every if w.faults == 1 and w.name.startswith(BESIDE_ENU)]
    return found


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
    found: list[_Misfit] = []
    design = log_design(run, vessel)
    if design is None:
        return None
    designs: dict[str, LogDesign | None] = {"": design}
    for one in tried:
        axes = one.motion.name if one.motion else ""
        if one.motion and axes not in designs:
            designs[axes] = log_design(one.motion.apply(run), vessel)
        own = designs[axes]
        if own is None:
            return None
        found.append(_misfit(own, one.way.vessel if one.way else vessel))
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
