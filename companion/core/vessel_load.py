"""Reading a vessel file, with the checks that span several of its tables."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from companion.core import terms
from companion.core import vessel as model
from companion.core.config import ConfigError, parse_toml
from companion.core.vessel_file import RotorMap, VesselFile


def load_vessel(text: str, *, name: str) -> VesselFile:
    """Vessel file text -> VesselFile, checked across tables. Raises ConfigError naming file and key."""
    vessel = parse_toml(text, VesselFile, name=name)
    for problem in _problems(vessel):
        raise ConfigError(f"{name}: {problem}")
    return vessel


def _problems(vessel: VesselFile) -> Iterator[str]:
    """Yield what no single table can know to be wrong."""
    for i, t in enumerate(vessel.thrusters):
        at = f"thrusters[{i}]"
        if t.force_map not in vessel.force_maps:
            yield f"{at}.force_map: no table force_maps.{t.force_map}; there are {sorted(vessel.force_maps)}"
        if not t.pwm_min_us < 1500 < t.pwm_max_us:
            yield f"{at}.pwm_min_us: expected pwm_min_us < 1500 < pwm_max_us"
        if not t.force_min_N < t.force_max_N:
            yield f"{at}.force_min_N: expected force_min_N < force_max_N"
        fmap = vessel.force_maps.get(t.force_map)
        if isinstance(fmap, RotorMap) and t.trim_us and abs(t.trim_us) >= fmap.dead_band_us:
            yield f"{at}.trim_us: expected less than the dead band of {fmap.dead_band_us:g} us: 1500 us must be neutral"
        if t.name in [other.name for other in vessel.thrusters[:i]]:
            yield f"{at}.name: {t.name!r} is there twice"
        if t.channel in [other.channel for other in vessel.thrusters[:i]]:
            yield f"{at}.channel: channel {t.channel} is there twice"
    if np.linalg.eigvalsh(model.mass_matrix(vessel)).min() <= 0:
        yield "inertia: M_RB + M_A is not positive definite; look at Y_rdot_kg_m, x_g_m and y_g_m"
    D = model.linear_damping(vessel)
    if np.linalg.eigvalsh(D + D.T).min() < 0:
        yield "damping: the linear part feeds energy into the hull; |Y_r_N_s + N_v_N_s| is too large"
    if "wind" in vessel.terms:
        for key in ("frontal_area_m2", "lateral_area_m2"):
            if not getattr(vessel.hull, key):
                yield f"hull.{key}: missing key: terms.wind needs it"
    yield from terms.problems(vessel.terms)
