"""Logs with a wind that was measured."""

import numpy as np
import polars as pl

from companion.logs.runs.run import Run


def windy_log(run: Run, speed_m_s: float, from_deg: float) -> Run:
    """`run` with that wind measured in every row."""
    n = run.table.height
    columns = {"V_w_m_s": np.full(n, speed_m_s), "beta_w_deg": np.full(n, from_deg)}
    return Run(run.table.with_columns(**{name: pl.Series(name, v) for name, v in columns.items()}), run.meta)
