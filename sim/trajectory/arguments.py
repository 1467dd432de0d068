"""What `simulate` is given, checked and brought to one shape: trajectories x samples x width, 1 if nothing varies."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.core.constants import NEUTRAL_US
from companion.core.model.actuators.propulsion import channels_of
from sim.trajectory.step import GONE, TURNED, Drive, StepKind, parameters_of

STABLE = 2.5
"""Longest step of Runge-Kutta over the lag of the thrusters; it diverges from 2.78 on."""


@dataclass(frozen=True)
class Surroundings:
    """What water and air do; None: as the vessel file has it, without any force.

    Each a number, a series (k,), a column (m, 1) or (m, k): k samples, m trajectories. Directions in degrees from
    north: current towards, wind from. In wind of 0 m/s the air brakes a boat that moves, as in the simulated world;
    None leaves it out. `force_n` [N, N, N m] in body axes, (3,), (k, 3), (m, 1, 3) or (m, k, 3): waves, a tow.
    """

    V_c_m_s: Any = None
    beta_c_deg: Any = 0.0
    V_w_m_s: Any = None
    beta_w_deg: Any = 0.0
    force_n: Any = None


@dataclass(frozen=True)
class Task:
    """Ready to run: start (m, 6 + n), constants (m, q), series each (m or 1, k, width). `one`: a single trajectory."""

    kind: StepKind
    start: np.ndarray
    constants: np.ndarray
    series: tuple[np.ndarray, ...]
    samples: int
    one: bool


def task(
    vessel: VesselFile,
    x0: Any,
    drive: np.ndarray,
    drive_kind: Drive,
    dt_s: float,
    *,
    voltage_v: Any = None,
    around: Surroundings | None = None,
    parameters: Mapping[str, Any] | None = None,
    substeps: int = 1,
) -> Task:
    """Everything checked. `drive` (k, n) or (m, k, n) as it acts on the boat. Raises ValueError."""
    around, free = around or Surroundings(), dict(parameters or {})
    start, n, k = _start(x0, len(vessel.controls)), len(vessel.controls), drive.shape[-2]
    columns: dict[str, np.ndarray] = {"drive": drive if drive.ndim == 3 else drive[None]}
    if drive_kind != "force":
        columns["voltage_v"] = _column("voltage_v", voltage_v, k)
        if not (columns["voltage_v"] > 0).all():
            raise ValueError("voltage_v: expected more than 0 V")
    for name, speed, direction in (
        ("current", ("V_c_m_s", around.V_c_m_s), ("beta_c_deg", around.beta_c_deg)),
        ("wind", ("V_w_m_s", around.V_w_m_s), ("beta_w_deg", around.beta_w_deg)),
    ):
        if speed[1] is not None:
            columns[name] = np.concatenate(np.broadcast_arrays(_column(*speed, k), _column(*direction, k)), axis=2)
    if around.V_c_m_s is None and _turns(vessel, free):
        columns["t_s"] = _column("t_s", dt_s * np.arange(k), k)
    if around.force_n is not None:
        columns["force_n"] = _rows("force_n", around.force_n, k, 3)
    _known(vessel, free)
    numbers = {name: _column(f"parameters[{name!r}]", np.atleast_1d(value)[:, None], 1) for name, value in free.items()}
    counts = {name: len(a) for name, a in {"x0": start, **columns, **numbers}.items() if len(a) > 1}
    if len(set(counts.values())) > 1:
        raise ValueError(f"numbers of trajectories do not agree: {counts}")
    m = max(counts.values(), default=1)
    _step(vessel, dt_s, substeps, numbers)
    given = tuple((name, a.shape[2], name == "drive" or a.shape[1] > 1) for name, a in columns.items())
    constant = [a for (_, _, varies), a in zip(given, columns.values(), strict=True) if not varies]
    head = np.full((1, 1, 1), float(dt_s))
    constants = [np.broadcast_to(a[:, 0], (m, a.shape[2])) for a in (head, *constant, *numbers.values())]
    series = [a for (_, _, varies), a in zip(given, columns.values(), strict=True) if varies]
    return Task(
        StepKind(drive_kind, given, tuple(free), substeps),
        np.array(np.broadcast_to(start, (m, 6 + n))),
        np.concatenate(constants, axis=1),
        tuple(np.ascontiguousarray(a) for a in series),
        k,
        np.ndim(x0) == 1 and not counts and drive.ndim == 2,
    )


def delayed(vessel: VesselFile, pwm_us: Any, before_us: Any, dt_s: float) -> np.ndarray:
    """Pulse widths as they act after the dead time, (k, n) or (m, k, n). Raises ValueError."""
    pwm = _drive(vessel, "pwm_us", pwm_us)
    before = None if before_us is None else _drive(vessel, "before_us", before_us)
    if pwm.ndim == 3 and before is not None and before.ndim == 3 and len(pwm) != len(before):
        raise ValueError(f"before_us: expected as many trajectories as pwm_us, {len(pwm)}; found {len(before)}")
    sample_ns = max(1, round(_seconds(dt_s) * 1e9))
    late = [-(-round(c.dead_time_s * 1e9) // sample_ns) for c in channels_of(vessel)]
    if len(set(late)) == 1:
        return _later(pwm, before, late[0])
    columns = [_later(pwm[..., [i]], None if before is None else before[..., [i]], k) for i, k in enumerate(late)]
    return np.concatenate(np.broadcast_arrays(*columns), axis=-1)


def _later(pwm: np.ndarray, before: np.ndarray | None, late: int) -> np.ndarray:
    """Pulse widths `late` samples later."""
    if not late:
        return pwm
    if before is None:
        before = np.full((late, pwm.shape[-1]), float(NEUTRAL_US))
    elif before.shape[-2] < late:
        raise ValueError(f"before_us: the dead time needs {late} samples, found {before.shape[-2]}")
    out = np.empty((*max(pwm.shape[:-2], before.shape[:-2]), *pwm.shape[-2:]))
    early = min(late, pwm.shape[-2])
    out[..., :early, :] = before[..., before.shape[-2] - late :, :][..., :early, :]
    out[..., early:, :] = pwm[..., : pwm.shape[-2] - early, :]
    return out


def forces(vessel: VesselFile, f_cmd_n: Any) -> np.ndarray:
    """Commands [N; angles rad], (k, n) or (m, k, n). Raises ValueError."""
    return _drive(vessel, "f_cmd_n", f_cmd_n)


def _drive(vessel: VesselFile, name: str, value: Any) -> np.ndarray:
    n = len(vessel.controls)
    array = _numbers(name, value)
    if array.ndim not in (2, 3) or array.shape[-1] != n or array.shape[-2] < 1:
        what = f"{len(vessel.thrusters)} thrusters" + (f", {len(vessel.servos)} servos" if vessel.servos else "")
        raise ValueError(f"{name}: expected (k, {n}) or (m, k, {n}), k > 0: {what}; found {array.shape}")
    return array


def _start(x0: Any, n: int) -> np.ndarray:
    start = _numbers("x0", x0)
    if start.ndim not in (1, 2) or start.shape[-1] not in (6, 6 + n) or not start.size:
        raise ValueError(f"x0: expected (6,) or ({6 + n},), or (m, 6) or (m, {6 + n}); found {start.shape}")
    start = np.atleast_2d(start)
    if (np.abs(start[:, 3:6]) >= GONE).any() or (np.abs(start[:, 2]) >= TURNED).any():
        raise ValueError(f"x0: no boat: speeds of {GONE:g} and more, or a heading of {TURNED:g} rad and more")
    return np.hstack([start, np.zeros((len(start), 6 + n - start.shape[1]))])


def _step(vessel: VesselFile, dt_s: float, substeps: int, numbers: Mapping[str, np.ndarray]) -> None:
    if substeps < 1 or substeps != int(substeps):
        raise ValueError(f"substeps: expected a whole number above 0, found {substeps}")
    own = [one.lag_s for one in vessel.controls if one.lag_s is not None]
    lag = min([float(numbers.get("propulsion.lag_s", np.array(vessel.propulsion.lag_s)).min()), *own])
    if lag <= 0 or _seconds(dt_s) / substeps > STABLE * lag:
        raise ValueError(f"dt_s / substeps: expected at most {STABLE:g} x lag_s = {STABLE * lag:g} s; more substeps")


def _seconds(dt_s: float) -> float:
    if not (np.isfinite(dt_s) and dt_s >= 1e-9):
        raise ValueError(f"dt_s: expected seconds above 0, found {dt_s}")
    return float(dt_s)


def _turns(vessel: VesselFile, free: Mapping[str, Any]) -> bool:
    """Whether the file's own current turns, or may."""
    own = vessel.terms.get("current", {})
    return bool(own.get("turn_deg_s")) or "terms.current.turn_deg_s" in free


