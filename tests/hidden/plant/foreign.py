"""A plant of another structure than any vessel file: six degrees of freedom, bent thrust curves, errors that last.

`add_foreign` goes on top of the everyday imperfections. Coefficients of hull and thrusters end up to 10 % and 6 % off
their file, so that some of them are themselves worth a name: `passable_names`.
"""

from __future__ import annotations

import numpy as np

from tests.hidden.effects.imperfections import COEFFICIENTS, DAMPING, OWNERS
from tests.hidden.plant.world import Afloat, World

MORE_OF_COEFFICIENT, MORE_OF_GAIN = 0.06, 0.035
"""On top of the 4 % and 2.5 % of the everyday imperfections."""
FORCE_N = (0.5, 0.5, 0.15)
"""Coloured force noise in X, Y [N] and N [N m], one sigma: assumed."""
PASSABLE = 0.8


def add_foreign(world: World, rng: np.random.Generator, causes: list[tuple[str, dict]]) -> None:
    """Change `world` before its effects are applied. All ranges assumed; AHRS after an ArduPilot without GPS."""
    names = {name for name, _ in causes}
    clean = {key for name in names for key in OWNERS.get(name, ())}
    for key in COEFFICIENTS:
        share = float(rng.uniform(-1, 1)) * MORE_OF_COEFFICIENT
        if f"hull.{key}" not in clean and not ("hull_fouling" in names and key in DAMPING):
            setattr(world.hull, key, getattr(world.hull, key) * (1 + share))
    taken = {p.get("thruster") for _, p in causes}
    for thruster in world.drive.thrusters:
        share = float(rng.uniform(-1, 1)) * MORE_OF_GAIN
        if thruster.name not in taken and not names & {"common_loss", "astern_asymmetry"}:
            thruster.gain *= 1 + share
    draw, hull, sense = rng.uniform, world.hull, world.sense
    world.afloat = Afloat(
        z_g=float(draw(-0.12, 0.0)),
        GM_T=float(draw(0.4, 1.0)),
        GM_L=float(draw(0.9, 2.0)),
        k_x=0.45 * hull.beam,
        k_y=0.35 * hull.length,
        heave_N_m=float(draw(4000, 7000)),
        zeta=float(draw(0.1, 0.3)),
        thrust_z=float(draw(0.08, 0.2)),
        drag_z=0.5 * hull.draft,
        sensor_z=(float(draw(-0.2, 0.0)), sense.uwb_z),
    )
    world.drive.bend = (float(draw(-0.1, 0.1)), float(draw(-0.1, 0.1)))  # 3 % of full thrust at 60 % of the command
    world.drive.quantum_us = float(draw(1.0, 5.0))
    world.water.ambient_N = FORCE_N
    sense.ahrs_s = float(draw(3.0, 10.0))
    sense.tilt_told = bool(draw() < 0.5)
    sense.slow_fix_m, sense.slow_fix_s = 0.6 * sense.uwb_sigma, float(draw(1.0, 4.0))
    sense.outage = (0.01 / sense.uwb_hz, float(draw(2.0, 6.0)))


def passable_names(base: World, calm: World) -> list[str]:
    """Names of what is off the file by about a nameable size with no cause in: neither asked for nor wrong."""
    h, b = calm.hull, base.hull
    gains = {t.name: t.gain * calm.drive.common - 1 for t in calm.drive.thrusters}
    sizes = {f"thruster_gain:{name}": share / 0.05 for name, share in gains.items()}
    sizes["common_loss"] = sum(gains.values()) / len(gains) / 0.05
    sizes["astern_asymmetry"] = (calm.drive.astern_gain - 1) / 0.06
    sizes["payload"] = (h.m / b.m - 1) / 0.06
    sizes["yaw_inertia"] = ((h.I_z - h.N_rdot) / (b.I_z - b.N_rdot) - 1) / 0.08
    sizes["added_mass"] = (h.Y_vdot / b.Y_vdot - 1) / 0.12
    sizes["hull_fouling"] = sum(getattr(h, k) / getattr(b, k) - 1 for k in DAMPING) / len(DAMPING) / 0.08
    return sorted(name for name, size in sizes.items() if abs(size) >= PASSABLE)
