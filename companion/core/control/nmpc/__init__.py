"""Nonlinear model predictive control: the production problem (stage, cost, settings) and its solver.

The solver always ends in a status. Plans come from `control.rti`; hpipm and IPOPT stand behind it.
"""

from companion.core.control.nmpc.settings import Actuation, NmpcSettings
from companion.core.control.nmpc.solver import Nmpc
from companion.core.control.nmpc.warm_start import WarmStart

__all__ = ["Actuation", "Nmpc", "NmpcSettings", "WarmStart"]
