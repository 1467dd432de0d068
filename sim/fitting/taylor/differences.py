"""Seven-point differences of a uniformly sampled series, as the paper uses for its accelerations.

    y_dot_i = sum_j w_j y_(i+j) / h        central: j = -3..3, forward: j = 0..6, backward: j = -6..0

The weights make the sum exact for polynomials up to degree 6. Truncation error: h^6 y^(7) / 140 inside, h^6 y^(7) / 7
at the ends. White noise of sigma in y becomes 1.08 sigma / h inside and 12.6 sigma / h at the ends, so the series must
be smoothed first. A step in y_dot (a thrust command) disturbs the three samples on either side of it.
"""

from __future__ import annotations

import numpy as np

MIN_SAMPLES = 9
"""Three forward differences at the start need samples 0 to 8."""


def weights(offsets: np.ndarray) -> np.ndarray:
    """Weights w (n,) of a first derivative at `offsets` (n,) [samples].

    Solution of sum_j w_j offset_j^p = (1 if p = 1 else 0) for p = 0 .. n - 1.
    """
    offsets = np.asarray(offsets, dtype=float)
    powers = np.vander(offsets, increasing=True).T
    return np.linalg.solve(powers, np.eye(len(offsets))[1])


CENTRAL = weights(np.arange(-3, 4))
FORWARD = weights(np.arange(7))
BACKWARD = weights(np.arange(-6, 1))


def derivative(y: np.ndarray, h_s: float) -> np.ndarray:
    """Time derivative along axis 0, same shape as `y` (k,) or (k, n), samples `h_s` apart.

    Forward at the first three samples, backward at the last three, central between. ValueError below 9 samples.
    """
    y = np.asarray(y, dtype=float)
    k = len(y)
    if k < MIN_SAMPLES:
        raise ValueError(f"7-point differences need {MIN_SAMPLES} samples, found {k}")
    out = np.empty_like(y)
    out[3:-3] = sum(w * y[3 + j : k - 3 + j] for w, j in zip(CENTRAL, range(-3, 4), strict=True))
    for i in range(3):
        out[i] = FORWARD @ y[i : i + 7]
        out[k - 1 - i] = BACKWARD @ y[k - 7 - i : k - i]
    return out / h_s
