"""Catalogue: water, air, shore."""

from __future__ import annotations

import numpy as np

from tests.hidden.effects.effect import Draw, Effect, Params, also, heading, sets
from tests.hidden.plant.world import MIDDLE_M, World


def _flow(speed: str, direction: str, **more: tuple[float, float]) -> Draw:
    """Speed of the size, any direction, further numbers drawn evenly between limits."""

    def draw(rng: np.random.Generator, size: float, base: World) -> Params:
        params = {speed: size, direction: heading(rng)}
        return params | {k: float(rng.uniform(a, b)) for k, (a, b) in more.items()}

    return draw


def _turning(rng: np.random.Generator, size: float, base: World) -> Params:
    turn = float(rng.choice([-1, 1]) * rng.uniform(0.3, 1.0))
    return {"V_c_m_s": size, "beta_c_deg": heading(rng), "turn_deg_s": turn}


def _tether(rng: np.random.Generator, size: float, base: World) -> Params:
    side = int(rng.integers(4))
    along, edge = float(rng.uniform(4, 26)), 0.0 if side % 2 else 30.0
    north, east = (edge, along) if side < 2 else (along, edge)
    return {"k_N_m": size, "anchor_north_m": north, "anchor_east_m": east, "x_t_m": -0.6}


def _tie(world: World, p: Params) -> None:
    world.water.tether_N_m = p["k_N_m"]
    world.water.tether_at = (p["anchor_north_m"], p["anchor_east_m"], p["x_t_m"])


def _zone(rng: np.random.Generator, size: float, base: World) -> Params:
    place = MIDDLE_M + rng.uniform(-5, 5, 2)
    return {"gain": 1 + size, "north_m": float(place[0]), "east_m": float(place[1]),
            "radius_m": float(rng.uniform(3.5, 5.5))}  # fmt: skip


def _shallow(world: World, p: Params) -> None:
    world.water.shallow = p["gain"] - 1
    world.water.shallow_at = (p["north_m"], p["east_m"], p["radius_m"])


def _waves(rng: np.random.Generator, size: float, base: World) -> Params:
    return {"F_w_N": size, "T_p_s": float(rng.uniform(1.5, 3.0)), "beta_wave_deg": heading(rng)}


_CURRENT = sets("water", V_c="V_c_m_s", beta_c_deg="beta_c_deg")
_TURNING = sets("water", V_c="V_c_m_s", beta_c_deg="beta_c_deg", turn_deg_s="turn_deg_s")
_WIND = sets("water", V_w="V_w_m_s", beta_w_deg="beta_w_deg")
_GUSTY = sets("water", V_w="V_w_m_s", beta_w_deg="beta_w_deg", gustiness="gustiness", gust_time="gust_time_s")
_WAVES = sets("water", wave_N="F_w_N", wave_T="T_p_s", wave_from_deg="beta_wave_deg")


def _swinging(world: World, p: Params) -> None:
    world.water.turn_deg_s, world.water.swing = 0.0, (100.0, 400.0)


def _square_gusts(world: World, p: Params) -> None:
    world.water.gust_square = 8.0


def _shear(world: World, p: Params) -> None:
    world.water.shear = 0.04


def _slender(world: World, p: Params) -> None:
    world.water.c_wind = (0.5, 1.1, 0.18)


def _tension(world: World, p: Params) -> None:
    world.water.tether_form, world.water.tether_N_m = (10.0 * p["k_N_m"], 0.0), 0.0


def _slack(world: World, p: Params) -> None:
    world.water.tether_form, world.water.tether_N_m = (0.0, 8.0), 1.6 * p["k_N_m"]


def _strip(world: World, p: Params) -> None:
    world.water.shallow_strip = True


def _second_peak(world: World, p: Params) -> None:
    world.water.wave_second = 0.4


def _broad(world: World, p: Params) -> None:
    world.water.wave_band = 0.2


EFFECTS = (
    Effect("current", ("V_c_m_s",), 0.02, _flow("V_c_m_s", "beta_c_deg"), _CURRENT,
           {"shear": also(_CURRENT, _shear)}),
    Effect("turning_current", ("V_c_m_s",), 0.02, _turning, _TURNING, {"swinging": also(_TURNING, _swinging)}),
    Effect("wind", ("V_w_m_s",), 1.0, _flow("V_w_m_s", "beta_w_deg"), _WIND, {"shape": also(_WIND, _slender)}),
    Effect("gusty_wind", ("V_w_m_s",), 1.5,
           _flow("V_w_m_s", "beta_w_deg", gustiness=(0.35, 0.6), gust_time_s=(6.0, 15.0)),
           _GUSTY, {"on_off": also(_GUSTY, _square_gusts)}),
    Effect("waves", ("F_w_N",), 0.4, _waves, _WAVES,
           {"two_peaks": also(_WAVES, _second_peak), "broad": also(_WAVES, _broad)}),
    Effect("tether", ("k_N_m",), 0.05, _tether, _tie, {"tension": also(_tie, _tension), "slack": also(_tie, _slack)}),
    Effect("shallow_zone", ("gain",), 0.15, _zone, _shallow, {"strip": also(_shallow, _strip)}, neutral=1.0),
)  # fmt: skip
