"""A run corrected for the sensor errors that the vessel file states, for fits and comparisons.

The equations are those of `core.model.sensor_errors`, as in the filter. Latency and lever arms are not corrected: fits
estimate them. A drifting clock moves position samples in time; rows are split and merged accordingly. The drift counts
from the first position of the whole log, of which `run` may be a part.
"""

from __future__ import annotations

import numpy as np
import polars as pl

from companion.core.configuration.sensors import Imu, Uwb
from companion.core.configuration.vessel_file import VesselFile
from companion.core.geometry.frames import wrapped
from companion.core.model.sensor_errors import correct_heading, correct_imu, correct_uwb_scale, drifted, is_exact
from companion.logs.runs.columns import HELD
from companion.logs.runs.run import Run

PLACE = ["north_m", "east_m"]


def calibrated(run: Run, vessel: VesselFile) -> Run:
    """`run` with psi, r, a_x, a_y, north and east corrected; the run itself where the file states no error."""
    imu, uwb = vessel.sensors.imu, vessel.sensors.uwb
    if is_exact(vessel.sensors) and not (uwb and uwb.clock_drift_s_s):
        return run
    table = _inertial(run.table, imu)
    if uwb is None:
        return Run(table, run.meta, run.whole)
    north, east = correct_uwb_scale(uwb, *(table[name].to_numpy() for name in PLACE))
    table = table.with_columns(pl.Series("north_m", north), pl.Series("east_m", east)).fill_nan(None)
    return Run(_in_time(table, uwb, first_fix_s(run)) if uwb.clock_drift_s_s else table, run.meta, run.whole)


def first_fix_s(run: Run) -> float:
    """Stamp of the first position of the whole log [s], from which the clock drifts; 0 where there is none."""
    t_s, _ = run.whole.samples(*PLACE)
    return float(t_s[0]) if len(t_s) else 0.0


def _inertial(table: pl.DataFrame, imu: Imu) -> pl.DataFrame:
    """Corrected heading, yaw rate, specific force. With misaligned axes a row needs both forces, else it is blank."""
    psi, r, a_x, a_y = (table[name].to_numpy() for name in ("psi_rad", "r_rad_s", "ax_m_s2", "ay_m_s2"))
    alone = 0.0 if not imu.misalignment_rad else np.nan
    x, _, rate = correct_imu(imu, a_x, np.where(np.isnan(a_y), alone, a_y), r)
    _, y, _ = correct_imu(imu, np.where(np.isnan(a_x), alone, a_x), a_y, r)
    psi = wrapped(correct_heading(imu, psi))
    new = {"psi_rad": psi, "r_rad_s": rate, "ax_m_s2": x, "ay_m_s2": y}
    return table.with_columns(**{name: pl.Series(name, values) for name, values in new.items()}).fill_nan(None)


def _in_time(table: pl.DataFrame, uwb: Uwb, zero_s: float) -> pl.DataFrame:
    """Position samples `latency_s` after they were taken, as those of an undrifting clock are."""
    placed = table.select("t_s", *PLACE).drop_nulls()
    t = placed["t_s"].to_numpy()
    since = t - zero_s - uwb.latency_s
    placed = placed.with_columns(t_s=pl.Series(t - drifted(uwb.clock_drift_s_s, since)))
    held = [name for name in table.columns if name.startswith(HELD)]
    both = table.drop(PLACE).join(placed, on="t_s", how="full", coalesce=True).sort("t_s")
    return both.with_columns(pl.col(held).forward_fill().backward_fill()).select(table.columns)
