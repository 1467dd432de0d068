"""The wind that a log measured, and how it enters a fit.

A boat whose file has `[terms.wind]`, or whose surroundings are fitted, is moved by the wind that blew in each window,
so that it is not taken for hull, nor for a constant wind. Where none was measured the file's own blows, or the fitted
one. Always a steady wind: gusts are in what was measured.
"""

from __future__ import annotations

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.core.model.effects.wind import steady_speed
from companion.core.model.loads import values
from companion.logs.runs.nearest import distance
from companion.logs.runs.run import Run

COLUMNS = ("V_w_m_s", "beta_w_deg")
NEAR_S = 60.0
"""Wind is known within this of a sample: a mean wind lasts for minutes; assumed."""
OF_THE_DAY = {"wind_north_m_s": (0.0, 0.0), "wind_east_m_s": (0.0, 0.0)}
"""Priors of a fitted wind where all windows know theirs: there is none to fit."""
INPUTS = 3
"""Of a window: north and east components of where its wind comes from [m/s], and whether they are known (1, else 0)."""


def is_measured(run: Run) -> bool:
    """Whether wind was measured in a log, its speed and where from."""
    return all(map(run.known, COLUMNS))


def measured_wind(run: Run, t_s: np.ndarray) -> np.ndarray:
    """North and east components of where the wind came from at `t_s` [m/s], (*t_s.shape, 2); NaN where unknown."""
    if not is_measured(run):
        return np.full((*t_s.shape, 2), np.nan)
    at, speed_and_from = run.samples(*COLUMNS)
    speed, angle = speed_and_from[:, 0], np.radians(speed_and_from[:, 1])
    found = [np.interp(t_s, at, component) for component in (speed * np.cos(angle), speed * np.sin(angle))]
    return np.where((distance(at, t_s) > NEAR_S)[..., None], np.nan, np.stack(found, axis=-1))


def mean_wind(run: Run, t_s: np.ndarray) -> np.ndarray:
    """Mean of the measured wind over windows of steps from `t_s` (w, K + 1), by their lengths, (w, 2); NaN: unknown."""
    wind, h_s = measured_wind(run, t_s)[:, :-1], np.diff(t_s, axis=1)
    h_s = np.where(np.isfinite(wind[..., 0]), h_s, 0.0)[..., None]
    known_s = h_s.sum(axis=1)
    total = (np.nan_to_num(wind) * h_s).sum(axis=1)
    return np.where(known_s > 0, total / np.where(known_s > 0, known_s, 1.0), np.nan)


def takes_wind(vessel: VesselFile, surroundings: bool) -> bool:
    """Whether the model of a fit has wind, so that measured wind moves it."""
    return surroundings or "wind" in vessel.terms


def wind_inputs(wind_m_s: np.ndarray, vessel: VesselFile, surroundings: bool) -> np.ndarray:
    """Of each window, (W, INPUTS), from its measured wind (W, 2), NaN without; (W, 0) where the model has no wind."""
    if not takes_wind(vessel, surroundings):
        return np.zeros((len(wind_m_s), 0))
    own = np.zeros(INPUTS)
    if not surroundings:
        term = values("wind", vessel.terms["wind"])
        angle = np.radians(term["beta_w_deg"])
        speed = steady_speed(term)
        own[:] = speed * np.cos(angle), speed * np.sin(angle), 1.0
    measured = np.column_stack([wind_m_s, np.ones(len(wind_m_s))])
    return np.where(np.isfinite(wind_m_s[:, :1]), measured, own)
