"""An independent peer: pysindy on the same smoothed speeds and forces, with a library that spans the same 23 terms.

pysindy differentiates by its own smoothed finite differences and removes small terms by its own STLSQ; only the order
of the terms is that of `regression`. Source: Kaptanoglu et al., PySINDy, JOSS 7 (2022) 3994.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence

import numpy as np

from sim.fitting.taylor.abkowitz_table import NOMINAL_U_M_S, TERMS
from sim.fitting.taylor.regression import Samples

THRESHOLD = 0.01
"""Threshold of STLSQ on coefficients in SI and kgf: keeps Table 2's smallest thrust coefficients (assumed)."""
_LETTERS = {"x0": "u", "x1": "v", "x2": "r", "u0": "x", "u1": "y", "u2": "n"}


def sindy_coefficients(logs: Sequence[Samples], threshold: float = THRESHOLD) -> np.ndarray:
    """Coefficients C (3, 23) by pysindy. ModuleNotFoundError where it is not installed (extra `analysis`)."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # pysindy's own, on import and while thresholding
        import pysindy  # noqa: PLC0415 - an optional peer

        library = pysindy.GeneralizedLibrary(
            [pysindy.PolynomialLibrary(degree=3), pysindy.IdentityLibrary()],
            inputs_per_library=[[0, 1, 2], [3, 4, 5]],
        )
        model = pysindy.SINDy(
            optimizer=pysindy.STLSQ(threshold=threshold, alpha=1e-9),
            feature_library=library,
            differentiation_method=pysindy.SmoothedFiniteDifference(),
        )
        x = [log.nu - [NOMINAL_U_M_S, 0.0, 0.0] for log in logs]
        model.fit(x, t=1.0 / logs[0].rate_hz, u=[log.t_kgf for log in logs])
        coefficients = np.asarray(model.coefficients())
        names = model.get_feature_names()
    order = [_term(name) for name in names]
    return coefficients[:, [order.index("".join(sorted(term))) for term in TERMS]]


def _term(name: str) -> str:
    """Subscript of a term from its name in pysindy: "x0^2 x1" -> "uuv" (sorted), "1" -> "0"."""
    if name == "1":
        return "0"
    factors = re.findall(r"([xu]\d)(?:\^(\d))?", name)
    return "".join(sorted("".join(_LETTERS[symbol] * int(power or 1) for symbol, power in factors)))
