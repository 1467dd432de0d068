"""Columns of a log as they would be with its sensors connected right: turned, mirrored, exchanged, in other units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import polars as pl

from companion.core.geometry.frames import wrapped
from companion.logs.runs.run import Run

EYE = ((1.0, 0.0), (0.0, 1.0))
Matrix = tuple[tuple[float, float], tuple[float, float]]


@dataclass(frozen=True)
class Correction:
    """What undoes a fault. `name`: as in reports; `text`: the fault in words.

    places       on north_m, east_m (2, 2)
    forces       on ax_m_s2, ay_m_s2 (2, 2); with `tilted` on roll and pitch too: the whole IMU is turned
    heading      factor of psi_rad, and what is added to it [rad]
    gyro         factor of r_rad_s
    """

    name: str
    text: str
    places: Matrix = EYE
    forces: Matrix = EYE
    tilted: bool = False
    heading: tuple[float, float] = (1.0, 0.0)
    gyro: float = 1.0

    def apply(self, run: Run) -> Run:
        """The run with corrected columns; blanks stay."""
        new: dict[str, pl.Expr] = {}
        pairs = [(("north_m", "east_m"), self.places), (("ax_m_s2", "ay_m_s2"), self.forces)]
        for (one, other), ((a, b), (c, d)) in pairs:
            if (a, b, c, d) != (1.0, 0.0, 0.0, 1.0):
                new[one], new[other] = a * pl.col(one) + b * pl.col(other), c * pl.col(one) + d * pl.col(other)
        if self.tilted and {"phi_rad", "theta_rad"} <= set(run.table.columns):
            (a, b), (c, d) = self.forces  # gravity is (-theta, phi) in the axes of (x, y), for small tilt
            phi, theta = pl.col("phi_rad"), pl.col("theta_rad")
            new["theta_rad"], new["phi_rad"] = a * theta - b * phi, d * phi - c * theta
        if self.heading != (1.0, 0.0):
            factor, offset = self.heading
            new["psi_rad"] = wrapped(factor * pl.col("psi_rad") + offset)
        if self.gyro != 1.0:
            new["r_rad_s"] = self.gyro * pl.col("r_rad_s")
        return Run(run.table.with_columns(**new), run.meta) if new else run


def turn(quarters: int) -> Matrix:
    """Rotation by so many quarter turns, exactly."""
    c, s = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[quarters % 4]
    return ((c, -s), (s, c))


def scaled(factor: float) -> Matrix:
    """The same direction, `factor` times as long."""
    return ((factor, 0.0), (0.0, factor))


HEADINGS = tuple(
    Correction(f"heading:{90 * k}", f"psi_rad is {90 * k} degrees too large", heading=(1.0, -k * np.pi / 2))
    for k in (1, 2, 3)
)
MIRRORED = (
    Correction("heading:reversed", "psi_rad counts to port", heading=(-1.0, 0.0)),
    Correction("positions:swapped", "north_m and east_m have changed places", places=((0, 1), (1, 0))),
    Correction("positions:east", "east_m counts to the west", places=((1, 0), (0, -1))),
    Correction("positions:north", "north_m counts to the south", places=((-1, 0), (0, 1))),
)
MATHEMATICAL = (
    Correction(
        "heading:mathematical",
        "psi_rad is mathematical: counter-clockwise from east, not clockwise from north",
        heading=(-1.0, np.pi / 2),
    ),
    Correction(
        "axes:enu",
        "the log is mirrored: its axes are those of ROS and of mathematics (x east in north_m, y north in east_m, "
        "psi_rad counter-clockwise)",
        places=((0, 1), (1, 0)),
        heading=(-1.0, np.pi / 2),
    ),
)
"""Axes of logs that others wrote. The second mirrors all that is known of the motion: so do x north and y west with a
heading to port, which is the same log but for a turn of the whole world, and looks the same to a fit."""
ENU = MATHEMATICAL[1]
IMU = (
    *(
        Correction(
            f"imu:{90 * k}", f"the IMU is turned by {90 * k} degrees to starboard", forces=turn(k), tilted=tilted
        )
        for k in (1, 2, 3)
        for tilted in (True, False)
    ),
    Correction("accelerations:swapped", "ax_m_s2 and ay_m_s2 have changed places", forces=((0, 1), (1, 0))),
    Correction("accelerations:y", "ay_m_s2 counts to port", forces=((1, 0), (0, -1))),
    Correction("accelerations:x", "ax_m_s2 counts astern", forces=((-1, 0), (0, 1))),
)
