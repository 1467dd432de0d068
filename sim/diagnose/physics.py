"""Whole logs moved by the one vessel model with any set of effects in it, and what each effect's parameters change.

Windows are integrated from their nodes (`sim.identify.structured.data`). Effects of the hull enter the model's
coefficients, moving water its relative velocity; forces and thruster effects that depend on the motion are taken along
the trajectory of the pass before, which two passes settle. Columns are secants: (with - without) / step, along the
trajectory, for accelerations; the motion's own Jacobian then carries them on (`linear`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from dataclasses import replace as dataclass_replace
from typing import Any

import casadi as ca
import numpy as np
import polars as pl
from msgspec.structs import replace

from companion.core.dynamics import eta_dot
from companion.core.thrusters import configuration_matrix
from companion.core.vessel import StructuredModel
from companion.core.vessel_file import Propulsion, VesselFile
from sim.diagnose.clock import clock_start
from sim.diagnose.effect import Effect, Scene, Sight, Values
from sim.diagnose.thin import thinned
from sim.identify.run import Run
from sim.identify.structured.battery import commands_of
from sim.identify.structured.data import Windows, cut
from sim.identify.structured.model import N_HULL, Batch, symbolic_model
from sim.identify.structured.noise import LATENT, STATE
from sim.identify.structured.parameters import HULL, Parameters, file_values
from sim.identify.structured.thrust import Commands, SlewedHistory, ThrustHistory

Theta = Mapping[str, np.ndarray]
"""Parameters by effect id; effects that are not in it do nothing."""
MAX_STEP_S = 0.1  # of integration: yaw has a time constant of about 2 s, and thrust is the mean over a step
NUDGES = (0.05, 0.05, 0.01, 0.01, 0.01, 0.01)  # of x y psi u v r, for the slopes of forces
NEARBY = 0.1  # of the value of a far effect that is believed in: how far its secant reaches
TURN = np.array([[0.0, -1.0], [1.0, 0.0]])


@dataclass(frozen=True)
class Forces:
    """Thruster forces at nodes (W, K+1, n) and mid-steps (W, K, n) before any hook on them."""

    f: np.ndarray
    middle: np.ndarray


@dataclass(frozen=True)
class State:
    """All windows in motion: x (W, K+1, 6), nu_dot, A = d(x_dot)/dx, M^-1 (3, 3), and what drove them.

    `given`: accelerations that came from outside the effects, see `Physics.move`; `by`: ids of these.
    """

    x: np.ndarray
    nu_dot: np.ndarray
    A: np.ndarray
    M_inv: np.ndarray
    tau: np.ndarray
    water: np.ndarray
    forces: Forces
    hull: np.ndarray
    given: np.ndarray | None
    by: frozenset[str]


class Physics:
    """The model of `vessel` on the windows of `runs`."""

    def __init__(self, runs: Sequence[Run], vessel: VesselFile, window_s: float):
        fewer = [thinned(run) for run in runs]
        self.runs, self.vessel = tuple(run for run, _ in fewer), vessel
        self._means_s = tuple(width for _, width in fewer)
        self.windows: Windows = cut(self.runs, vessel, window_s, max_step_s=MAX_STEP_S)
        self.parameters = Parameters(vessel)
        self.q = file_values(vessel)
        self.B = configuration_matrix(vessel)
        W, K = self.windows.size
        self._rollout, self._rates, self._slopes = _compiled(vessel, K, W)
        starts = np.array([clock_start(run, runs) - run.table["t_s"][0] for run in runs])
        self.clock_s = self.windows.t_s + starts[self.windows.run][:, None]
        self.fix_clock_s = self.windows.fixes.t_s + starts[self.windows.fixes.run]
        self.middle_s = float(self.clock_s.min() + self.clock_s.max()) / 2
        self.centre_m = self.windows.fixes.place_m.mean(axis=0)
        self._middle = self.windows.t_s[:, :-1] + self.windows.h_s / 2
        self._commands = _Cache(self._steady)
        self._unit = _Cache(self._difference)

    def hull(self, effects: Sequence[Effect], theta: Theta) -> np.ndarray:
        """Coefficients (12,) in the order of HULL with the effects in them."""
        c: Values = dict(zip(HULL, map(float, self.q[:N_HULL]), strict=True))
        for effect, p in values_of(effects, theta, "hull"):
            c = effect.hooks["hull"](p, c)
        return np.array([c[name] for name in HULL])

    def forces(self, effects: Sequence[Effect], theta: Theta) -> Forces:
        """Thruster forces with effects on commands, force maps, dead time and lag.

        Effects too small for a name are taken as linear: one secant each from nil, which is kept.
        """
        small = {e.id for e, _ in values_of(effects, theta, "pwm", "maps") if e.size(theta[e.id]) < 1}
        large = {id_: values for id_, values in theta.items() if id_ not in small}
        forces = self._exact(effects, large)
        for effect, _now, step in secants([e for e in effects if e.id in small], {}):
            share = float(theta[effect.id] @ (step != 0)) / float(step.sum())
            unit = self._from_nil(effect, step)
            forces = Forces(forces.f + share * unit.f, forces.middle + share * unit.middle)
        return forces

    def _exact(self, effects: Sequence[Effect], theta: Theta) -> Forces:
        vessel = self.vessel
        for effect, p in values_of(effects, theta, "maps"):
            vessel = effect.hooks["maps"](p, vessel)
        pulses = values_of(effects, theta, "pwm")
        trims = tuple(t.trim_us for t in vessel.thrusters)
        key = (tuple(vessel.force_maps.items()), trims, tuple((e.id, *p.values()) for e, p in pulses))
        commands = self._commands(key, vessel, pulses)
        gains, propulsion = np.array([t.gain for t in vessel.thrusters]), vessel.propulsion
        f, middle = [], []
        for span, own, width in zip(self.windows.spans, commands, self._means_s, strict=True):
            history = _history(own, propulsion)
            f.append(_mean(history, self.windows.t_s[span], width))
            middle.append(_mean(history, self._middle[span], width))
        return Forces(np.concatenate(f) * gains, np.concatenate(middle) * gains)

    def _steady(self, vessel: VesselFile, pulses: Sequence[tuple[Effect, Values]]) -> Sequence[Commands]:
        runs = self.runs
        for effect, p in pulses:
            runs = tuple(_repulsed(run, vessel, effect, p) for run in runs)
        return [commands_of(run, replace(vessel, propulsion=self.vessel.propulsion)) for run in runs]

    def move(
        self,
        effects: Sequence[Effect],
        theta: Theta,
        z: np.ndarray,
        before: State | None,
        given: np.ndarray | None = None,
    ) -> State:
        """Trajectories from nodes z (W, L); `before`: a motion near this one, for effects that depend on it.

        `given`: accelerations (W, K+1, 3) of what is not among `effects`.
        """
        settle = any(values_of(effects, theta, "thrust", "force", "water"))
        felt = [e for e in effects if e.id in theta and {"thrust", "force"} & set(e.hooks) and e.size(theta[e.id]) >= 1]
        for _ in range(3 if felt else 2 if settle else 1):
            before = self._pass(effects, theta, z, before, given)
        assert before is not None
        return dataclass_replace(before, A=before.A + self._feedback(felt, theta, before)) if felt else before

    def _feedback(self, effects: Sequence[Effect], theta: Theta, state: State) -> np.ndarray:
        """What the forces of `effects` add to A, (W, K+1, 6, 6): they depend on the motion that they change."""
        scene, out = self.scene(state), np.zeros_like(state.A)
        now = self.extra(effects, theta, scene, state.forces.f)[0]
        for j, nudge in enumerate(NUDGES):
            x = state.x.copy()
            x[..., j] += nudge
            there = self.extra(effects, theta, dataclass_replace(scene, x=x), state.forces.f)[0]
            out[..., 3:, j] = (there - now) / nudge @ state.M_inv.T
        return out

    def _pass(
        self, effects: Sequence[Effect], theta: Theta, z: np.ndarray, before: State | None, given: np.ndarray | None
    ) -> State:
        W, K = self.windows.size
        forces, hull = self.forces(effects, theta), self.hull(effects, theta)
        tau, water = forces.f @ self.B.T, np.zeros((W, K + 1, 2))
        tau_mid = forces.middle @ self.B.T
        if before is not None:
            extra = self.extra(effects, theta, self.scene(before), forces.f)
            more = extra[0] if given is None else extra[0] + given @ np.linalg.inv(before.M_inv).T
            tau, water = forces.f @ self.B.T + more, extra[1]
            tau_mid = tau_mid + (more[:, :-1] + more[:, 1:]) / 2
        drive = np.concatenate([tau[:, :-1], tau_mid, tau[:, 1:]], axis=2).reshape(W, -1)
        flow = np.concatenate([water[:, :-1], water[:, 1:]], axis=2).reshape(W, -1)
        d = z[:, LATENT]
        (after,) = self._rollout(z[:, STATE], np.tile(hull, (W, K)), drive, flow, np.tile(d, (1, K)), self.windows.h_s)
        x = np.empty((W, K + 1, 6))
        x[:, 0] = z[:, STATE]
        x[:, 1:] = after.reshape(W, K, 6)
        A, M_inv, nu_dot = self._rates(*self._flat(x, hull, tau, water, np.repeat(d, K + 1, axis=0)))
        A, M_inv = A.reshape(W, K + 1, 6, 6).swapaxes(2, 3).copy(), M_inv[0].reshape(3, 3).T.copy()
        ids = frozenset(e.id for e in effects)
        return State(x, nu_dot.reshape(W, K + 1, 3).copy(), A, M_inv, tau, water, forces, hull, given, ids)

    def remainder(self, effects: Sequence[Effect], theta: Theta, state: State, d: np.ndarray) -> np.ndarray:
        """What of the accelerations (W, K+1, 3) in `state` does not come from `effects` nor from d (W, 3)."""
        if state.given is not None and state.by == frozenset(e.id for e in effects):
            return state.given
        W, K = self.windows.size
        forces = self.forces(effects, theta)
        more, water = self.extra(effects, theta, self.scene(state), forces.f)
        drive = self._flat(state.x, self.hull(effects, theta), forces.f @ self.B.T + more, water)
        _, _, nu_dot = self._rates(*drive, np.repeat(d, K + 1, axis=0))
        return state.nu_dot - nu_dot.reshape(W, K + 1, 3)

    def _flat(self, x: np.ndarray, hull: np.ndarray, tau: np.ndarray, water: np.ndarray, *more: np.ndarray):
        n = x.shape[0] * x.shape[1]
        return x.reshape(n, 6), np.tile(hull, (n, 1)), tau.reshape(n, 3), water.reshape(n, 2), *more

    def extra(
        self, effects: Sequence[Effect], theta: Theta, scene: Scene, f: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Force (W, K+1, 3) and water velocity (W, K+1, 2) that hooks add along `scene`; f: forces before them."""
        hooked, tau, water = f, np.zeros((*f.shape[:2], 3)), np.zeros((*f.shape[:2], 2))
        for effect, p in values_of(effects, theta, "thrust"):
            hooked = effect.hooks["thrust"](p, scene, hooked)
        tau += (hooked - f) @ self.B.T
        for effect, p in values_of(effects, theta, "force"):
            tau += effect.hooks["force"](p, scene)
        for effect, p in values_of(effects, theta, "water"):
            water += effect.hooks["water"](p, scene)
        return tau, water

    def _from_nil(self, effect: Effect, step: np.ndarray) -> Forces:
        """What `step` changes of the forces with no other effect about."""
        return self._unit((effect.id, *step), effect, np.zeros(len(step)), step)

    def _difference(self, effect: Effect, now: np.ndarray, step: np.ndarray) -> Forces:
        there, without = self._exact([effect], {effect.id: now + step}), self._exact([effect], {effect.id: now})
        return Forces(there.f - without.f, there.middle - without.middle)

    def scene(self, state: State) -> Scene:
        """What hooks see of the motion."""
        w = self.windows
        return Scene(w.t_s, self.clock_s, state.x, state.nu_dot, w.run, self.centre_m, self.middle_s)

    def accelerations(
        self, effects: Sequence[Effect], theta: Theta, state: State, chosen: Sequence[Effect]
    ) -> np.ndarray:
        """What one unit of each parameter of `chosen` changes of nu_dot, (W, K+1, 3, P), by secants along `state`."""
        W, K = self.windows.size
        G_hull, G_water = self._slopes(*self._flat(state.x, state.hull, state.tau, state.water))
        G_hull = G_hull.reshape(W, K + 1, N_HULL, 3)
        G_water = G_water.reshape(W, K + 1, 2, 3).copy()
        scene, steps = self.scene(state), list(secants(chosen, theta))
        out = np.zeros((W, K + 1, 3, len(steps)))
        for at, (effect, now, step) in enumerate(steps):
            there, without, hooks = {**theta, effect.id: now + step}, {**theta, effect.id: now}, set(effect.hooks)
            every = [*(e for e in effects if e.id != effect.id), effect]
            tau = np.zeros((W, K + 1, 3))
            if hooks & {"pwm", "maps"}:
                small = effect.size(now) < 1
                unit = self._from_nil(effect, step) if small else self._difference(effect, now, step)
                tau += unit.f @ self.B.T
            if hooks & {"thrust", "force", "water"}:
                new = self.extra([effect], there, scene, state.forces.f)
                old = self.extra([effect], without, scene, state.forces.f)
                tau += new[0] - old[0]
                if "water" in hooks:
                    out[..., at] += ((new[1] - old[1])[..., None, :] @ G_water)[..., 0, :]
            out[..., at] += tau @ state.M_inv.T
            if "hull" in hooks:
                out[..., at] += np.tensordot(G_hull, self.hull(every, there) - state.hull, axes=([2], [0]))
            out[..., at] /= step.sum()
        return out


