"""Trajectories of whole logs by the vessel model with any set of effects, and the effects' acceleration columns.

Windows are integrated from their nodes (`sim.fitting.engine.windows`):

    M nu_dot + C(nu_r) nu_r + D(nu_r) nu_r = B f + tau_hooks,   nu_r = nu - R^T(psi) V_water

Hull effects change the coefficients of M, C and D, water effects V_water. Hook forces that depend on the motion are
taken along the trajectory of the pass before; two passes converge, three where such an effect is large. Columns are
secants of accelerations along the trajectory, (with - without) / step; `linear` integrates them with A = d(x_dot)/dx.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace as dataclass_replace

import casadi as ca
import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.core.model.effects.current import water_velocity
from companion.core.model.loads import values
from companion.core.model.manoeuvring import StructuredModel
from companion.core.model.thrust_losses import has_thrust_losses
from companion.core.model.thrusters import configuration_matrix
from companion.logs.runs.apply_sensor_errors import first_fix_s
from companion.logs.runs.decimate import decimated
from companion.logs.runs.run import Run
from sim.fitting.diagnose.catalogue.effect import Effect, Scene, Values
from sim.fitting.diagnose.posterior.clock import LogClock
from sim.fitting.diagnose.posterior.compiled import compile_windows
from sim.fitting.diagnose.posterior.parameter_values import ParameterValues, including, secant_steps, values_by_name
from sim.fitting.diagnose.posterior.state import Accelerations, Feedback, WindowTrajectories
from sim.fitting.diagnose.posterior.thrust import WindowThrust
from sim.fitting.engine.jacobian_rows import side_by_side
from sim.fitting.engine.model import N_HULL
from sim.fitting.engine.noise import LATENT, STATE
from sim.fitting.engine.parameters import HULL, Parameters, file_values
from sim.fitting.engine.windows import Windows, cut_windows, reads_lean

MAX_STEP_S = 0.1  # of integration: yaw has a time constant of about 2 s, and thrust is the mean over a step
WATER, THRUST = frozenset({"water"}), frozenset({"thrust"})  # stages of hooks
FORCE = frozenset({"force"})
PUSHES = THRUST | FORCE  # stages whose hooks give forces
NUDGES = (0.05, 0.05, *(7 * (0.01,)))  # difference steps of x y psi u v r u_dot v_dot r_dot for slopes of forces


class EffectPhysics:
    """The model of `vessel` on W windows of K steps, `window_s` [s] long, of `runs`; `clock`: of their logs."""

    def __init__(self, runs: Sequence[Run], vessel: VesselFile, window_s: float, clock: LogClock | None = None):
        fewer = [decimated(run) for run in runs]
        self.runs, self.vessel = tuple(each.run for each in fewer), vessel
        self.windows: Windows = cut_windows(self.runs, vessel, window_s, max_step_s=MAX_STEP_S)
        self.levelled = not any(reads_lean(run) for run in self.runs)
        self.parameters = Parameters(vessel)
        self.q = file_values(vessel)
        self.B, self._weakened = configuration_matrix(vessel), has_thrust_losses(vessel)
        self.flow = np.array(ca.DM(StructuredModel.of(vessel).water_velocity(ca.DM.zeros(3))))[:2, 0]  # at first
        W, K = self.windows.size
        self._rollout, self._rates, self._slopes, self._M_inv = compile_windows(vessel, K, W)
        self.clock = clock or LogClock.of(runs)
        ahead_s = np.array([self.clock.ahead_s(run) for run in runs])
        self.clock_s = self.windows.t_s + ahead_s[self.windows.run][:, None]
        self.fix_clock_s = self.windows.fixes.t_s + ahead_s[self.windows.fixes.run]
        self.first_fix_s = np.array([first_fix_s(run) for run in runs])[self.windows.fixes.run]
        self._turning = turning_flow(vessel, self.clock_s)
        self.middle_s = float(self.clock_s.min() + self.clock_s.max()) / 2
        self.centre_m = self.windows.fixes.place_m.mean(axis=0)
        self.thrusters = WindowThrust(self.runs, vessel, self.windows, [each.width_s for each in fewer])

    def hull(self, effects: Sequence[Effect], theta: ParameterValues) -> np.ndarray:
        """Hull coefficients (N_HULL,) in the order of HULL with the effects applied."""
        c: Values = _named(self.q[:N_HULL])
        for effect, p in values_by_name(effects, theta, "hull"):
            c = effect.hooks["hull"](p, c)
        return np.array([c[name] for name in HULL])

    def move(
        self,
        effects: Sequence[Effect],
        theta: ParameterValues,
        z: np.ndarray,
        before: WindowTrajectories | None,
        imposed: Accelerations | None = None,
        feedback: Feedback | None = None,
    ) -> WindowTrajectories:
        """Trajectories from nodes z (W, L); `before`: those of a nearby point, along which hook forces are taken first.

        `imposed`: accelerations imposed on top of `effects`; `feedback`: of a nearby motion, to be used again.
        """
        pushing = with_hooks(effects, theta, PUSHES)
        passes = 3 if nameable(pushing, theta) else 2 if with_hooks(effects, theta, WATER | PUSHES) else 1
        for _ in range(passes):
            before = self.one_pass(effects, theta, z, before, imposed)
        assert before is not None
        feedback = feedback or (self.feedback(pushing, theta, before) if pushing else None)
        return before if feedback is None else before.with_feedback(feedback)

    def feedback(self, effects: Sequence[Effect], theta: ParameterValues, state: WindowTrajectories) -> Feedback:
        """Linearised dependence of the hook forces of `effects` on the motion `state`, by forward differences."""
        scene, motion = self.scene(state), np.concatenate([state.x, state.nu_dot], axis=2)
        now = self.hook_forces(effects, theta, scene, state.forces.f)[0][..., :3]
        slopes = np.empty((*now.shape, len(NUDGES)))
        for j, nudge in enumerate(NUDGES):
            moved = motion.copy()
            moved[..., j] += nudge
            nudged = dataclass_replace(scene, x=moved[..., :6], nu_dot=moved[..., 6:])
            slopes[..., j] = (self.hook_forces(effects, theta, nudged, state.forces.f)[0][..., :3] - now) / nudge
        M = np.linalg.inv(state.M_inv)
        return Feedback(slopes[..., :6], np.linalg.inv(M - slopes[..., 6:].mean(axis=(0, 1))) @ M)

    def one_pass(
        self,
        effects: Sequence[Effect],
        theta: ParameterValues,
        z: np.ndarray,
        before: WindowTrajectories | None,
        imposed: Accelerations | None = None,
    ) -> WindowTrajectories:
        """One pass of `move`: hook forces and water along `before` (None: without them)."""
        # 1. Thruster forces without hooks, hull coefficients.
        W, K = self.windows.size
        forces, hull = self.thrusters.forces(effects, theta), self.hull(effects, theta)
        tau, water = self.drive(forces.f), self._turning
        tau_mid = self.drive(forces.middle)
        # 2. Hook forces and water along the motion before, imposed accelerations as forces M a.
        if before is not None:
            extra = self.hook_forces(effects, theta, self.scene(before, hull), forces.f)
            more = extra[0]
            if imposed is not None:
                M = np.linalg.inv(before.M_inv)
                more[..., :3] += imposed.nodes @ M.T
                tau_mid[..., :3] += imposed.mid_excess @ M.T
            tau, water = tau + more, extra[1]
            tau_mid = tau_mid + (more[:, :-1] + more[:, 1:]) / 2
        # 3. Rollout from the nodes, latent acceleration d constant over a window.
        drive = np.concatenate([tau[:, :-1], tau_mid, tau[:, 1:]], axis=2)
        flow = np.concatenate([water[:, :-1], water[:, 1:]], axis=2)
        d = z[:, LATENT]
        constants = np.hstack([np.tile(hull, (W, 1)), d])
        x = np.empty((W, K + 1, 6))
        x[:, 0] = z[:, STATE]
        x[:, 1:] = self._rollout(z[:, STATE], constants, drive, flow, self.windows.h_s[:, :, None])
        # 4. Accelerations and Jacobians along the trajectories.
        A, M_inv, nu_dot = self._rates(*self._flat(x, hull, tau, water, np.repeat(d, K + 1, axis=0)))
        A, M_inv = A.reshape(W, K + 1, 6, 6).swapaxes(2, 3).copy(), M_inv[0].reshape(3, 3).T.copy()
        ids = frozenset(e.id for e in effects)
        return WindowTrajectories(
            x, nu_dot.reshape(W, K + 1, 3).copy(), A, M_inv, tau, water, forces, hull, None, imposed, ids
        )

    def remainder(
        self, effects: Sequence[Effect], theta: ParameterValues, state: WindowTrajectories, d: np.ndarray
    ) -> Accelerations:
        """Accelerations in `state` beyond those of `effects` and of the latent acceleration d (W, 3)."""
        if state.external is not None and state.effect_ids == frozenset(e.id for e in effects):
            return state.external
        W, K = self.windows.size
        forces = self.thrusters.forces(effects, theta)
        hull = self.hull(effects, theta)
        more, water = self.hook_forces(effects, theta, self.scene(state, hull), forces.f)
        drive = self._flat(state.x, hull, self.drive(forces.f) + more, water)
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
        """What hooks add along `scene`: tau as by `drive` (W, K+1, 3 or 3 + n), water velocity (W, K+1, 2) [m/s].

        f (W, K+1, n): thruster forces before hooks [N]. The water is beyond the file's at first; hooks see the sum.
        """
        hooked, water = f, self._turning.copy()
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

    def scene(self, state: WindowTrajectories, hull: np.ndarray | None = None) -> Scene:
        """The motion `state` as hooks see it; `hull`: coefficients (N_HULL,) in place of the state's."""
        w = self.windows
        water, c = state.water + self.flow, _named(state.hull if hull is None else hull)
        motion = (w.t_s, self.clock_s, state.x, state.nu_dot, w.run)
        return Scene(*motion, self.centre_m, self.middle_s, water, c)

    def accelerations(
        self, effects: Sequence[Effect], theta: ParameterValues, state: WindowTrajectories, free: Sequence[Effect]
    ) -> Accelerations:
        """Columns d(nu_dot)/d(parameter) of `free`, (.., P), by secants along `state`.

        Changes of thrust pass through all nameable hooks on thrust, such as that of a dead thruster.
        """
        # 1. Sensitivities of nu_dot to coefficients, water and thruster forces; forces as they are.
        W, K = self.windows.size
        P, flat = sum(len(e.parameters) for e in free), W * (K + 1)
        slopes = self._slopes(*self._flat(state.x, state.hull, state.tau, state.water))
        G_hull, G_water, G_f = (np.array(G).reshape(flat, -1, 3).swapaxes(0, 1).copy() for G in slopes)
        scene, pushed = self.scene(state), state.forces.mid_excess() @ self.B.T
        react = np.eye(3) if state.feedback is None else state.feedback.mass_ratio
        nodes, bump = np.zeros((P, flat, 3)), np.zeros((P, W * K, 3))
        hooked = nameable(with_hooks(effects, theta, THRUST), theta)
        of_hull = nameable(with_hooks(effects, theta, FORCE), theta)  # their forces may go with the damping
        others = {"water": {e.id for e in _in_water(effects, theta)}, "thrust": {e.id for e in hooked}}
        f = state.forces.f
        changed, damped = (self.hook_forces(pushing, theta, scene, f)[0] for pushing in (hooked, of_hull))

        def nu_dot_of(push: np.ndarray) -> np.ndarray:  # nu_dot of a change of tau
            by = push.reshape(flat, -1)
            return by[:, :3] @ state.M_inv.T + _times(by[:, 3:].T[:, :, None], G_f)

        # 2. For each parameter the secants of its stages, times M'^-1 M for the feedback of hook forces.
        for each in secant_steps(free, theta):
            effect, hooks, every = each.effect, set(each.effect.hooks), including(effects, each.effect)
            ids = {effect.id}.union(*(others[stage] for stage in hooks & others.keys()))
            along = [e for e in every if e.id in ids]
            acts = hooks & (WATER | PUSHES)
            old = self.hook_forces(along, {**theta, effect.id: each.now}, scene, f) if acts else None
            for at, step in each.steps.items():
                stepped, scale = {**theta, effect.id: each.now + step}, react.T / step.sum()
                if hooks & {"pwm", "maps"}:
                    unit, share = self.thrusters.change(every, theta, effect, step), (state.M_inv @ self.B).T @ scale
                    more = self.drive(unit.f) + self.hook_forces(hooked, theta, scene, f + unit.f)[0] - changed
                    nodes[at] += nu_dot_of(more) @ scale
                    bump[at] += unit.mid_excess().reshape(W * K, -1) @ share
                if old is not None:
                    tau, water = self.hook_forces(along, stepped, scene, f)
                    nodes[at] += nu_dot_of(tau - old[0]) @ scale
                    if "water" in hooks:
                        nodes[at] += _times((water - old[1]).reshape(flat, 2).T[:, :, None], G_water) @ scale
                if "hull" in hooks:
                    hull = self.hull(every, stepped)
                    nodes[at] += _times(hull - state.hull, G_hull) @ scale
                    if of_hull:
                        moved = dataclass_replace(scene, hull=_named(hull))
                        nodes[at] += nu_dot_of(self.hook_forces(of_hull, theta, moved, f)[0] - damped) @ scale
                    M_inv_change = (np.asarray(self._M_inv(hull)) - state.M_inv).T
                    if M_inv_change.any():
                        bump[at] += pushed.reshape(W * K, 3) @ (M_inv_change @ scale)
        return Accelerations(side_by_side(nodes).reshape(W, K + 1, 3, P), side_by_side(bump).reshape(W, K, 3, P))


