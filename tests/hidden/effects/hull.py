"""Catalogue: hull."""

from __future__ import annotations

import numpy as np

from tests.hidden.effects.effect import Effect, Params, also, one, sets, two
from tests.hidden.plant.world import World

LINEAR, QUADRATIC = ("X_u", "Y_v", "Y_r", "N_v", "N_r"), ("X_uu", "Y_vv", "N_rr")


def _foul(world: World, p: Params) -> None:
    for name in LINEAR + QUADRATIC:
        setattr(world.hull, name, getattr(world.hull, name) * p["gain"])


def _foul_rough(world: World, p: Params) -> None:
    """Only the quadratic part grows, by more."""
    for name in QUADRATIC:
        setattr(world.hull, name, getattr(world.hull, name) * (1 + 1.5 * (p["gain"] - 1)))


def _foul_power(world: World, p: Params) -> None:
    """What is more goes with speed^1.5."""
    world.hull.extra = (1.3 * (p["gain"] - 1), 1.5)


def _load(rng: np.random.Generator, size: float, base: World) -> Params:
    return {"mass_kg": size * base.hull.m, "share": size}


def _payload(world: World, p: Params) -> None:
    world.hull.m += p["mass_kg"]


def _sunk(world: World, p: Params) -> None:
    """A loaded boat lies deeper: sway damping and added mass grow by half the share."""
    for name in ("Y_v", "Y_vv", "Y_vdot"):
        setattr(world.hull, name, getattr(world.hull, name) * (1 + 0.5 * p["share"]))


def _added(world: World, p: Params) -> None:
    world.hull.X_udot *= p["gain"]
    world.hull.Y_vdot *= p["gain"]


def _turned(rng: np.random.Generator, size: float, base: World) -> Params:
    sign = -1.0 if rng.uniform() < 0.4 else 1.0
    return {"I_z_kg_m2": sign * size * (base.hull.I_z - base.hull.N_rdot), "share": sign * size}


def _inertia(world: World, p: Params) -> None:
    world.hull.I_z += p["I_z_kg_m2"]


def _shift(world: World, p: Params) -> None:
    world.hull.x_g += p["x_g_m"]
    world.hull.y_g += p["y_g_m"]


def _aft_less(world: World, p: Params) -> None:
    world.hull.cross_flow_aft = 0.5


def _couple(world: World, p: Params) -> None:
    world.hull.Y_r += p["Y_r_N_s"]
    world.hull.N_v += p["N_v_N_s"]


def _fade(world: World, p: Params) -> None:
    world.hull.munk, world.hull.munk_fade = 1.4 * p["N_uv_kg"], 1.0


_CROSS = sets("hull", cross_flow="C_d")
EFFECTS = (
    Effect("hull_fouling", ("gain",), 0.08, one("gain", neutral=1.0, positive=True), _foul,
           {"rough": _foul_rough, "power": _foul_power}, neutral=1.0),
    Effect("payload", ("share",), 0.06, _load, _payload, {"sunk": also(_payload, _sunk)},
           reported=("mass_kg",)),
    Effect("added_mass", ("gain",), 0.12, one("gain", neutral=1.0, down=0.3), _added, neutral=1.0),
    Effect("yaw_inertia", ("share",), 0.08, _turned, _inertia, reported=("I_z_kg_m2",)),
    Effect("cg_shift", ("x_g_m", "y_g_m"), 0.02, two("x_g_m", "y_g_m"), _shift),
    Effect("cross_flow", ("C_d",), 0.15, one("C_d", positive=True), _CROSS, {"forward": also(_CROSS, _aft_less)}),
    Effect("yaw_sway_coupling", ("Y_r_N_s", "N_v_N_s"), 1.5, two("Y_r_N_s", "N_v_N_s"), _couple),
    Effect("munk_moment", ("N_uv_kg",), 4.0, one("N_uv_kg"), sets("hull", munk="N_uv_kg"), {"fade": _fade}),
)  # fmt: skip