def _history(commands: Commands, propulsion: Propulsion) -> ThrustHistory | SlewedHistory:
    if propulsion.slew_N_s is None:
        return ThrustHistory(commands, propulsion.dead_time_s, propulsion.lag_s)
    return SlewedHistory(commands, propulsion.dead_time_s, propulsion.lag_s, propulsion.slew_N_s)


def _mean(history: ThrustHistory | SlewedHistory, t_s: np.ndarray, width_s: float) -> np.ndarray:
    """Forces averaged over `width_s` round `t_s`, as the samples that they are compared with are."""
    if not width_s:
        return history.at(t_s)[0]
    total = history.at(t_s - 0.4 * width_s)[0]
    for share in (-0.2, 0.0, 0.2, 0.4):
        total += history.at(t_s + share * width_s)[0]
    return total / 5


def secants(chosen: Sequence[Effect], theta: Theta) -> Iterator[tuple[Effect, np.ndarray, np.ndarray]]:
    """Each parameter in its turn: its effect, that effect's values now, and the step (of one parameter) to take."""
    for effect in chosen:
        now = theta.get(effect.id, np.zeros(len(effect.parameters)))
        for j, parameter in enumerate(effect.parameters):
            step = np.zeros(len(effect.parameters))
            reach = NEARBY * abs(now[j]) if effect.far and now[j] else parameter.step
            step[j] = reach if now[j] + reach <= parameter.upper else -reach
            yield effect, now, step


