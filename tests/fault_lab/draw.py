"""Faults drawn at random from a seed: kind, target, size, beginning and, for one in three, an end."""

from __future__ import annotations

import numpy as np

from tests.fault_lab.fault import KINDS, NUMBERED, PUSH_N, Fault

BEGINS_S, LASTS_S = (0.0, 70.0), (4.0, 30.0)
PUSH_LASTS_S = (2.0, 5.0, 20.0, 60.0)


def draw(seed: int) -> Fault:
    """One fault; targets alike, then kinds alike. None is a push."""
    rng = np.random.default_rng([seed, 2026])
    target = str(rng.choice([t for t in KINDS if t != "boat"]))
    kind = str(rng.choice(list(KINDS[target])))
    number = int(rng.integers(1, NUMBERED[target] + 1)) if target in NUMBERED else 0
    from_s = round(float(rng.uniform(*BEGINS_S)), 1)
    to_s = round(from_s + float(rng.uniform(*LASTS_S)), 1) if rng.uniform() < 1 / 3 else np.inf
    size = np.nan
    if limits := KINDS[target][kind]:
        size = round(float(rng.uniform(*limits)), 2)
        if kind == "swapped":  # with one of the other three
            size = float((number + int(rng.integers(1, NUMBERED[target])) - 1) % NUMBERED[target] + 1)
    return Fault(target, kind, number, size, from_s, to_s)


def push(seed: int) -> Fault:
    """One push, from shorter than a verdict to longer than the mission."""
    rng = np.random.default_rng([seed, 8])
    size, from_s = round(float(rng.uniform(*PUSH_N)), 1), round(float(rng.uniform(*BEGINS_S)), 1)
    return Fault("boat", "pushed", 0, size, from_s, round(from_s + float(rng.choice(PUSH_LASTS_S)), 1))
