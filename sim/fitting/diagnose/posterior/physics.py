"""Whole logs moved by the one vessel model with any set of effects in it, and what each effect's parameters change.

Windows are integrated from their nodes (`sim.fitting.engine.windows`). Effects of the hull enter the model's
coefficients, moving water its relative velocity; forces and thruster effects that depend on the motion are taken along
the trajectory of the pass before, which two passes settle. Columns are secants: (with - without) / step, along the
trajectory, for accelerations; the motion's own Jacobian then carries them on (`linear`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace as dataclass_replace

import casadi as ca
import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.core.model.manoeuvring import StructuredModel
from companion.core.model.thrust_losses import has_thrust_losses
from companion.core.model.thrusters import configuration_matrix
from companion.logs.runs.apply_sensor_errors import first_fix_s
from companion.logs.runs.decimate import decimated
from companion.logs.runs.run import Run
from sim.fitting.diagnose.catalogue.effect import Effect, Scene, Values
from sim.fitting.diagnose.posterior.clock import LogClock
from sim.fitting.diagnose.posterior.compiled import compile_windows
from sim.fitting.diagnose.posterior.parameter_values import (
    ParameterValues,
    including,
    secant_steps,
    values_by_name,
)
from sim.fitting.diagnose.posterior.state import Accelerations, Feedback, WindowTrajectories
from sim.fitting.diagnose.posterior.thrust import WindowThrust
from sim.fitting.engine.jacobian_rows import side_by_side
from sim.fitting.engine.model import N_HULL
from sim.fitting.engine.noise import LATENT, STATE
from sim.fitting.engine.parameters import HULL, Parameters, file_values
from sim.fitting.engine.windows import Windows, cut_windows

MAX_STEP_S = 0.1  # of integration: yaw has a time constant of about 2 s, and thrust is the mean over a step
WATER, THRUST = frozenset({"water"}), frozenset({"thrust"})  # stages of hooks
PUSHES = THRUST | {"force"}
NUDGES = (0.05, 0.05, *(7 * (0.01,)))  # of x y psi u v r u_dot v_dot r_dot, for the slopes of forces


class EffectPhysics:
    """The model of `vessel` on the windows of `runs`. `clock`: of the logs that these are parts of, and of others."""

    def __init__(self, runs: Sequence[Run], vessel: VesselFile, window_s: float, clock: LogClock | None = None):
        fewer = [decimated(run) for run in runs]
        self.runs, self.vessel = tuple(each.run for each in fewer), vessel
        self.windows: Windows = cut_windows(self.runs, vessel, window_s, max_step_s=MAX_STEP_S)
        self.parameters = Parameters(vessel)
        self.q = file_values(vessel)
        self.B, self._weakened = configuration_matrix(vessel), has_thrust_losses(vessel)
        self.flow = np.array(ca.DM(StructuredModel.of(vessel).water_velocity(ca.DM.zeros(3))))[:2, 0]  # everywhere
        W, K = self.windows.size
        self._rollout, self._rates, self._slopes, self._M_inv = compile_windows(vessel, K, W)
        self.clock = clock or LogClock.of(runs)
        ahead_s = np.array([self.clock.ahead_s(run) for run in runs])
        self.clock_s = self.windows.t_s + ahead_s[self.windows.run][:, None]
        self.fix_clock_s = self.windows.fixes.t_s + ahead_s[self.windows.fixes.run]
        self.first_fix_s = np.array([first_fix_s(run) for run in runs])[self.windows.fixes.run]
        self.middle_s = float(self.clock_s.min() + self.clock_s.max()) / 2
        self.centre_m = self.windows.fixes.place_m.mean(axis=0)
        self.thrusters = WindowThrust(self.runs, vessel, self.windows, [each.width_s for each in fewer])

    def hull(self, effects: Sequence[Effect], theta: ParameterValues) -> np.ndarray:
        """Coefficients (12,) in the order of HULL with the effects in them."""
        c: Values = dict(zip(HULL, map(float, self.q[:N_HULL]), strict=True))
        for effect, p in values_by_name(effects, theta, "hull"):
            c = effect.hooks["hull"](p, c)
        return np.array([c[name] for name in HULL])

    def move(
        self,
        effects: Sequence[Effect],
        theta: ParameterValues,
        z: np.ndarray,
        before: WindowTrajectories | None,
        given: Accelerations | None = None,
        feedback: Feedback | None = None,
    ) -> WindowTrajectories:
        """Trajectories from nodes z (W, L); `before`: a motion near this one, for effects that depend on it.

        `given`: of what is not among `effects`; `feedback`: of a motion so near that it will do.
        """
        felt = with_hooks(effects, theta, PUSHES)
        passes = 3 if nameable(felt, theta) else 2 if with_hooks(effects, theta, WATER | PUSHES) else 1
        for _ in range(passes):
            before = self.one_pass(effects, theta, z, before, given)
        assert before is not None
        feedback = feedback or (self.feedback(felt, theta, before) if felt else None)
        return before if feedback is None else before.with_feedback(feedback)

    def feedback(self, effects: Sequence[Effect], theta: ParameterValues, state: WindowTrajectories) -> Feedback:
        """Of the forces of `effects` on the motion `state`."""
        scene, motion = self.scene(state), np.concatenate([state.x, state.nu_dot], axis=2)
        now = self.hook_forces(effects, theta, scene, state.forces.f)[0][..., :3]
        slopes = np.empty((*now.shape, len(NUDGES)))
        for j, nudge in enumerate(NUDGES):
            moved = motion.copy()
            moved[..., j] += nudge
            there = dataclass_replace(scene, x=moved[..., :6], nu_dot=moved[..., 6:])
            slopes[..., j] = (self.hook_forces(effects, theta, there, state.forces.f)[0][..., :3] - now) / nudge
        M = np.linalg.inv(state.M_inv)
        return Feedback(slopes[..., :6], np.linalg.inv(M - slopes[..., 6:].mean(axis=(0, 1))) @ M)

    def one_pass(
        self,
        effects: Sequence[Effect],
        theta: ParameterValues,
        z: np.ndarray,
        before: WindowTrajectories | None,
        given: Accelerations | None = None,
    ) -> WindowTrajectories:
        """As `move`, with what depends on the motion as it is along `before` (None: without)."""
        W, K = self.windows.size
        forces, hull = self.thrusters.forces(effects, theta), self.hull(effects, theta)
        tau, water = self.drive(forces.f), np.zeros((W, K + 1, 2))
        tau_mid = self.drive(forces.middle)
        if before is not None:
            extra = self.hook_forces(effects, theta, self.scene(before), forces.f)
            more = extra[0]
            if given is not None:
                M = np.linalg.inv(before.M_inv)
                more[..., :3] += given.nodes @ M.T
                tau_mid[..., :3] += given.mid_excess @ M.T
            tau, water = tau + more, extra[1]
            tau_mid = tau_mid + (more[:, :-1] + more[:, 1:]) / 2
        drive = np.concatenate([tau[:, :-1], tau_mid, tau[:, 1:]], axis=2)
        flow = np.concatenate([water[:, :-1], water[:, 1:]], axis=2)
        d = z[:, LATENT]
        constants = np.hstack([np.tile(hull, (W, 1)), d])
        x = np.empty((W, K + 1, 6))
        x[:, 0] = z[:, STATE]
        x[:, 1:] = self._rollout(z[:, STATE], constants, drive, flow, self.windows.h_s[:, :, None])
        A, M_inv, nu_dot = self._rates(*self._flat(x, hull, tau, water, np.repeat(d, K + 1, axis=0)))
        A, M_inv = A.reshape(W, K + 1, 6, 6).swapaxes(2, 3).copy(), M_inv[0].reshape(3, 3).T.copy()
        ids = frozenset(e.id for e in effects)
        return WindowTrajectories(
            x, nu_dot.reshape(W, K + 1, 3).copy(), A, M_inv, tau, water, forces, hull, None, given, ids
        )

    def remainder(
        self, effects: Sequence[Effect], theta: ParameterValues, state: WindowTrajectories, d: np.ndarray
    ) -> Accelerations:
        """What of the accelerations in `state` does not come from `effects` nor from d (W, 3)."""
        if state.external is not None and state.effect_ids == frozenset(e.id for e in effects):
            return state.external
        W, K = self.windows.size
        forces = self.thrusters.forces(effects, theta)
        more, water = self.hook_forces(effects, theta, self.scene(state), forces.f)
        drive = self._flat(state.x, self.hull(effects, theta), self.drive(forces.f) + more, water)
        _, _, nu_dot = self._rates(*drive, np.repeat(d, K + 1, axis=0))
        bump = state.forces.minus(forces).mid_excess() @ self.B.T @ state.M_inv.T
        if state.external is not None:
            bump = bump + state.external.mid_excess
        return Accelerations(state.nu_dot - nu_dot.reshape(W, K + 1, 3), bump)

    def _flat(self, x: np.ndarray, hull: np.ndarray, tau: np.ndarray, water: np.ndarray, *more: np.ndarray):
        n = x.shape[0] * x.shape[1]
        return x.reshape(n, 6), np.tile(hull, (n, 1)), tau.reshape(n, -1), water.reshape(n, 2), *more

    def drive(self, f: np.ndarray) -> np.ndarray:
        """Body force tau = B f, (W, k, 3), of thruster forces f (W, k, n) [N].

        Where the file's thrusters lose thrust to moving water, f is appended (W, k, 3 + n): see `compile_windows`.
        """
        tau = (f.reshape(-1, f.shape[2]) @ self.B.T).reshape(*f.shape[:2], 3)  # one product, not one for each window
        return np.concatenate([tau, f], axis=2) if self._weakened else tau

    def hook_forces(
        self, effects: Sequence[Effect], theta: ParameterValues, scene: Scene, f: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """`drive` (W, K+1, 3 or more) and water velocity (W, K+1, 2) that hooks add along `scene`.

        f: forces before them. The water is beside that of the file, which hooks see too.
        """
        hooked, water = f, np.zeros((*f.shape[:2], 2))
        tau = np.zeros((*f.shape[:2], 3 + self._weakened * f.shape[2]))
        flows = values_by_name(effects, theta, "water")
        for effect, p in flows:
            water += effect.hooks["water"](p, scene)
        if flows:
            scene = dataclass_replace(scene, water=water + self.flow)
        for effect, p in values_by_name(effects, theta, "thrust"):
            hooked = effect.hooks["thrust"](p, scene, hooked)
        if hooked is not f:
            tau = self.drive(hooked - f)
        for effect, p in values_by_name(effects, theta, "force"):
            tau[..., :3] += effect.hooks["force"](p, scene)
        return tau, water

    def scene(self, state: WindowTrajectories) -> Scene:
        """What hooks see of the motion."""
        w = self.windows
        water = state.water + self.flow
        return Scene(w.t_s, self.clock_s, state.x, state.nu_dot, w.run, self.centre_m, self.middle_s, water)

    def accelerations(
        self, effects: Sequence[Effect], theta: ParameterValues, state: WindowTrajectories, free: Sequence[Effect]
    ) -> Accelerations:
        """What one unit of each parameter of `free` changes of nu_dot, (.., P), by secants along `state`.

        Thrust that it changes goes through all hooks of some size on thrust, such as that of a dead thruster.
        """
        W, K = self.windows.size
        P, flat = sum(len(e.parameters) for e in free), W * (K + 1)
        slopes = self._slopes(*self._flat(state.x, state.hull, state.tau, state.water))
        G_hull, G_water, G_f = (np.array(G).reshape(flat, -1, 3).swapaxes(0, 1).copy() for G in slopes)
        scene, pushed = self.scene(state), state.forces.mid_excess() @ self.B.T
        react = np.eye(3) if state.feedback is None else state.feedback.mass_ratio
        nodes, bump = np.zeros((P, flat, 3)), np.zeros((P, W * K, 3))
        hooked = nameable(with_hooks(effects, theta, THRUST), theta)
        others = {"water": {e.id for e in _in_water(effects, theta)}, "thrust": {e.id for e in hooked}}
        f = state.forces.f
        changed = self.hook_forces(hooked, theta, scene, f)[0]

        def felt(push: np.ndarray) -> np.ndarray:
            by = push.reshape(flat, -1)
            return by[:, :3] @ state.M_inv.T + _times(by[:, 3:].T[:, :, None], G_f)

        for each in secant_steps(free, theta):
            effect, hooks, every = each.effect, set(each.effect.hooks), including(effects, each.effect)
            ids = {effect.id}.union(*(others[stage] for stage in hooks & others.keys()))
            along = [e for e in every if e.id in ids]
            acts = hooks & (WATER | PUSHES)
            old = self.hook_forces(along, {**theta, effect.id: each.now}, scene, f) if acts else None
            for at, step in each.steps.items():
                there, turn = {**theta, effect.id: each.now + step}, react.T / step.sum()
                if hooks & {"pwm", "maps"}:
                    unit, share = self.thrusters.change(every, theta, effect, step), (state.M_inv @ self.B).T @ turn
                    more = self.drive(unit.f) + self.hook_forces(hooked, theta, scene, f + unit.f)[0] - changed
                    nodes[at] += felt(more) @ turn
                    bump[at] += unit.mid_excess().reshape(W * K, -1) @ share
                if old is not None:
                    tau, water = self.hook_forces(along, there, scene, f)
                    nodes[at] += felt(tau - old[0]) @ turn
                    if "water" in hooks:
                        nodes[at] += _times((water - old[1]).reshape(flat, 2).T[:, :, None], G_water) @ turn
                if "hull" in hooks:
                    hull = self.hull(every, there)
                    nodes[at] += _times(hull - state.hull, G_hull) @ turn
                    lighter = (np.asarray(self._M_inv(hull)) - state.M_inv).T
                    if lighter.any():
                        bump[at] += pushed.reshape(W * K, 3) @ (lighter @ turn)
        return Accelerations(side_by_side(nodes).reshape(W, K + 1, 3, P), side_by_side(bump).reshape(W, K, 3, P))


def with_hooks(effects: Sequence[Effect], theta: ParameterValues, stages: frozenset[str]) -> list[Effect]:
    """Effects of `theta` that have a hook of `stages`."""
    return [e for e in effects if e.id in theta and not stages.isdisjoint(e.hooks)]


def nameable(effects: Sequence[Effect], theta: ParameterValues) -> list[Effect]:
    """Those large enough for a name."""
    return [e for e in effects if e.size(theta[e.id]) >= 1]


def _in_water(effects: Sequence[Effect], theta: ParameterValues) -> list[Effect]:
    """What moving water is made of, and forces of some size, which may go by the motion through it."""
    moving, pushing = with_hooks(effects, theta, WATER), nameable(with_hooks(effects, theta, PUSHES), theta)
    return [*moving, *(e for e in pushing if e not in moving)]


def _times(values: np.ndarray, G: np.ndarray) -> np.ndarray:
    """Sum of values (k, ..) times G (k, n, 3), most of them nil."""
    return sum((v * g for v, g in zip(values, G, strict=True) if np.any(v)), start=np.zeros(G.shape[1:]))