class _Cache:
    """The last few results of a function by key."""

    def __init__(self, function: Any):
        self._function, self._kept = function, {}

    def __call__(self, key: Any, *args: Any) -> Any:
        if key not in self._kept:
            if len(self._kept) > 48:
                self._kept.pop(next(iter(self._kept)))
            self._kept[key] = self._function(*args)
        return self._kept[key]


def values_of(effects: Sequence[Effect], theta: Theta, *stages: str) -> list[tuple[Effect, dict[str, float]]]:
    """Effects of `theta` that have one of the hooks, with their parameters by name."""
    return [
        (e, {p.name: float(v) for p, v in zip(e.parameters, theta[e.id], strict=True)})
        for e in effects
        if e.id in theta and any(s in e.hooks for s in stages)
    ]


def _repulsed(run: Run, vessel: VesselFile, effect: Effect, p: Values) -> Run:
    names = [f"pwm_{t.name}" for t in vessel.thrusters]
    pwm = effect.hooks["pwm"](p, run.table.select(names).to_numpy())
    pulses = {n: pl.Series(c).fill_nan(None) for n, c in zip(names, pwm.T, strict=True)}  # blank: before the first
    return Run(run.table.with_columns(**pulses), run.meta)


def sight(physics: Physics, x: np.ndarray, nu_dot: np.ndarray, delta_s: np.ndarray, arm: np.ndarray, when: np.ndarray):
    """The tag `delta_s` (m,) after states x (m, 6) with accelerations nu_dot (m, 3), to second order."""
    c, s = np.cos(x[:, 2]), np.sin(x[:, 2])
    R = np.stack([np.stack([c, -s], 1), np.stack([s, c], 1)], 1)
    r = x[:, 5:6]
    velocity = x[:, 3:5] + r * (TURN @ arm)
    gain = nu_dot[:, :2] + nu_dot[:, 2:] * (TURN @ arm) + r * (velocity @ TURN.T)
    d = delta_s[:, None]
    shift = arm + d * velocity + d**2 / 2 * gain

    def turned(vector: np.ndarray) -> np.ndarray:
        return (R @ vector[..., None])[..., 0]

    return Sight(
        when,
        physics.fix_clock_s,
        x[:, 2] + delta_s * x[:, 5],
        x[:, 5],
        x[:, :2] + turned(shift),
        turned(velocity + d * gain),
        turned(gain),
        physics.centre_m,
    ), (R, d, velocity, gain, shift)


