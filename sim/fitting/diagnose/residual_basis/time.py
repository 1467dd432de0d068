"""Basis functions of the shared clock: slow cosines, and the periods at which the latent acceleration is largest."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sim.fitting.diagnose.catalogue.parts import body_to_ned
from sim.fitting.diagnose.residual_basis.basis import Basis, Functions
from sim.fitting.diagnose.residual_basis.group import FunctionGroup, function_group
from sim.fitting.engine.noise import BIAS_AX, BIAS_AY, BIAS_R, LATENT, OFFSET, L

SLOW = 6  # highest order of the slow cosines
HZ = (0.005, 0.45)  # range of periodic functions: slower ones are "slow", faster ones beyond windows of a second
PEAKS = 2
MOST_S = 3600.0  # longest span that sets the frequency resolution: logs may be days apart
WORD = ("time",)


def by_time(basis: Basis) -> Iterator[FunctionGroup]:
    """Groups of cos(k pi t), k <= `SLOW`, over the span of all logs."""
    low, high = basis.clock.min(), basis.clock.max()
    phase = np.pi * (basis.clock - low) / max(high - low, 1.0)
    slow = {str(k): np.cos(k * phase) for k in range(1, SLOW + 1)}
    yield basis.on_nodes("force over time", WORD, "force", basis.axes("NEK"), slow)
    yield basis.on_nodes("water over time", WORD, "water", basis.water, {"0": np.ones(basis.W)} | slow)
    n, waves = len(basis.names), {k: basis.f * v[:, None, None] for k, v in slow.items()}
    for i, name in enumerate([*basis.names, "all"]):
        mine = np.eye(n)[i] if i < n else np.ones(n)
        words = ("time", f"thruster:{name}") if i < n else WORD
        yield basis.of_thrust(f"thrust over time, {name}", words, waves, mine=mine)
    for what, kind, entry in (("heading", "heading", OFFSET), ("yaw rate", "rate", BIAS_R),
                              ("a_x", "accel", BIAS_AX), ("a_y", "accel", BIAS_AY)):  # fmt: skip
        yield basis.on_nodes(f"{what} error over time", WORD, kind, [entry], slow)
    late = np.zeros((basis.W, L, SLOW))
    late[:, :2] = basis.velocity()[:, :, None] * np.stack(list(slow.values()), axis=1)[:, None]
    yield function_group("delay of places over time", WORD, "place", list(slow), late)


def by_period(basis: Basis) -> Iterator[FunctionGroup]:
    """Groups of sin and cos at the `PEAKS` largest peaks of the latent acceleration and of its product with thrust."""
    latent = basis.point.z[:, LATENT]
    north, east = body_to_ned(basis.psi, latent[:, 0], latent[:, 1])
    driven = basis.mean(basis.f) @ basis.physics.B.T @ basis.turn
    shares = (driven * latent) @ (1 / np.maximum(latent.std(axis=0), 1e-9) ** 2)
    found = _peaks(basis.clock, {"thrust": shares, "N": north, "E": east, "K": latent[:, 2]})

    def waves(peaks: list[float]) -> Functions:
        return {f"{w.__name__} {hz:.4f} Hz": w(2 * np.pi * hz * basis.clock) for hz in peaks for w in (np.cos, np.sin)}

    shaken = {k: basis.f * v[:, None, None] for k, v in waves(found.pop("thrust")).items()}
    yield basis.of_thrust("thrust, periodic", WORD, shaken)
    for axis, peaks in found.items():
        yield basis.on_nodes(f"force, periodic, {axis}", WORD, "force", basis.axes(axis), waves(peaks))


def _peaks(clock_s: np.ndarray, signals: Functions) -> dict[str, list[float]]:
    """Frequencies [Hz] of the `PEAKS` largest peaks of the periodogram of each signal (W,)."""
    span = min(max(float(np.ptp(clock_s)), 1.0), MOST_S)
    grid = np.arange(*HZ, 0.25 / span)
    spectra = np.abs(np.exp(-2j * np.pi * grid[:, None] * clock_s) @ np.stack(list(signals.values()), axis=1))
    found: dict[str, list[float]] = {name: [] for name in signals}
    for out, power in zip(found.values(), spectra.T, strict=True):
        for _ in range(PEAKS):
            best = int(power.argmax())
            out.append(float(grid[best]))
            power[np.abs(grid - grid[best]) < 2.0 / span] = 0.0
    return found
