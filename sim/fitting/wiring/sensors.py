"""A log's sensors against each other: yaw rate against heading, accelerations against positions."""

from __future__ import annotations

import numpy as np

from companion.logs.runs.disagreements import SLOPE_OFF, turn_ratio
from companion.logs.runs.run import Run
from sim.fitting.wiring.accelerations import GOOD, POOR, UNITS, unit_of
from sim.fitting.wiring.correction import IMU, Correction, scaled
from sim.fitting.wiring.levelling import explained_levelled
from sim.fitting.wiring.record import WiringFinding

CLEAR = 0.1
"""Least share of the positions' variance that turned accelerations explain more than otherwise turned ones; assumed."""
DEGREES = 180.0 / np.pi
GYRO = (
    Correction("gyro:reversed", "r_rad_s counts to port", gyro=-1.0),
    Correction("gyro:degrees", "r_rad_s is in degrees per second", gyro=1 / DEGREES),
    Correction("gyro:degrees+reversed", "r_rad_s is in degrees per second and counts to port", gyro=-1 / DEGREES),
)
PORT = next(c for c in IMU if c.name == "accelerations:y")


def gyro_fault(run: Run) -> Correction | None:
    """What undoes a wrong unit or sign of the yaw rate."""
    ratio = turn_ratio(run) if run.known("r_rad_s") else None
    return None if ratio is None else next((c for c in GYRO if abs(ratio / c.gyro - 1.0) < SLOPE_OFF), None)


def one_of(first: Correction | None, second: Correction | None) -> Correction | None:
    """What undoes both of two faults of the yaw rate; None where they undo each other."""
    factor = (first.gyro if first else 1.0) * (second.gyro if second else 1.0)
    return next((c for c in GYRO if np.isclose(c.gyro, factor)), None)


def sway_sign(run: Run) -> int:
    """1: ay_m_s2 counts to starboard, -1: to port, by heading and positions; 0 where these do not show it clearly."""
    as_it_is = explained_levelled(run) if run.known("ax_m_s2") and run.known("ay_m_s2") else None
    other = explained_levelled(PORT.apply(run)) if as_it_is else None
    if as_it_is is None or other is None or max(as_it_is[0], other[0]) < GOOD:
        return 0
    return int(np.sign(as_it_is[0] - other[0])) if abs(as_it_is[0] - other[0]) >= CLEAR else 0


def imu_fault(run: Run) -> Correction | None:
    """What undoes turned or mirrored accelerations, or another unit, where positions show it clearly."""
    if not run.known("ax_m_s2") or not run.known("ay_m_s2"):
        return None
    as_it_is = explained_levelled(run)
    if as_it_is is None:
        return None
    if unit := unit_of(*as_it_is):
        return Correction("accelerations:unit", f"ax_m_s2 and ay_m_s2 are in {unit}", forces=scaled(UNITS[unit]))
    if as_it_is[0] >= POOR and as_it_is[1] > 0:
        return None
    shares = []
    for one in IMU:
        share, factor = explained_levelled(one.apply(run)) or (0.0, 0.0)
        shares.append(share if factor > 0 else 0.0)
    order = np.argsort([-share for share in shares], kind="stable")
    best = IMU[order[0]]
    others = [shares[i] for i in order if IMU[i].name != best.name]
    return best if shares[order[0]] >= GOOD and shares[order[0]] - max(others) >= CLEAR else None


def findings_by_log(
    gyro: dict[str, Correction], imu: dict[str, Correction], runs: dict[str, Run]
) -> list[WiringFinding]:
    """Findings of single logs, each fault once; gyro and one axis reversed together: an IMU upside down."""
    over = {n for n in gyro if n in imu and gyro[n].gyro < 0 and imu[n].name in ("accelerations:x", "accelerations:y")}
    each = [("imu:upside_down", "the IMU is upside down", n) for n in runs if n in over]
    each += [(c.name, c.text, n) for by in (gyro, imu) for n, c in by.items() if n not in over]
    found = dict.fromkeys((name, text) for name, text, _ in each)
    return [
        WiringFinding(name=name, text=text, logs=tuple(n for a, _, n in each if a == name), certain=True)
        for name, text in found
    ]
