"""What to drive next: the manoeuvre that tells most of what the data leave open, and that the boat can do."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.core.model.actuators.propulsion import ActuatorSet

SWAY, YAW = 1, 2
"""Rows of B."""


class Manoeuvre(NamedTuple):
    """For parameters whose names begin so. `needs`: rows of B without which the boat does `otherwise`."""

    heads: tuple[str, ...]
    text: str
    needs: tuple[int, ...] = ()
    otherwise: str = ""


MANOEUVRES = (
    Manoeuvre(
        ("M11_kg", "X_u"), "steps ahead and astern from rest, at three strengths at least, each let run out to rest"
    ),
    Manoeuvre(
        ("M22_kg", "Y_v_", "Y_vv"),
        "strafes: sideways to either hand at three strengths, each let run out to rest",
        (SWAY,),
        "hard turns to either hand at full speed, in which the boat slides sideways, each ended by letting it run out",
    ),
    Manoeuvre(
        ("M33_kg", "N_r_N", "N_rr"),
        "spins on the spot both ways at three strengths, each let run out to rest",
        (YAW,),
        "turns both ways at three speeds, each ended with rudder or steering amidships until it goes straight",
    ),
    Manoeuvre(
        ("M23_kg", "Y_r_", "N_v_"),
        "circles and zig-zags at speed, and strafes that end in a turn",
        (SWAY,),
        "circles and zig-zags at three speeds",
    ),
    Manoeuvre(
        ("gain_",), "pulses of one thruster at a time; and a pull at the bollard for the scale common to all of them"
    ),
    Manoeuvre(("dead_time", "lag_"), "short strong pulses and reversals, with the IMU at its highest rate"),
    Manoeuvre(("uwb_latency",), "fast straight runs to and fro, with positions at 5 Hz or more"),
    Manoeuvre(
        ("tag_",),
        "spins on the spot, with positions at 5 Hz or more",
        (YAW,),
        "the tightest circles both ways, with positions at 5 Hz or more",
    ),
    Manoeuvre(("trim_", "azimuth_"), "weak commands to either side of neutral, of one thruster at a time"),
    Manoeuvre(("N_ur_", "k_kg"), "circles and zig-zags at three speeds, ahead and astern"),
    Manoeuvre(("N_uu_", "advance_loss"), "straight runs at three speeds, each let run out to rest"),
)
"""In the order in which they are told."""
ANYTHING = "slow and fast runs, straight and turning, in which these act most"


def advice(names: Sequence[str], vessel: VesselFile) -> list[tuple[tuple[str, ...], str]]:
    """Undetermined parameters of the structured fit, by the manoeuvre that carries information on them."""
    free = free_axes(vessel)
    groups = [(tuple(n for n in names if n.startswith(m.heads)), feasible(m, free)) for m in MANOEUVRES]
    listed = {n for mine, _ in groups for n in mine}
    groups.append((tuple(n for n in names if n not in listed), ANYTHING))
    return [(mine, text) for mine, text in groups if mine]


def free_axes(vessel: VesselFile) -> frozenset[int]:
    """Rows of B in which the boat, at rest, can push without having to push in another."""
    at_rest = ActuatorSet.of(vessel).at_rest
    able = np.linalg.matrix_rank(at_rest)
    return frozenset(row for row in range(3) if np.linalg.matrix_rank(np.delete(at_rest, row, axis=0)) < able)


def feasible(manoeuvre: Manoeuvre, free: frozenset[int]) -> str:
    """What a boat that is free in these rows can do for it."""
    return manoeuvre.text if free.issuperset(manoeuvre.needs) else manoeuvre.otherwise
