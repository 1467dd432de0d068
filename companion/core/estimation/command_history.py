"""Commands to the thrusters by the instant from which each acts: when it was given plus the dead time."""

from __future__ import annotations

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
