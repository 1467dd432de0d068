"""Distance to a path by its points alone."""

from __future__ import annotations

import numpy as np

from companion.core.guidance.path import Path


def distance_m(path: Path, north_m: float, east_m: float) -> float:
    """Distance of a point to the nearest leg [m]."""
    points = np.array(path.points)
    along, away = np.diff(points, axis=0), np.array([north_m, east_m]) - points[:-1]
    share = np.clip((along * away).sum(axis=1) / (along**2).sum(axis=1), 0.0, 1.0)
    return float(np.hypot(*(away - share[:, None] * along).T).min())
