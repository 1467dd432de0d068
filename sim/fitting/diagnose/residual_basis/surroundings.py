"""Basis functions of position and heading."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sim.fitting.diagnose.residual_basis.basis import Basis
from sim.fitting.diagnose.residual_basis.group import FunctionGroup
from sim.fitting.engine.noise import BIAS_AX, BIAS_AY, OFFSET

ORDER, TURNS = 4, 3
BENDS = 5  # highest harmonic of damping over heading, which may vary within a narrow range


def by_position(basis: Basis) -> Iterator[FunctionGroup]:
    """Groups of cosine fields cos(i pi n) cos(j pi e) over the range of positions."""
    places = basis.physics.windows.fixes.place_m
    low, high = np.quantile(places, (0.02, 0.98), axis=0)
    n, e = np.pi * np.clip((basis.x[:, :2] - low) / np.maximum(high - low, 1e-3), 0, 1).T
    fields = {f"{i}{j}": np.cos(i * n) * np.cos(j * e)
              for i in range(ORDER + 1) for j in range(ORDER + 1 - i) if i + j}  # fmt: skip
    word = ("position",)
    far = {"00": np.ones(basis.W)}  # a pull from far away is nearly constant
    pulls = [*basis.axes("NE"), *(np.outer(axis[:, 1], np.eye(3)[2]) for axis in basis.axes("NE"))]
    yield basis.on_nodes("force over position", word, "force", basis.axes("NE"), far | fields)
    yield basis.on_nodes("pull over position", word, "force", pulls, far | fields)
    yield basis.on_nodes("heading error over position", word, "heading", [OFFSET], fields)
    broad = {key: value for key, value in fields.items() if sum(map(int, key)) < ORDER}
    yield basis.on_nodes("water over position", word, "water", basis.water, broad)
    yield basis.on_nodes("damping over position", word, "share", [basis.damping], broad)
    centre = places.mean(axis=0)
    strain = {"north": basis.x[:, 0] - centre[0], "east": basis.x[:, 1] - centre[1]}
    yield basis.on_nodes("scale of places", word, "strain", [0, 1], strain)
    yield basis.on_nodes("place error over position", word, "place", [0, 1], broad)


def by_heading(basis: Basis) -> Iterator[FunctionGroup]:
    """Groups of harmonics of the heading, and of constants in NED, which vary with the heading in body axes."""
    word, constant = ("heading",), {"1": np.ones(basis.W)}
    yield basis.on_nodes("steady force over ground", word, "force", basis.axes("NE"), constant)
    yield basis.on_nodes("steadily moving water", word, "water", basis.water, constant)
    yield basis.on_nodes("steady heading error", word, "heading", [OFFSET], constant)
    bends = {f"{k}{w.__name__}": w(k * basis.psi) for k in range(1, BENDS + 1) for w in (np.cos, np.sin)}
    waves, two = (dict(list(bends.items())[: 2 * k]) for k in (TURNS, 2))
    yield basis.on_nodes("force over heading", word, "force", basis.axes("XYK"), waves)
    drag = [basis.damping * axis for axis in np.eye(3)]
    yield basis.on_nodes("damping over heading", word, "share", drag, bends)
    yield basis.on_nodes("heading error over heading", word, "heading", [OFFSET], waves)
    yield basis.on_nodes("specific force over heading", word, "accel", [BIAS_AX, BIAS_AY], two)
    yield basis.on_nodes("place error over heading", word, "place", [0, 1], two)
