"""Stochastic effects: waves, gusts, fixes without line of sight. They have no hooks and no Jacobian columns:

`stochastic_effects` has a likelihood test for each entry.
"""

from __future__ import annotations

import numpy as np

from sim.fitting.diagnose.catalogue.effect import Effect, EffectParameter
from sim.fitting.diagnose.catalogue.parts import scalar_parameter


def _location(name: str, unit: str, prior: float) -> EffectParameter:
    """A parameter of place, time or direction: its smallest size is infinite."""
    return EffectParameter(name, unit, prior, np.inf, prior)


WAVES = Effect(
    "waves",
    "environment",
    "X = a cos q, Y = 1.5 a sin q, N = 0.25 m a sin 2q;  a: narrow band, q = beta + pi - psi",
    "rocked along one direction over ground, with one period",
    (
        *scalar_parameter("F_w_N", "N", 2.0, 0.4, 0.0),
        _location("T_p_s", "s", 2.0),
        _location("beta_wave_deg", "deg", 180.0),
    ),
    {},
)
GUSTY_WIND = Effect(
    "gusty_wind",
    "environment",
    "tau += c q(V_rw) A,  V = V_w (1 + gustiness g), g Gauss-Markov",
    "pushed the same way over ground, now more, now less",
    (
        *scalar_parameter("V_w_m_s", "m/s", 5.0, 1.5, 0.0),
        _location("beta_w_deg", "deg", 180.0),
        _location("gustiness", "1", 0.5),
        _location("gust_time_s", "s", 10.0),
    ),
    {},
)
NLOS = Effect(
    "nlos",
    "sensors",
    "fix = place + extra e, e away from one anchor, extra exponential, in a share of fixes",
    "some positions lie too far from one anchor, never too near",
    (
        *scalar_parameter("share", "1", 0.1, 0.03, 0.0, 1.0),
        _location("extra_m", "m", 1.0),
        _location("anchor", "1", 10.0),
    ),
    {},
)


def effects() -> tuple[Effect, ...]:
    """All stochastic entries."""
    return WAVES, GUSTY_WIND, NLOS
