"""First-order lag of thruster force, with or without a limit on its rate, solved exactly for a constant command.

    f_dot = (f_cmd - f) / T_lag                       f(t) = f_cmd + (f(0) - f_cmd) exp(-t / T_lag)
    |f_dot| <= slew                                   a ramp until |f_cmd - f| = slew T_lag, the lag from there on

The one definition: filter, NMPC, fits and validation call it; `sim.fitting.engine.kernels.thrust` repeats it for whole
logs and is compared with it by a test. The plant integrates f_dot itself (`integrate.state_rate`). Dead time comes
before: the command that acts is the one of a dead time ago. An angle of a servo [rad] follows its command like a force.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np


def first_order_lag(f_n: Any, command_n: Any, t_s: Any, lag_s: float | np.ndarray) -> Any:
    """Force [N] after `t_s` of a constant command; forces may be arrays or CasADi expressions, times arrays."""
    return command_n + (f_n - command_n) * decay(t_s, lag_s)


def decay(t_s: Any, lag_s: float | np.ndarray) -> Any:
    """exp(-t / lag), of one lag or one for each channel."""
    exp = np.exp if isinstance(t_s, np.ndarray) or isinstance(lag_s, np.ndarray) else math.exp
    return exp(-t_s / lag_s)


def slew_limited_lag(
    f_n: np.ndarray, command_n: np.ndarray, t_s: Any, lag_s: float | np.ndarray, slew_N_s: float | np.ndarray
) -> np.ndarray:
    """As `first_order_lag`, changing by at most `slew_N_s` [N/s]."""
    gap, ramp_s = _after_ramp(f_n - command_n, t_s, lag_s, slew_N_s)
    return command_n + gap * np.exp(-(t_s - ramp_s) / lag_s)


def lagged(
    f_n: np.ndarray,
    command_n: np.ndarray,
    dt_s: float,
    lag_s: float | np.ndarray,
    slew_N_s: float | np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Force after dt_s of a constant command, and its mean over that time [N], shapes (n,)."""
    gap = f_n - command_n
    if slew_N_s is None:
        share = lag_s / dt_s * (1 - decay(dt_s, lag_s))
        return first_order_lag(f_n, command_n, dt_s, lag_s), command_n + gap * share
    after, ramp_s = _after_ramp(gap, dt_s, lag_s, slew_N_s)
    left = np.exp(-(dt_s - ramp_s) / lag_s)
    area = (gap + after) / 2 * ramp_s + after * lag_s * (1 - left)
    return slew_limited_lag(f_n, command_n, dt_s, lag_s, slew_N_s), command_n + area / dt_s


def _after_ramp(
    gap: np.ndarray, t_s: Any, lag_s: float | np.ndarray, slew_N_s: float | np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """f - f_cmd [N] where the ramp ends, and how long it takes [s], at most `t_s`."""
    ramp_s = np.clip(np.abs(gap) / slew_N_s - lag_s, 0.0, t_s)
    return gap - np.sign(gap) * slew_N_s * ramp_s, ramp_s
