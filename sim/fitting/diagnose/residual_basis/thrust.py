"""Basis functions of thrust: of each thruster, all, one beside another, the load, the voltage.

They vary within a window, so their columns are made from hooks.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sim.fitting.diagnose.residual_basis.basis import Basis
from sim.fitting.diagnose.residual_basis.group import FunctionGroup
from sim.fitting.diagnose.selection.residual_forces import battery_voltage

PLAY = (0.02, 0.05, 0.1)  # half widths of play (backlash) over the largest command; assumed
STEP_S = 0.05  # step of the central difference for the rate of thrust; assumed
AGO_S = (0.1, 0.2, 0.4, 0.8)  # delays of past thrust: lags and dead times are shorter than the last; assumed


def by_thruster(basis: Basis) -> Iterator[FunctionGroup]:
    """Groups of each thruster, of all alike, and of pairs."""
    f, n = basis.f, len(basis.names)
    largest = max(float(np.abs(f).max()), 1e-9)
    share = f / largest
    root = np.sign(f) * np.sqrt(np.abs(share))
    step = (_past(basis, -STEP_S / 2) - _past(basis, STEP_S / 2)) / STEP_S
    since = {s: _past(basis, s) - f for s in AGO_S}
    play = {f"play {b:g}": v for b, v in _play(basis, root, largest).items()}
    kinds = (
        ("thrust", "map", {"1": f, "2": f * np.abs(share), "3": f * share**2, "root": root * largest,
                           "modulus": np.abs(f)}),
        ("thrust after changes", "past", play | {"rate": step}),
        ("past thrust", "past", {f"{s:g} s": v for s, v in since.items()}
         | {f"{s:g} s, large": v * np.abs(v) / largest for s, v in since.items()}),
    )  # fmt: skip
    for i, name in enumerate([*basis.names, "all"]):
        mine = np.eye(n)[i] if i < n else np.ones(n)
        words = (f"thruster:{name}",) if i < n else ("thruster",)
        for what, kind, functions in kinds:
            yield basis.of_thrust(f"{what}, {name}", words, functions, kind, mine)
    yield basis.of_thrust("thrust", ("thruster",), {"1": f})
    yield basis.of_thrust("thrust of one for another", ("thruster",), {
        f"{i} and {j}": (f[..., [j]] - f[..., [i]]) * (np.eye(n)[i] - np.eye(n)[j])
        for i in range(n) for j in range(i)}, "mix")  # fmt: skip
    yield basis.of_thrust("thrust of one by another", ("thruster", "load"), {
        f"{i} by {j}": f * np.eye(n)[i] * np.abs(share[..., [j]])
        for i in range(n) for j in range(n) if i != j})  # fmt: skip


def by_load(basis: Basis) -> Iterator[FunctionGroup]:
    """Groups of all thrusters alike over the total load, now and through a lag."""
    total = np.abs(basis.f).sum(axis=2)
    load = total / max(float(total.max()), 1e-9)
    now = {str(k): basis.f * load[..., None] ** k for k in (1, 2, 3)}
    yield basis.of_thrust("thrust over load", ("load",), now)
    past = {f"{s:g} s": basis.f * _remembered(basis, load, s)[:, None, None] for s in (20.0, 60.0)}
    yield basis.of_thrust("thrust over past load", ("load",), past)


def by_voltage(basis: Basis) -> Iterator[FunctionGroup]:
    """Group of all thrusters alike over the battery voltage, where it was logged and varies."""
    logged = battery_voltage(basis.physics, basis.physics.windows.t_s)
    if np.isfinite(logged).all() and np.ptp(logged) > 0:
        off = ((logged - logged.mean()) / np.ptp(logged))[..., None]
        yield basis.of_thrust("thrust over voltage", ("voltage",), {str(k): basis.f * off**k for k in (1, 2)})


def _past(basis: Basis, ago_s: float) -> np.ndarray:
    """Thruster forces `ago_s` earlier, interpolated log by log, (W, K + 1, n) [N]."""
    out, windows = np.empty_like(basis.f), basis.physics.windows
    for log in windows.spans:
        t_s, f = windows.t_s[log].ravel(), basis.f[log].reshape(-1, basis.f.shape[2])
        then = [np.interp(t_s - ago_s, t_s, column) for column in f.T]
        out[log] = np.stack(then, axis=1).reshape(out[log].shape)
    return out


def _play(basis: Basis, root: np.ndarray, largest: float) -> dict[float, np.ndarray]:
    """Change of thrust by play of the commands, (W, K + 1, n) [N] by half width b, log by log:

        held_k = clip(held_{k-1}, s_k - b, s_k + b),   change = held |held| f_max - f

    s: the command over its largest value, taken as the signed `root` of f / f_max, as for a rotor.
    """
    held, widths = np.empty((len(PLAY), *root.shape)), np.array(PLAY)[:, None]
    for log in basis.physics.windows.spans:
        asked = root[log].reshape(-1, root.shape[2])
        kept = np.empty((len(PLAY), *asked.shape))
        now = np.tile(asked[0], (len(PLAY), 1))
        for i, s in enumerate(asked):
            kept[:, i] = now = np.clip(now, s - widths, s + widths)
        held[:, log] = kept.reshape(len(PLAY), *root[log].shape)
    return {b: h * np.abs(h) * largest - basis.f for b, h in zip(PLAY, held, strict=True)}


def _remembered(basis: Basis, load: np.ndarray, memory_s: float) -> np.ndarray:
    """Mean load of each window through a first-order lag of `memory_s`, log by log, (W,)."""
    mean, out = basis.mean(load[..., None])[:, 0], np.empty(basis.W)
    for w in range(basis.W):
        if basis.physics.windows.first[w]:
            out[w] = mean[w]
        else:
            kept = np.exp(-(basis.clock[w] - basis.clock[w - 1]) / memory_s)
            out[w] = mean[w] + (out[w - 1] - mean[w]) * kept
    return out
