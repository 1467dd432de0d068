"""Roll and pitch as of an AHRS without GPS, in a log whose own are true."""

import numpy as np
import polars as pl
from scipy.signal import lfilter

from companion.logs.runs.run import Run
from sim.fitting.wiring.levelling import TILT

G, AHRS_S = 9.81, 5.0


def following_acceleration(run: Run) -> Run:
    """The run, its tilt from an AHRS that takes the specific force for gravity, with a time constant of `AHRS_S`."""
    known = run.table.drop_nulls("ax_m_s2")
    share = 1 - np.exp(-known["t_s"].diff().median() / AHRS_S)
    late = {c: lfilter([share], [1, share - 1], known[c].to_numpy()) / G for c in ("ax_m_s2", "ay_m_s2")}
    tilt = known.select("t_s").with_columns(theta_rad=pl.Series(late["ax_m_s2"]), phi_rad=-pl.Series(late["ay_m_s2"]))
    return Run(run.table.drop(*TILT, strict=False).join(tilt, on="t_s", how="left"), run.meta)
