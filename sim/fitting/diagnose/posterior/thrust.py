"""Thruster forces in all windows, with effects on commands (`pwm`) and on force maps, dead time and lag (`maps`).

Forces of one set of effects are exact and cached; effects too small for a name are linear about zero:

    f(theta) = f(large) + sum over small parameters of theta_j (f(step_j) - f(0)) / step_j * (gain left by `large`)
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from dataclasses import replace as dataclass_replace
from typing import Any

import numpy as np
from msgspec.structs import replace

from companion.core.configuration.vessel_file import Propulsion, VesselFile
from companion.logs.runs.run import Run
from sim.fitting.diagnose.catalogue.effect import Effect, Values
from sim.fitting.diagnose.posterior.parameter_values import ParameterValues, secant_steps, values_by_name
from sim.fitting.engine.thrust.battery import PulseSeries, commands_of, pulses_of
from sim.fitting.engine.thrust.history import SlewedHistory, ThrustCommands, ThrustHistory
from sim.fitting.engine.windows import Windows

KEPT = 48  # results a cache keeps: half a megabyte each for a log of ten minutes


@dataclass(frozen=True)
class ThrusterForces:
    """Thruster forces [N] at steps `f` (W, K+1, n) and between them `middle` (W, K, n), before hooks on thrust."""

    f: np.ndarray
    middle: np.ndarray

    def mid_excess(self) -> np.ndarray:
        """Force in the middle of each step beyond the mean of its ends, (W, K, n)."""
        return self.middle - (self.f[:, :-1] + self.f[:, 1:]) / 2

    def minus(self, other: ThrusterForces) -> ThrusterForces:
        """The difference to `other`."""
        return ThrusterForces(self.f - other.f, self.middle - other.middle)

    def plus(self, other: ThrusterForces) -> ThrusterForces:
        """The sum with `other`."""
        return ThrusterForces(self.f + other.f, self.middle + other.middle)

    def times(self, share: float | np.ndarray) -> ThrusterForces:
        """Forces times a factor, common or of each thruster (n,)."""
        return ThrusterForces(share * self.f, share * self.middle)


class WindowThrust:
    """Thrusters of `vessel` under the commands of `runs`. `means_s`: by run, duration a sample is averaged over [s]."""

    def __init__(self, runs: Sequence[Run], vessel: VesselFile, windows: Windows, means_s: Sequence[float]):
        self.vessel, self.windows, self._means_s = vessel, windows, means_s
        self._pulses = [pulses_of(run, vessel) for run in runs]
        self._middle = windows.t_s[:, :-1] + windows.h_s / 2
        self._commands, self._driven = _Cache(self._steady), _Cache(self._averaged)

    def forces(self, effects: Sequence[Effect], theta: ParameterValues) -> ThrusterForces:
        """Thruster forces at theta; effects too small for a name by one cached secant each from zero."""
        large = self._large(effects, theta)
        forces = self._exact_forces(effects, large)
        small = [e for e, _ in values_by_name(effects, theta, "pwm", "maps") if e.id not in large]
        for each in secant_steps(small, {}):
            for step in each.steps.values():
                share = float(theta[each.effect.id] @ (step != 0)) / float(step.sum())
                forces = forces.plus(self._change_from_zero(effects, large, each.effect, step).times(share))
        return forces

    def change(
        self, effects: Sequence[Effect], theta: ParameterValues, effect: Effect, step: np.ndarray
    ) -> ThrusterForces:
        """Change of the forces at theta by `step` (k,) of the parameters of `effect`."""
        large = self._large(effects, theta)
        if effect.id not in large:
            return self._change_from_zero(effects, large, effect, step)
        stepped = {**large, effect.id: large[effect.id] + step}
        return self._exact_forces(effects, stepped).minus(self._exact_forces(effects, large))

    def _large(self, effects: Sequence[Effect], theta: ParameterValues) -> ParameterValues:
        """The part of theta that is computed exactly: effects larger than their smallest size worth a name."""
        return {e.id: theta[e.id] for e, _ in values_by_name(effects, theta, "pwm", "maps") if e.size(theta[e.id]) >= 1}

    def _change_from_zero(
        self, effects: Sequence[Effect], large: ParameterValues, effect: Effect, step: np.ndarray
    ) -> ThrusterForces:
        """Change of the forces by `step` from zero, beside effects that are present as a whole only.

        Times the ratio of each thruster's gain under `large` to that of the file.
        """
        present = [e for e in effects if e.id in large and e.all_or_nothing]
        present_values = {e.id: e.wide_prior()[1] for e in present}
        unit = self._exact_forces([*present, effect], {**present_values, effect.id: step}).minus(
            self._exact_forces(present, present_values)
        )
        return unit.times(self._gain_ratio(effects, large))

    def _gain_ratio(self, effects: Sequence[Effect], large: ParameterValues) -> np.ndarray:
        """Gain of each thruster with the effects `large` on the maps over that of the file, (n,); 1 where that is 0."""
        both = zip(self._mapped(effects, large).thrusters, self.vessel.thrusters, strict=True)
        return np.array([now.gain / was.gain if was.gain else 1.0 for now, was in both])

    def _mapped(self, effects: Sequence[Effect], theta: ParameterValues) -> VesselFile:
        vessel = self.vessel
        for effect, p in values_by_name(effects, theta, "maps"):
            vessel = effect.hooks["maps"](p, vessel)
        return vessel

    def _exact_forces(self, effects: Sequence[Effect], theta: ParameterValues) -> ThrusterForces:
        vessel = self._mapped(effects, theta)
        pulses = values_by_name(effects, theta, "pwm")
        key = (tuple(vessel.force_maps.items()), vessel.thrusters, tuple((e.id, *p.values()) for e, p in pulses))
        return self._driven((key, vessel.propulsion), key, vessel, pulses)

    def _averaged(self, key: Hashable, vessel: VesselFile, pulses: Sequence[tuple[Effect, Values]]) -> ThrusterForces:
        """Forces with the lag, dead time and rate limit of `vessel`, averaged like samples.

        `key`: of the steady forces of the commands, which depend on neither.
        """
        commands = self._commands(key, vessel, pulses)
        gains, f, middle = np.array([t.gain for t in vessel.thrusters]), [], []
        for span, own, width in zip(self.windows.spans, commands, self._means_s, strict=True):
            history = _history(dataclass_replace(own, force_n=own.force_n * gains), vessel.propulsion)
            f.append(_mean(history, self.windows.t_s[span], width))
            middle.append(_mean(history, self._middle[span], width))
        driven = ThrusterForces(np.concatenate(f), np.concatenate(middle))
        for kept in (driven.f, driven.middle):
            kept.flags.writeable = False  # cached arrays are shared
        return driven

    def _steady(self, vessel: VesselFile, pulses: Sequence[tuple[Effect, Values]]) -> Sequence[ThrustCommands]:
        """By run, steady forces of the commands through the force maps of `vessel`, without lag and dead time."""
        vessel = replace(vessel, propulsion=self.vessel.propulsion)
        return [commands_of(_changed(own, pulses), vessel) for own in self._pulses]


def _history(commands: ThrustCommands, propulsion: Propulsion) -> ThrustHistory | SlewedHistory:
    if propulsion.slew_N_s is None:
        return ThrustHistory(commands, propulsion.dead_time_s, propulsion.lag_s)
    return SlewedHistory(commands, propulsion.dead_time_s, propulsion.lag_s, propulsion.slew_N_s)


def _mean(history: ThrustHistory | SlewedHistory, t_s: np.ndarray, width_s: float) -> np.ndarray:
    """Forces at `t_s` averaged over `width_s` round each instant, as the samples that they are compared with are."""
    if not width_s:
        return history.force(t_s)
    total = history.force(t_s - 0.4 * width_s)
    for share in (-0.2, 0.0, 0.2, 0.4):
        total += history.force(t_s + share * width_s)
    return total / 5


class _Cache:
    """Least recently used cache of a function's results, by key."""

    def __init__(self, function: Any):
        self._function, self._kept = function, {}

    def __call__(self, key: Hashable, *args: Any) -> Any:
        result = self._kept.pop(key) if key in self._kept else self._function(*args)
        self._kept[key] = result
        if len(self._kept) > KEPT:
            self._kept.pop(next(iter(self._kept)))
        return result


def _changed(pulses: PulseSeries, effects: Sequence[tuple[Effect, Values]]) -> PulseSeries:
    """Pulse widths with effects applied to them."""
    pwm_us = pulses.pwm_us
    for effect, p in effects:
        pwm_us = effect.hooks["pwm"](p, pwm_us)
    return dataclass_replace(pulses, pwm_us=pwm_us)
