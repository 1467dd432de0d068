"""Forces of the thrusters in all windows, with effects on commands, force maps, dead time and lag."""

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

KEPT = 48  # results by cache: a log of ten minutes takes half a megabyte each


@dataclass(frozen=True)
class ThrusterForces:
    """Thruster forces at nodes (W, K+1, n) and mid-steps (W, K, n) before any hook on them."""

    f: np.ndarray
    middle: np.ndarray

    def mid_excess(self) -> np.ndarray:
        """What the middle of each step has beyond the mean of its ends, (W, K, n)."""
        return self.middle - (self.f[:, :-1] + self.f[:, 1:]) / 2

    def minus(self, other: ThrusterForces) -> ThrusterForces:
        """Without those of `other`."""
        return ThrusterForces(self.f - other.f, self.middle - other.middle)

    def plus(self, other: ThrusterForces) -> ThrusterForces:
        """With those of `other`."""
        return ThrusterForces(self.f + other.f, self.middle + other.middle)

    def times(self, share: float | np.ndarray) -> ThrusterForces:
        """A share of all, or of each thruster's (n,)."""
        return ThrusterForces(share * self.f, share * self.middle)


class WindowThrust:
    """The thrusters of `vessel` under the commands of `runs`. `means_s`: by run, over how long samples are averaged."""

    def __init__(self, runs: Sequence[Run], vessel: VesselFile, windows: Windows, means_s: Sequence[float]):
        self.vessel, self.windows, self._means_s = vessel, windows, means_s
        self._pulses = [pulses_of(run, vessel) for run in runs]
        self._middle = windows.t_s[:, :-1] + windows.h_s / 2
        self._commands, self._driven = _Cache(self._steady), _Cache(self._averaged)

    def forces(self, effects: Sequence[Effect], theta: ParameterValues) -> ThrusterForces:
        """Thruster forces with effects on commands, force maps, dead time and lag.

        Effects too small for a name are taken as linear: one secant each from nil, which is kept.
        """
        large = self._large(effects, theta)
        forces = self._exact(effects, large)
        small = [e for e, _ in values_by_name(effects, theta, "pwm", "maps") if e.id not in large]
        for each in secant_steps(small, {}):
            for step in each.steps.values():
                share = float(theta[each.effect.id] @ (step != 0)) / float(step.sum())
                forces = forces.plus(self._from_nil(effects, large, each.effect, step).times(share))
        return forces

    def change(
        self, effects: Sequence[Effect], theta: ParameterValues, effect: Effect, step: np.ndarray
    ) -> ThrusterForces:
        """What `step` of `effect` changes of the forces at theta."""
        large = self._large(effects, theta)
        if effect.id not in large:
            return self._from_nil(effects, large, effect, step)
        there = {**large, effect.id: large[effect.id] + step}
        return self._exact(effects, there).minus(self._exact(effects, large))

    def _large(self, effects: Sequence[Effect], theta: ParameterValues) -> ParameterValues:
        """Those of `theta` that are not taken as linear."""
        return {e.id: theta[e.id] for e, _ in values_by_name(effects, theta, "pwm", "maps") if e.size(theta[e.id]) >= 1}

    def _from_nil(
        self, effects: Sequence[Effect], large: ParameterValues, effect: Effect, step: np.ndarray
    ) -> ThrusterForces:
        """What `step` changes of the forces with no other effect about but those that are there as a whole.

        Of the force that large gains leave to each thruster, where these are in the file's own maps.
        """
        about = [e for e in effects if e.id in large and e.all_or_nothing]
        wholly = {e.id: e.wide_prior()[1] for e in about}
        unit = self._exact([*about, effect], {**wholly, effect.id: step}).minus(self._exact(about, wholly))
        return unit.times(self._left(effects, large))

    def _left(self, effects: Sequence[Effect], large: ParameterValues) -> np.ndarray:
        """Share of each thruster's gain that effects on the maps leave, (n,): all of a dead one's nothing."""
        both = zip(self._mapped(effects, large).thrusters, self.vessel.thrusters, strict=True)
        return np.array([now.gain / was.gain if was.gain else 1.0 for now, was in both])

    def _mapped(self, effects: Sequence[Effect], theta: ParameterValues) -> VesselFile:
        vessel = self.vessel
        for effect, p in values_by_name(effects, theta, "maps"):
            vessel = effect.hooks["maps"](p, vessel)
        return vessel

    def _exact(self, effects: Sequence[Effect], theta: ParameterValues) -> ThrusterForces:
        vessel = self._mapped(effects, theta)
        pulses = values_by_name(effects, theta, "pwm")
        key = (tuple(vessel.force_maps.items()), vessel.thrusters, tuple((e.id, *p.values()) for e, p in pulses))
        return self._driven((key, vessel.propulsion), key, vessel, pulses)

    def _averaged(self, key: Hashable, vessel: VesselFile, pulses: Sequence[tuple[Effect, Values]]) -> ThrusterForces:
        """Forces at the lag and the dead time of `vessel`. `key`: of the commands, which know neither."""
        commands = self._commands(key, vessel, pulses)
        gains, f, middle = np.array([t.gain for t in vessel.thrusters]), [], []
        for span, own, width in zip(self.windows.spans, commands, self._means_s, strict=True):
            history = _history(dataclass_replace(own, force_n=own.force_n * gains), vessel.propulsion)
            f.append(_mean(history, self.windows.t_s[span], width))
            middle.append(_mean(history, self._middle[span], width))
        driven = ThrusterForces(np.concatenate(f), np.concatenate(middle))
        for kept in (driven.f, driven.middle):
            kept.flags.writeable = False  # they are handed out again
        return driven

    def _steady(self, vessel: VesselFile, pulses: Sequence[tuple[Effect, Values]]) -> Sequence[ThrustCommands]:
        vessel = replace(vessel, propulsion=self.vessel.propulsion)
        return [commands_of(_changed(own, pulses), vessel) for own in self._pulses]


def _history(commands: ThrustCommands, propulsion: Propulsion) -> ThrustHistory | SlewedHistory:
    if propulsion.slew_N_s is None:
        return ThrustHistory(commands, propulsion.dead_time_s, propulsion.lag_s)
    return SlewedHistory(commands, propulsion.dead_time_s, propulsion.lag_s, propulsion.slew_N_s)


def _mean(history: ThrustHistory | SlewedHistory, t_s: np.ndarray, width_s: float) -> np.ndarray:
    """Forces averaged over `width_s` round `t_s`, as the samples that they are compared with are."""
    if not width_s:
        return history.force(t_s)
    total = history.force(t_s - 0.4 * width_s)
    for share in (-0.2, 0.0, 0.2, 0.4):
        total += history.force(t_s + share * width_s)
    return total / 5


class _Cache:
    """The results of a function that were asked for last, by key."""

    def __init__(self, function: Any):
        self._function, self._kept = function, {}

    def __call__(self, key: Hashable, *args: Any) -> Any:
        found = self._kept.pop(key) if key in self._kept else self._function(*args)
        self._kept[key] = found
        if len(self._kept) > KEPT:
            self._kept.pop(next(iter(self._kept)))
        return found


def _changed(pulses: PulseSeries, effects: Sequence[tuple[Effect, Values]]) -> PulseSeries:
    """As they are with effects on them."""
    pwm_us = pulses.pwm_us
    for effect, p in effects:
        pwm_us = effect.hooks["pwm"](p, pwm_us)
    return dataclass_replace(pulses, pwm_us=pwm_us)
