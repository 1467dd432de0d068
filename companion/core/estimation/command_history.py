"""Commands to the actuators by the instant from which each acts: when it was given plus the dead time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class TimedCommand(NamedTuple):
    """A command per channel [N; angles rad], and when it begins to act."""

    acts_ns: int
    f_n: np.ndarray


def insert_command(
    commands: tuple[TimedCommand, ...], t_ns: int, f_n: tuple[float, ...], dead_time_s: float | np.ndarray
) -> tuple[TimedCommand, ...]:
    """Timeline with a command given at t_ns; one given earlier than the last replaces what follows it.

    `dead_time_s`: of all channels, or (n,): then each channel has its own timeline within the one.
    """
    f = np.asarray(f_n, dtype=float)
    if not isinstance(dead_time_s, np.ndarray):
        acts_ns = t_ns + round(dead_time_s * 1e9)
        kept = tuple(c for c in commands if c.acts_ns < acts_ns)
        return (*kept, TimedCommand(acts_ns, f))
    acts = t_ns + np.round(dead_time_s * 1e9).astype(np.int64)
    for acts_ns in sorted(set(acts.tolist())):
        before = [c for c in commands if c.acts_ns < acts_ns]
        after = [c for c in commands if c.acts_ns >= acts_ns]
        if not after or after[0].acts_ns > acts_ns:
            after.insert(0, TimedCommand(acts_ns, before[-1].f_n if before else f))
        commands = (*before, *(TimedCommand(c.acts_ns, np.where(acts == acts_ns, f, c.f_n)) for c in after))
    return commands


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
