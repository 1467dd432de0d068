"""Positions of the tag for a run: multilateration of the ranges of a cycle, and conversion of latitude and longitude.

    min over p of sum_i rho(z_i - |p - a_i|),   rho: Cauchy's loss, by iteratively re-weighted Gauss-Newton

for all cycles at once, started at the mean of the anchors that answered. Where a range disagrees with the result, the
cycle is solved from every pair of its anchors (`multilaterate`, 1.5 ms); it is left blank where fewer than
three ranges agree with its best fix.
"""

from __future__ import annotations

from collections.abc import Mapping
from statistics import median_low

import numpy as np

from companion.core.configuration.site_file import Site
from companion.core.estimation.ranging.multilateration import multilaterate
from companion.core.geometry.frames import Origin, site_from_geodetic
from companion.logs.runs.origin import origin_words

SPREAD_M = 0.5  # residual of a good range; assumed
PLAIN_STEPS, STEPS = 8, 16
NEAR_M, SPREADS = 2000.0, 5.0
"""A fix further from the median of all than both, metres and medians of these distances, is no place of the boat;
assumed. A wrong origin within 2 km makes distances east wrong by less than a thousandth, up to 70 degrees."""


def cycle_fixes(ranges_m: Mapping[str, np.ndarray], site: Site, tag_down_m: float) -> tuple[np.ndarray, np.ndarray]:
    """North and east (n,) [m] of n cycles with ranges (n,) [m] by anchor; NaN where there is no consistent fix."""
    anchors = [a for a in site.anchors if a.id in ranges_m]
    count = len(next(iter(ranges_m.values()), ()))
    if len(anchors) < 3:
        return np.full(count, np.nan), np.full(count, np.nan)
    places = np.array([(a.north_m, a.east_m, a.down_m) for a in anchors])
    z = np.column_stack([ranges_m[a.id] for a in anchors])
    p = _together(places, z, tag_down_m)
    received = np.isfinite(z)
    distance = np.sqrt(((p[:, None, :] - places[:, :2]) ** 2).sum(axis=2) + (places[:, 2] - tag_down_m) ** 2)
    odd = (received & ~(np.abs(z - distance) < SPREAD_M)).any(axis=1)
    for row in np.flatnonzero(odd):
        candidates = multilaterate(places[received[row]], z[row, received[row]], tag_down_m, SPREAD_M)
        sound = candidates and candidates[0].inliers.sum() >= 3
        p[row] = (candidates[0].north_m, candidates[0].east_m) if sound else (np.nan, np.nan)
    p[received.sum(axis=1) < 3] = np.nan
    return p[:, 0], p[:, 1]


def _together(places: np.ndarray, z: np.ndarray, tag_down_m: float) -> np.ndarray:
    """Positions (n, 2) of all cycles from ranges z (n, m), NaN where missing, to anchors `places` (m, 3).

    The first `PLAIN_STEPS` steps are unweighted, so that outliers do not decide where the iteration goes.
    """
    received = np.isfinite(z)
    z = np.where(received, z, 0.0)
    drop2 = (places[:, 2] - tag_down_m) ** 2
    p = (received @ places[:, :2]) / np.maximum(received.sum(axis=1), 1)[:, None]
    for step in range(STEPS):
        away = p[:, None, :] - places[:, :2]
        distance = np.sqrt((away**2).sum(axis=2) + drop2)
        residual = z - distance
        weight = received / (1.0 + (residual / (SPREAD_M / 2)) ** 2) if step >= PLAIN_STEPS else received.astype(float)
        H = away / distance[:, :, None]
        A = np.einsum("nij,nik,ni->njk", H, H, weight) + 1e-9 * np.eye(2)
        b = np.einsum("nij,ni->nj", H, weight * residual)
        p = p + np.linalg.solve(A, b[:, :, None])[:, :, 0]
    return p


def geodetic_to_site(
    latitude_deg: np.ndarray, longitude_deg: np.ndarray, site: Site | None
) -> tuple[np.ndarray, np.ndarray, str]:
    """North, east (n,) [m] in site axes, and a text that states their origin: the site's, or the first fix of those
    that lie `together`.
    """
    if site is not None:
        origin = Origin(site.lat_deg, site.lon_deg, float(np.deg2rad(site.rotation_deg)))
        origin_text = f"origin of site {site.name}"
    else:
        first = int(together(latitude_deg, longitude_deg).argmax())
        origin = Origin(float(latitude_deg[first]), float(longitude_deg[first]))
        origin_text = origin_words(origin)
    return *site_from_geodetic(origin, latitude_deg, longitude_deg), origin_text


def together(latitude_deg: np.ndarray, longitude_deg: np.ndarray) -> np.ndarray:
    """Mask (n,) of the fixes near their median, by how far they lie from it as a rule: `NEAR_M`, `SPREADS`."""
    middle = Origin(float(median_low(latitude_deg.tolist())), float(median_low(longitude_deg.tolist())))
    away_m = np.hypot(*site_from_geodetic(middle, latitude_deg, longitude_deg))
    return away_m <= max(NEAR_M, SPREADS * float(np.median(away_m)))
