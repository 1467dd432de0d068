"""The UWB tag's ranges, spoilt: frozen, silent, noisy, scaled, late, to anchors that stand elsewhere."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from companion.core.configuration.site_file import Anchor
from tests.fault_lab.fault import Fault

Ranges = dict[str, float | None]


class FaultyRanges:
    """In place of the world's UWB sensor; `fix` and `arrival_ns` are its own."""

    def __init__(self, sensor, anchors: Sequence[Anchor], faults: Sequence[Fault], rng: np.random.Generator):
        self._sensor, self._faults, self._rng = sensor, faults, rng
        self._ids = [a.id for a in anchors]
        self._places = {a.id: np.array([a.north_m, a.east_m, a.down_m]) for a in anchors}
        self._middle = np.mean([*self._places.values()], axis=0)
        self._held: dict[str, Ranges] = {}
        self._past: list[tuple[float, Ranges]] = []

    def __getattr__(self, name):
        return getattr(self._sensor, name)

    def measure(self, motion) -> Ranges:
        """Range [m] by anchor; None where there is none."""
        ranges, t_s = self._sensor.measure(motion), motion.t_ns * 1e-9
        self._past.append((t_s, dict(ranges)))
        for fault in self._faults:
            if fault.acts(t_s):
                ranges = self._spoilt(fault, dict(ranges), motion, t_s)
        return ranges

    def _spoilt(self, fault: Fault, ranges: Ranges, motion, t_s: float) -> Ranges:
        held = self._held.setdefault(str(fault), dict(ranges))
        if fault.target == "anchor":
            one = self._ids[fault.number - 1]
            return ranges | {one: self._one(fault, ranges[one], held[one], one, motion)}
        if fault.kind == "frozen":
            return held
        if fault.kind == "late":
            return next((r for t, r in reversed(self._past) if t <= t_s - fault.size), held)
        return {anchor: self._range(fault, r, anchor, motion) for anchor, r in ranges.items()}

    def _range(self, fault: Fault, now: float | None, anchor: str, motion) -> float | None:
        """One range where all are spoilt alike."""
        if fault.kind == "noise":
            return _more(now, self._rng.normal(0, fault.size))
        if fault.kind == "outliers":
            return _more(now, self._rng.uniform(1.0, 6.0)) if self._rng.uniform() < fault.size else now
        if fault.kind == "scale":
            return None if now is None else fault.size * now
        return None if fault.kind == "silent" else self._moved(now, anchor, fault, motion)

    def _one(self, fault: Fault, now: float | None, held: float | None, anchor: str, motion) -> float | None:
        if fault.kind == "silent":
            return None
        if fault.kind == "moved":
            place = self._places[anchor]
            inward = (self._middle - place)[:2]
            there = place + np.array([*(fault.size * inward / np.linalg.norm(inward)), 0.0])
            return self._to(there, now, anchor, motion)
        return held if fault.kind == "frozen" else _more(now, fault.size)

    def _moved(self, now: float | None, anchor: str, fault: Fault, motion) -> float | None:
        """Range to where the anchor really stands: mirrored about the east axis, or turned about the middle."""
        away = self._places[anchor] - self._middle
        if fault.kind == "mirrored":
            away = away * (-1.0, 1.0, 1.0)
        else:
            a = math.radians(90 * round(fault.size / 90))
            north, east = math.cos(a) * away[0] - math.sin(a) * away[1], math.sin(a) * away[0] + math.cos(a) * away[1]
            away = np.array([north, east, away[2]])
        return self._to(self._middle + away, now, anchor, motion)

    def _to(self, place: np.ndarray, now: float | None, anchor: str, motion) -> float | None:
        tag = self._sensor.tag_position(motion.x)
        return _more(now, float(np.linalg.norm(tag - place) - np.linalg.norm(tag - self._places[anchor])))


def _more(reading: float | None, extra: float) -> float | None:
    return None if reading is None else max(0.0, reading + float(extra))
