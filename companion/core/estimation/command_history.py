"""Thruster forces as they arrive at the water: commands through dead time and first-order lag.

f_dot = (f_cmd(t - dead time) - f) / T_lag, at most `slew` up or down;   solved exactly while the command is constant
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from companion.core.configuration.vessel_file import Propulsion


class TimedCommand(NamedTuple):
    """A force command [N] per thruster, and when it begins to act."""

    acts_ns: int
    f_n: np.ndarray


def insert_command(
    commands: tuple[TimedCommand, ...], t_ns: int, f_n: tuple[float, ...], p: Propulsion
) -> tuple[TimedCommand, ...]:
    """Timeline with a command given at t_ns; one given earlier than the last replaces what follows it."""
    acts_ns = t_ns + round(p.dead_time_s * 1e9)
    kept = tuple(c for c in commands if c.acts_ns < acts_ns)
    return (*kept, TimedCommand(acts_ns, np.asarray(f_n, dtype=float)))


def drop_expired(commands: tuple[TimedCommand, ...], t_ns: int) -> tuple[TimedCommand, ...]:
    """Timeline without what was over before t_ns."""
    first = 0
    while first + 1 < len(commands) and commands[first + 1].acts_ns <= t_ns:
        first += 1
    return commands[first:]


def active_command(commands: tuple[TimedCommand, ...], t_ns: int) -> tuple[np.ndarray, int | None]:
    """The command that acts at t_ns, and when the next one takes over (None: never)."""
    now = commands[0].f_n
    for command in commands[1:]:
        if command.acts_ns > t_ns:
            return now, command.acts_ns
        now = command.f_n
    return now, None


def lagged(
    f_n: np.ndarray, command_n: np.ndarray, dt_s: float, lag_s: float, slew_N_s: float | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Force after dt_s of a constant command, and its mean over that time [N]."""
    if slew_N_s is not None:
        return _slewed(f_n, command_n, dt_s, lag_s, slew_N_s)
    decay = math.exp(-dt_s / lag_s)
    gap = f_n - command_n
    return command_n + gap * decay, command_n + gap * (lag_s / dt_s * (1 - decay))


def _slewed(
    f_n: np.ndarray, command_n: np.ndarray, dt_s: float, lag_s: float, slew_N_s: float
) -> tuple[np.ndarray, np.ndarray]:
    """`lagged` with a limit on the rate: a ramp until the gap is slew x lag, the lag from there on."""
    gap = f_n - command_n
    ramp_s = np.clip(np.abs(gap) / slew_N_s - lag_s, 0.0, dt_s)
    after = gap - np.sign(gap) * slew_N_s * ramp_s
    rest_s = dt_s - ramp_s
    decay = np.exp(-rest_s / lag_s)
    area = (gap + after) / 2 * ramp_s + after * lag_s * (1 - decay)
    return command_n + after * decay, command_n + area / dt_s
