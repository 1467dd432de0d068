"""How lively the latent force is now: waves are many times what a model leaves out, and as regular as no noise is.

    z = nu / sqrt(S)                          innovation of an axis, white and of variance 1 where the filter is right
    m' = (z - m) / tau                        its mean over a fraction of a wave's period, of variance dt / (2 tau)
    a' = (min(m^2 2 tau / dt, 25) - 3) / T   0 <= a <= most
    latent variance_i + (e^(a_i') - 1) sigma_lively^2,      a_i' = max(a_i, max a - 2)

One number each for surge, sway and yaw. Without it the filter takes a wave's acceleration for a tilt. Covariance
matching and whiteness of innovations: R. K. Mehra, On the identification of variances and adaptive Kalman filtering,
1970.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

LARGEST = 25.0
"""Five sigma: a single outlier is no wave; assumed."""
SLACK = 3.0
"""A mean square three times that of white noise is tolerated, so that white noise raises nothing; assumed."""
MEAN_S = 0.2
"""tau; assumed: a tenth of a wave's period."""
RISE_S, FALL_S = 0.5, 4.0
"""T while a rises, and while it falls; assumed: large within a quarter of a wave's period, and kept over two."""
MOST = math.log(1000.0)
"""The latent sigma grows thirtyfold at most: from the 3 N of a good model to waves of 100 N; assumed."""
SPREAD = 2.0
"""No axis counts as less active than the most active one less this: waves that push a boat turn it, too, if not at each
moment. Tuned: where yaw counted as calm amid waves, the filter told sway from the yaw rate by the model (Munk's moment,
N_v): 0.36 m/s wrong with a sigma of 0.04."""

MEMORY_S = 1.0
"""The latent force that lasts is its mean over a times so long: over a wave or more where waves are, and over nothing
where the force is only what the model leaves out. Assumed."""
STEADY_S = (8.0, 8.0, 0.0)
"""A controller plans against its mean over so long at least: the noise of ranges at 1 Hz moves the latent force, and
a boat on station that counters it at once goes along. Not in yaw, which a gyro tells: there it is only late. Tuned."""


class AxisActivity(NamedTuple):
    """`mean`: m; `log_variance`: a."""

    mean: float = 0.0
    log_variance: float = 0.0


Activity = tuple[AxisActivity, AxisActivity, AxisActivity]
CALM: Activity = (AxisActivity(), AxisActivity(), AxisActivity())
_LIVELY, _LIVELIEST = AxisActivity(log_variance=math.log(300.0)), AxisActivity(log_variance=MOST)
UNKNOWN: Activity = (_LIVELY, _LIVELY, _LIVELY)
"""At the first acceleration: it is a wave's until it proves to be none, and no tilt."""
AFTER_GAP: Activity = (_LIVELIEST, _LIVELIEST, _LIVELIEST)
"""At the first one after a gap: a boat under way is pushed by waves that its bow meets, and by its thrusters. Tuned."""


Wrench = tuple[float, float, float]


class LatentMeans(NamedTuple):
    """Means of the latent force [N, N, N m]: `lasting`, what outlasts waves; `steady`, what can be planned against."""

    lasting: Wrench = (0.0, 0.0, 0.0)
    steady: Wrench = (0.0, 0.0, 0.0)


def update_activity(activity: Activity, axes: Sequence[int], z: Sequence[float], dt_s: float) -> Activity:
    """The activity after innovations z of `axes` (0 surge, 1 sway, 2 yaw), `dt_s` after the ones before."""
    if dt_s <= 0.0:
        return activity
    after, gain = list(activity), -math.expm1(-dt_s / MEAN_S)
    for axis, value in zip(axes, z, strict=True):
        mean, log_variance = activity[axis]
        mean += gain * (value - mean)
        d2 = mean**2 * (2 - gain) / gain
        excess = min(d2, LARGEST) - SLACK
        log_variance += excess / (RISE_S if excess > 0 else FALL_S) * min(dt_s, MEAN_S)
        after[axis] = AxisActivity(mean, min(max(log_variance, 0.0), MOST))
    return after[0], after[1], after[2]


def log_variances(activity: Activity) -> list[float]:
    """ln of the latent force's variance over that of the model's own error, by axis; none is far from the largest."""
    least = max(axis.log_variance for axis in activity) - SPREAD
    return [max(axis.log_variance, least) for axis in activity]


def update_means(means: LatentMeans, latent: Sequence[float], levels: Sequence[float], dt_s: float) -> LatentMeans:
    """Means of the latent force after `dt_s`; `levels`: `log_variances`."""
    lasting_s = [MEMORY_S * a for a in levels]
    steady_s = [max(pair) for pair in zip(lasting_s, STEADY_S, strict=True)]
    return LatentMeans(
        _update_mean(means.lasting, latent, lasting_s, dt_s), _update_mean(means.steady, latent, steady_s, dt_s)
    )


def _update_mean(mean: Wrench, latent: Sequence[float], over_s: Sequence[float], dt_s: float) -> Wrench:
    X, Y, N = (
        m + (d - m) * (-math.expm1(-dt_s / time_s) if time_s else 1.0)
        for m, d, time_s in zip(mean, latent, over_s, strict=True)
    )
    return X, Y, N