def _known(vessel: VesselFile, free: Mapping[str, Any]) -> None:
    known = parameters_of(vessel) if free else {}
    for name in free:
        if name not in known:
            raise ValueError(f"parameters: no number {name!r} of this vessel; there are {', '.join(known)}")


def _numbers(name: str, value: Any) -> np.ndarray:
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise ValueError(f"{name}: expected numbers, found {value!r:.60}") from None
    if not np.isfinite(array.sum()) and not np.isfinite(array).all():
        where = ", ".join(map(str, np.argwhere(~np.isfinite(array))[0]))
        raise ValueError(f"{name}: not a finite number at [{where}]")
    return array


def _column(name: str, value: Any, k: int) -> np.ndarray:
    """A number, (k,), (m, 1) or (m, k) as (m or 1, k or 1, 1)."""
    array = _numbers(name, value)
    if array.ndim > 2 or (array.ndim and array.shape[-1] not in (1, k)) or not array.size:
        raise ValueError(f"{name}: expected a number, ({k},), (m, 1) or (m, {k}); found {array.shape}")
    return np.atleast_2d(array)[..., None]


def _rows(name: str, value: Any, k: int, width: int) -> np.ndarray:
    """(width,), (k, width), (m, 1, width) or (m, k, width) as (m or 1, k or 1, width)."""
    array = _numbers(name, value)
    ok = 1 <= array.ndim <= 3 and array.shape[-1] == width and (array.ndim == 1 or array.shape[-2] in (1, k))
    if not ok or not array.size:
        raise ValueError(f"{name}: expected ({width},), ({k}, {width}) or (m, {k}, {width}); found {array.shape}")
    return array.reshape((1,) * (3 - array.ndim) + array.shape)
