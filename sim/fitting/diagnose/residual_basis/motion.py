"""Basis functions of the motion: velocities, accelerations, displacement along and across the velocity."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sim.fitting.diagnose.catalogue.parts import body_to_ned
from sim.fitting.diagnose.residual_basis.basis import Basis
from sim.fitting.diagnose.residual_basis.group import FunctionGroup, function_group
from sim.fitting.engine.noise import BIAS_AX, BIAS_AY, BIAS_R, OFFSET, L

WORD = ("speed",)
PRODUCTS = ("u", "v", "r", "U", "V", "R", "uU", "vV", "rR", "uv", "ur", "vr", "Uv", "Ur", "uuu", "vvv", "rrr")
COEFFICIENTS = {
    "X": ("X_u_N_s_m", "X_uu_N_s2_m2"),
    "Y": ("Y_v_N_s_m", "Y_vv_N_s2_m2", "Y_r_N_s"),
    "K": ("N_r_N_m_s", "N_rr_N_m_s2", "N_v_N_s"),
}
"""Damping coefficients of each axis, K being yaw."""
INERTIA = ("M11_kg", "M22_kg", "M33_kg_m2")
FEW = ("u", "v", "r", "ur", "rR")


def by_speed(basis: Basis) -> Iterator[FunctionGroup]:
    """Groups of products of u, v, r (capitals: absolute values), for forces and sensors."""
    products = _products(basis.x[:, 3:])
    within = _products(basis.point.state.x[..., 3:])
    few = {n: products[n] for n in FEW}
    yield basis.of_force(
        "force over speed",
        WORD,
        {
            f"{axis} {n}": value[..., None] * (basis.M @ unit)
            for n, value in within.items()
            for axis, unit in zip("XYK", np.eye(3), strict=True)
        },
        "force",
    )
    yield from _shares(basis)
    for what, kind, entries in (("heading", "heading", [OFFSET]), ("yaw rate", "rate", [BIAS_R]),
                                ("specific force", "accel", [BIAS_AX, BIAS_AY])):  # fmt: skip
        yield basis.on_nodes(f"{what} error over speed", WORD, kind, entries, few)
    names = ["along", "across", "along 2", "across 2", "x r", "y r"]
    yield function_group("place error over speed", WORD, "place", names, _ways(basis))


def _products(nu: np.ndarray) -> dict[str, np.ndarray]:
    speeds = dict(zip("uvr", np.moveaxis(nu, -1, 0), strict=True))
    speeds |= {k.upper(): np.abs(v) for k, v in speeds.items()}
    return {n: np.prod([speeds[c] for c in n], axis=0) for n in PRODUCTS}


def _shares(basis: Basis) -> Iterator[FunctionGroup]:
    """Groups of relative changes of damping and inertia, and of inertia of one axis on another."""
    yield basis.of_hull("damping", WORD, {axis: COEFFICIENTS[axis] for axis in "XYK"})
    yield basis.of_hull("inertia", WORD, {name: (name,) for name in INERTIA})
    axes = {axis: np.eye(3)[i] for i, axis in enumerate("XYK")}
    pushes = {f"{to} by {of}": -(basis.accelerations @ unit)[..., None] * (basis.M @ there)
              for of, unit in axes.items() for to, there in axes.items()}  # fmt: skip
    yield basis.of_force("force over acceleration", WORD, pushes)


def _ways(basis: Basis) -> np.ndarray:
    """Nodes (W, L, 6): displacement along and across the velocity, also times speed; yaw rate ahead, abeam."""
    along, r = basis.velocity(), basis.x[:, 5]
    speed = np.hypot(*along.T)[:, None]
    across = np.column_stack([-along[:, 1], along[:, 0]])
    turning = [np.column_stack(body_to_ned(basis.psi, *one)) for one in ((r, 0 * r), (0 * r, r))]
    nodes = np.zeros((basis.W, L, 6))
    nodes[:, :2] = np.stack([along, across, along * speed, across * speed, *turning], axis=2)
    return nodes
