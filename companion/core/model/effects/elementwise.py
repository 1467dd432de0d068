"""Elementwise functions for numbers, numpy arrays and CasADi expressions alike."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np


def library(*values: Any) -> Any:
    """The module whose sqrt, exp, tanh, atan2 and fmax take all `values`: casadi for expressions, else numpy.

    numpy's own functions warn where they are called on an expression.

    >>> library(2.0, np.zeros(3)).__name__, library(2.0, ca.SX.sym("x")).__name__
    ('numpy', 'casadi')
    """
    return ca if any(isinstance(v, ca.SX | ca.MX | ca.DM) for v in values) else np
