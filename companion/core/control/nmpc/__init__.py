"""Nonlinear model predictive control of the production boat."""

from companion.core.control.nmpc.settings import Actuation, NmpcSettings
from companion.core.control.nmpc.solver import Nmpc
from companion.core.control.nmpc.warm_start import WarmStart

__all__ = ["Actuation", "Nmpc", "NmpcSettings", "WarmStart"]
