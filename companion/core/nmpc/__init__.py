"""Nonlinear model predictive control: the production problem, and the paper's (`paper`)."""

from companion.core.nmpc.settings import Actuation, NmpcSettings
from companion.core.nmpc.solver import Nmpc
from companion.core.nmpc.warm import WarmStart

__all__ = ["Actuation", "Nmpc", "NmpcSettings", "WarmStart"]