@dataclass(frozen=True)
class InWater(StructuredModel):
    """The model in water that moves over ground with `flow` (north, east) [m/s], beside what the file says."""

    flow: Any = None

    def water_velocity(self, eta: Any) -> Any:
        """As StructuredModel's, plus R^T flow."""
        c, s = ca.cos(eta[2]), ca.sin(eta[2])
        moved = ca.vertcat(c * self.flow[0] + s * self.flow[1], -s * self.flow[0] + c * self.flow[1], 0.0)
        return super().water_velocity(eta) + moved


def _compiled(vessel: VesselFile, steps: int, windows: int) -> tuple[Batch, Batch, Batch]:
    """Rollout of all windows; at all nodes: rates with Jacobians, and slopes to coefficients and water velocity."""
    x, p, tau, d = ca.SX.sym("x", 6), ca.SX.sym("p", N_HULL), ca.SX.sym("tau", 3), ca.SX.sym("d", 3)
    water = ca.SX.sym("water", 2)
    base = symbolic_model(vessel, p)
    nu_dot = InWater(base.vessel, base.c, base.term_values, water).nu_dot(x[:3], x[3:], tau)
    x_dot = ca.vertcat(eta_dot(x[:3], x[3:]), nu_dot + d)

    def flat(expression: Any) -> ca.SX:
        return ca.densify(ca.vec(expression))

    A, M_inv = flat(ca.jacobian(x_dot, x)), flat(ca.jacobian(nu_dot, tau))
    rates = ca.Function("rates", [x, p, tau, water, d], ca.cse([A, M_inv, nu_dot + d]))
    slopes = [flat(ca.jacobian(nu_dot, p)), flat(ca.jacobian(nu_dot, water))]
    slope = ca.Function("slope", [x, p, tau, water], ca.cse(slopes))
    rate = ca.Function("rate", [x, p, tau, water, d], [x_dot])
    nodes = windows * (steps + 1)
    rollout = _step(rate).mapaccum("rollout", steps)
    return Batch(rollout, windows), Batch(rates, nodes), Batch(slope, nodes)


def _step(rate: ca.Function) -> ca.Function:
    """(x, p, [tau start, middle, end], [water start, end], d, h) -> x after h, by Runge-Kutta."""
    sizes = (("x", 6), ("p", N_HULL), ("taus", 9), ("flow", 4), ("d", 3), ("h", 1))
    x, p, taus, flow, d, h = (ca.SX.sym(*s) for s in sizes)
    start, middle, end = taus[:3], taus[3:6], taus[6:]
    here, there = flow[:2], flow[2:]
    half = (here + there) / 2
    k1 = rate(x, p, start, here, d)
    k2 = rate(x + h / 2 * k1, p, middle, half, d)
    k3 = rate(x + h / 2 * k2, p, middle, half, d)
    k4 = rate(x + h * k3, p, end, there, d)
    x_next = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return ca.Function("step", [x, p, taus, flow, d, h], ca.cse([x_next]))