def _named(hull: np.ndarray) -> dict[str, float]:
    return dict(zip(HULL, hull.tolist(), strict=True))


def turning_flow(vessel: VesselFile, clock_s: np.ndarray) -> np.ndarray:
    """Velocity of the file's own current at `clock_s` less that at first, north and east, (*clock_s.shape, 2) [m/s]."""
    own = values("current", vessel.terms.get("current", {}))
    if not own["turn_deg_s"]:
        return np.zeros((*clock_s.shape, 2))
    return np.stack(water_velocity(own, clock_s), axis=-1) - water_velocity(own)


def with_hooks(effects: Sequence[Effect], theta: ParameterValues, stages: frozenset[str]) -> list[Effect]:
    """The effects of `theta` that have a hook of one of `stages`."""
    return [e for e in effects if e.id in theta and not stages.isdisjoint(e.hooks)]


def nameable(effects: Sequence[Effect], theta: ParameterValues) -> list[Effect]:
    """Those of `effects` that are larger than their smallest size worth a name."""
    return [e for e in effects if e.size(theta[e.id]) >= 1]


def _in_water(effects: Sequence[Effect], theta: ParameterValues) -> list[Effect]:
    """Effects on the water, and nameable hook forces, which may depend on the velocity through it."""
    moving, pushing = with_hooks(effects, theta, WATER), nameable(with_hooks(effects, theta, PUSHES), theta)
    return [*moving, *(e for e in pushing if e not in moving)]


def _times(values: np.ndarray, G: np.ndarray) -> np.ndarray:
    """Sum over k of values (k, ..) times G (k, n, 3); zero values are skipped."""
    return sum((v * g for v, g in zip(values, G, strict=True) if np.any(v)), start=np.zeros(G.shape[1:]))
