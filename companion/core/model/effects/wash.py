"""Thrust lost by a thruster that lies in the jet of another.

    f'_i = f_i prod_j max(1 - share_ij p(f_j) / F_ij, 0)

The jet leaves thruster j against its thrust: p(f_j) = |f_j| while it points to i, else 0, smooth. `share` is lost where
j gives F (`at_N`), by default the larger of its force limits.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from companion.core.configuration.vessel_file import Thruster, VesselFile
from companion.core.model.effects.advance_loss import size
from companion.core.model.effects.elementwise import library


class Jet(NamedTuple):
    """`ahead` blows at `behind` (numbers of thrusters) while its thrust has this `sign`; `per_N`: share over F."""

    behind: int
    ahead: int
    sign: int
    per_N: Any


def jets(vessel: VesselFile) -> list[Jet]:
    """Jets of the vessel file."""
    number = {t.name: i for i, t in enumerate(vessel.thrusters)}
    found = []
    for w in vessel.propulsion.wash:
        behind, ahead = number[w.behind], number[w.ahead]
        one = vessel.thrusters[ahead]
        full_N = w.at_N or one.most_N
        found.append(Jet(behind, ahead, jet_sign(one, vessel.thrusters[behind]), w.share / full_N))
    return found


def jet_sign(source: Thruster, target: Thruster) -> int:
    """Sign of the force of `source` whose jet points to `target`: 1 where positive thrust blows at it."""
    a = np.deg2rad(source.azimuth_deg)
    along = (target.x_m - source.x_m) * np.cos(a) + (target.y_m - source.y_m) * np.sin(a)
    return 1 if along <= 0 else -1


def washed(f: Sequence[Any], blowing: Iterable[Jet]) -> list[Any]:
    """f' [N] of the forces f of n thrusters, each a number, an array or an expression."""
    out = list(f)
    for jet in blowing:
        lib = library(f[jet.ahead], jet.per_N)
        blown = size(lib.fmax(jet.sign * f[jet.ahead], 0.0))
        out[jet.behind] = out[jet.behind] * lib.fmax(1 - jet.per_N * blown, 0.0)
    return out
