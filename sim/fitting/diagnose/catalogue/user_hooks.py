"""A user's hooks: tried once when their file is loaded, and judged at every call of a fit.

What raises, returns nothing or returns another shape than `catalogue.effect` asks for becomes a ConfigError that names
file, line, effect and hook, and not a traceback of the fit, minutes later.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from traceback import extract_tb
from typing import Any

import numpy as np

from companion.core.configuration.tables import ConfigError
from companion.core.configuration.vessel_file import VesselFile
from companion.core.geometry.frames import rotate
from sim.fitting.diagnose.catalogue.effect import Effect, Hook, Scene, TagKinematics, Values
from sim.fitting.engine.parameters import HULL, file_values

INSTANTS = (2, 3)  # windows, instants of the motion by which hooks are tried


def guarded(effect: Effect, file: str) -> Effect:
    """`effect`, and those that a fit of it starts from, with hooks that raise ConfigError where they go wrong."""
    starts = effect.start_entries
    return replace(
        effect,
        hooks={stage: _guarded(hook, stage, effect, file) for stage, hook in effect.hooks.items()},
        start_entries=starts and (lambda: [guarded(start, file) for start in starts()]),
    )


def _guarded(hook: Hook, stage: str, effect: Effect, file: str) -> Hook:
    def call(p: Values, *given: Any) -> Any:
        try:
            made = hook(p, *given)
        except Exception as error:  # any error of a user's hook is reported with the file's name
            why = f"{type(error).__name__}: {error}{_line(error, file)}"
            if isinstance(error, KeyError):
                why += f"; parameters of the effect: {', '.join(q.name for q in effect.parameters)}"
            raise ConfigError(f"{_where(file, effect, stage)}: {why}") from error
        if why := _unfit(stage, given, made):
            raise ConfigError(f"{_where(file, effect, stage)}: {why}")
        return made

    return call


def try_hooks(effect: Effect, vessel: VesselFile, file: str) -> None:
    """Call each hook of the `guarded` effect on a small motion: all parameters zero, then one step away from that.

    ConfigError where that goes wrong, or where numbers come out that are not finite.
    """
    zero = {q.name: 0.0 for q in effect.parameters}
    stepped = {q.name: q.step if q.step <= q.upper else -q.step for q in effect.parameters}
    for stage, hook in effect.hooks.items():
        for words, p in (("all parameters at zero", zero), ("each parameter one step from zero", stepped)):
            with np.errstate(all="ignore"):
                made = hook(p, *_example(stage, vessel))
            numbers = list(made.values()) if stage == "hull" else [] if stage == "maps" else made
            if not np.isfinite(np.asarray(numbers, dtype=float)).all():
                raise ConfigError(f"{_where(file, effect, stage)}: expected finite numbers, {words}: divided by zero?")


def _where(file: str, effect: Effect, stage: str) -> str:
    return f"{file}: effect {effect.id}: hook {stage}"


def _line(error: Exception, file: str) -> str:
    """The last line of the user's file on the way to the error, in words; empty where there is none."""
    lines = [frame.lineno for frame in extract_tb(error.__traceback__) if frame.filename == file]
    return f" (line {lines[-1]})" if lines else ""


def _unfit(stage: str, given: tuple[Any, ...], made: Any) -> str:
    """What is wrong with a hook's result `made` from what it was `given`, in words; empty: nothing."""
    found = f"found {type(made).__name__}: does it end in a return?" if made is None else f"found {type(made).__name__}"
    if stage == "hull":
        if not isinstance(made, Mapping):
            return f"expected coefficients by name, {found}"
        missing = [name for name in HULL if name not in made]
        return f"expected all coefficients, {missing[0]} is missing" if missing else ""
    if stage == "maps":
        return "" if isinstance(made, VesselFile) else f"expected a VesselFile, {found}"
    added = {"water": 2, "force": 3}.get(stage)  # others change the array that they are given last
    wanted = (*given[0].psi_rad.shape, added) if added else np.shape(given[-1])
    if not isinstance(made, np.ndarray) or made.dtype.kind not in "fiu":
        return f"expected an array of numbers of shape {wanted}, {found}"
    if made.shape != wanted and not (added and _spreads(made.shape, wanted)):
        return f"expected an array of shape {wanted}, found {made.shape}"
    return ""


def _spreads(shape: tuple[int, ...], over: tuple[int, ...]) -> bool:
    try:
        return np.broadcast_shapes(shape, over) == over
    except ValueError:
        return False


def _example(stage: str, vessel: VesselFile) -> tuple[Any, ...]:
    """What a hook of `stage` is given beside its parameters: a boat under way. What a fit keeps is read-only."""
    n = len(vessel.thrusters)
    hull: dict[str, float] = dict(zip(HULL, file_values(vessel)[: len(HULL)].tolist(), strict=True))
    match stage:
        case "hull":
            return (hull,)
        case "maps":
            return (vessel,)
        case "pwm":
            return (_ramp((3, n), 1400.0, 1600.0),)
        case "tag":
            tag = _example_tag()
            return tag, tag.place_m.copy()
    t_s = _ramp(INSTANTS, 1.0, 2.0)
    x, nu_dot = _ramp((*INSTANTS, 6), 0.1, 1.0), _ramp((*INSTANTS, 3), 0.01, 0.1)
    water, log = _ramp((*INSTANTS, 2), 0.0, 0.1), np.zeros(INSTANTS[0], dtype=int)
    scene = Scene(t_s, t_s, x, nu_dot, log, _ramp((2,), 0.4, 0.6), 1.5, water, hull)
    readings = {"thrust": _ramp((*INSTANTS, n), -5.0, 5.0), "imu": _ramp((*INSTANTS, 4), 0.1, 1.0).copy()}
    return (scene, readings[stage]) if stage in readings else (scene,)


def _example_tag() -> TagKinematics:
    t_s, psi_rad, place_m = _ramp((4,), 1.0, 2.0), _ramp((4,), 0.1, 1.0), _ramp((4, 2), 1.0, 3.0)

    def carried(x_m: float, y_m: float) -> np.ndarray:
        return np.stack(rotate(psi_rad, np.full(4, x_m), np.full(4, y_m)), axis=1)

    return TagKinematics(
        t_s, t_s, psi_rad, _ramp((4,), 0.05, 0.1), place_m, _ramp((4, 2), 0.1, 0.5), _ramp((4, 2), 0.01, 0.1),
        place_m.mean(axis=0), carried,
    )  # fmt: skip


def _ramp(shape: tuple[int, ...], first: float, last: float) -> np.ndarray:
    """Numbers that differ, from `first` to `last`, read-only."""
    made = np.linspace(first, last, int(np.prod(shape))).reshape(shape)
    made.flags.writeable = False
    return made
