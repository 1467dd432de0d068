"""Which thruster does not do what it is told: a bank of Kalman filters on the wrench that the model does not explain.

    w_k = d + sum_i a_i f_i b_i + offset_h + waves + noise     b_i: column i of B, f_i: commanded force [N]

    sound        a_i small (thrusters off by some per cent), d small and slow
    gain i       a_i free: the gain is 1 + a_i             offset 0
    stuck i      c b_i in place of f_i b_i, c free         offset -f_i b_i
    swap i j     offset (f_j - f_i) (b_i - b_j)
    reversed     all of them: offset -2 B f
    pushed       d large: something pushes harder than water and wind usually do
    accel        M [b_x b_y 0], b free: the accelerometer is wrong
    askew i      offset M (A_i - I) a: its axes are turned or exchanged; a: what it should feel

Each against `sound` by a cumulative sum of log-likelihood ratios (Page 1954; Willsky and Jones 1976, generalised
likelihood ratio): where the sum falls to 0 the hypothesis begins afresh from `sound`, so it need not know when a fault
began. All filters are one batch of arrays; each has states of the waves (`wave_noise`).

Of a thruster that is known to stick every hypothesis has the force c_i in place of (1 + a_i) f_i, and goes on
estimating it; what would blame this thruster once more says what `sound` says.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import msgspec
import numpy as np

from companion.core.pilot.trust.thrusters.wave_noise import transition

D_SIGMA = {"pushed": (30.0, 30.0, 5.0), "accel": (0.6, 0.6, 1.2)}
SOUND_D = (3.0, 3.0, 1.2)
"""Stationary sigma of d [N, N, N m] where a hypothesis has one of its own, and else: the filter's latent force, what a
gale or a tow may do, what an accelerometer may be off by [m/s^2]. Assumed."""
D_TIME_S = 8.0
GAIN_SIGMA = 0.08
"""Thrusters that are sound are off by so much; assumed. Small, so that a dead one cannot pass for one that is off."""
FAULT_GAIN, FAULT_GAIN_SIGMA = -1.0, 0.8
STUCK_SIGMA_N = 20.0
SPIN_UP_S, SPIN_UP_N = 0.5, 10.0
"""A thruster that sticks takes so long to get there; sigma by which its force may change in one such second [N].
Assumed."""
NOISE = (2.5, 3.5, 0.8)
"""Of a residual over one tick [N, N, N m]: accelerometer 0.05 m/s^2 at 50 Hz, gyro 0.002 rad/s, and the model's own
quick errors; assumed."""
NOISE_VARIANCE = np.square(NOISE)
WAVE_MARGIN = 4.0
"""So much larger than in the last three seconds waves may be; assumed."""
NOISE_TICKS = 30
"""So many residuals of a bank that begins tell how large they are in waves; assumed: a period and more."""
TEMPER = 0.4
"""Share of a log-likelihood ratio that counts: residuals of neighbouring ticks err together. Assumed."""
MOST = 3.0
"""Nats that one tick may tell; assumed: no single reading decides."""
CEILING = 60.0
"""Nats at which the largest sum stops growing, so that it can fall again; the others keep their distance."""
MEMORY_S = 60.0
"""So long a nat counts in waves that are as large as the noise: what gathers more slowly is a model that is a little
wrong. Assumed: sound thrusters that were named in waves had gathered it in two to four minutes.
"""


AXES = (np.diag([-1.0, -1.0]), *(np.array([[0.0, x], [y, 0.0]]) for x, y in ((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0))))
"""How an accelerometer's axes may be mistaken: turned by 180 degrees, exchanged, turned by 90 degrees either way."""


class ThrustHypothesis(NamedTuple):
    """`kind`: sound, gain, stuck, swap, reversed, pushed, accel or askew; `i`, `j`: of the thrusters, or of `AXES`."""

    kind: str
    i: int = -1
    j: int = -1

    @property
    def blames_thrust(self) -> bool:
        """Whether it is about thrusters at all."""
        return self.is_thruster or self.kind == "reversed"

    @property
    def is_thruster(self) -> bool:
        """Whether it blames one thruster or two."""
        return self.kind in ("gain", "stuck", "swap")

    @property
    def blames_accelerometer(self) -> bool:
        """Whether it is about the accelerometer."""
        return self.kind in ("accel", "askew")


def hypotheses(n: int) -> tuple[ThrustHypothesis, ...]:
    """All for n thrusters; the first is `sound`."""
    return (
        ThrustHypothesis("sound"),
        *(ThrustHypothesis("gain", i) for i in range(n)),
        *(ThrustHypothesis("stuck", i) for i in range(n)),
        *(ThrustHypothesis("swap", i, j) for i, j in combinations(range(n), 2)),
        *((ThrustHypothesis("reversed"),) if n > 1 else ()),
        ThrustHypothesis("pushed"),
        ThrustHypothesis("accel"),
        *(ThrustHypothesis("askew", i) for i in range(len(AXES))),
    )


class BankState(msgspec.Struct, frozen=True, eq=False):
    """Batch of K filters: mean (K, 10 + n) of [d a waves c], covariance, sum of log-likelihood ratios (K,) [nats]. Of a
    thruster that is known to stick the force c_i [N] stands for a_i.

    `age_s`: since each began afresh (K,); `noise`: mean square of the change of w in half a second that each leaves
    unexplained (K, 3); `past`: the last residuals and forces; `count`: of all; `rough_s`: for how long waves have
    been larger than the noise; `peak`: the largest that each sum has been since it began afresh (K,).
    """

    mean: np.ndarray
    P: np.ndarray
    nats: np.ndarray
    age_s: np.ndarray
    noise: np.ndarray
    peak: np.ndarray
    past: tuple[tuple[np.ndarray, np.ndarray], ...] = ()
    count: int = 0
    rough_s: float = 0.0


class ThrusterBank:
    """Constant parts for a configuration matrix B (3, n) and a mass matrix M (3, 3); `sticks`: thrusters known to."""

    def __init__(self, B: np.ndarray, M: np.ndarray, sticks: Sequence[int] = ()):
        self.B, self.M, n = B, M, B.shape[1]
        self.hypotheses, self._sticks = hypotheses(n), np.isin(np.arange(n), sticks)
        self._blamed = [h.is_thruster and not {h.i, h.j}.isdisjoint(sticks) for h in self.hypotheses]
        K, self._n = len(self.hypotheses), n
        self._size, self._waves = n + 10, [slice(i, i + 2) for i in range(n + 3, n + 9, 2)]
        self._mean0, self._variance0 = np.zeros((K, self._size)), np.zeros((K, self._size))
        self._d_sigma = np.array([D_SIGMA.get(h.kind, SOUND_D) for h in self.hypotheses])
        self._free = np.zeros((K, self._size), dtype=bool)
        for k, h in enumerate(self.hypotheses):
            sigma = np.where(self._sticks, STUCK_SIGMA_N, GAIN_SIGMA)
            self._variance0[k] = np.r_[np.square(self._d_sigma[k]), np.square(sigma), np.zeros(7)]
            if self._blamed[k]:
                continue
            if h.kind == "gain":
                self._mean0[k, 3 + h.i], self._variance0[k, 3 + h.i] = FAULT_GAIN, FAULT_GAIN_SIGMA**2
            elif h.kind == "stuck":
                self._variance0[k, -1], self._variance0[k, 3 + h.i] = STUCK_SIGMA_N**2, 0.0
            free = {"gain": [3 + h.i], "stuck": [3 + h.i, -1]}.get(h.kind, range(3) if h.kind in D_SIGMA else [])
            self._free[k, list(free)] = True
        self._thrusts = np.array([k for k, h in enumerate(self.hypotheses) if k == 0 or h.blames_thrust])
        self._H0, self._by_f, self._offset_f, self._offset_a = self._measurements()

    def initial(self, stuck_n: Sequence[float | None] = ()) -> BankState:
        """Nothing seen; `stuck_n`: forces [N] at which thrusters known to stick are believed to (others: None)."""
        (K, n), mean = self._mean0.shape, self._mean0.copy()
        for i, force_n in enumerate(stuck_n):
            if force_n is not None:
                mean[:, 3 + i] = force_n
        P = self._variance0[:, :, None] * np.eye(n)
        return BankState(mean, P, np.zeros(K), np.zeros(K), np.zeros((K, 3)), np.zeros(K))

    def step(self, state: BankState, w: np.ndarray, f_n: np.ndarray, a_m_s2: np.ndarray, dt_s: float) -> BankState:
        """After one residual w (3,) under forces f (n,) [N], where the accelerometer should feel a (2,)."""
        # 1. noise; while it is not known yet, what was reckoned with too little of it counts for less
        past = (*state.past, (w, f_n))[-6:]
        noise = self._learned(state, past, dt_s)
        best = self._thrusts[np.argmax(state.nats[self._thrusts])]
        wave = _wave_variance(noise[best])
        total = (_wave_variance(state.noise[best]) + NOISE_VARIANCE) / (wave + NOISE_VARIANCE)
        known = min(1.0, float(total.min())) if state.count < NOISE_TICKS else 1.0
        # 2. predict
        mean, P = self._predicted(state, wave, dt_s)
        # 3. innovations of all hypotheses, and their likelihoods
        H = self._H0.copy()
        H[:, :, 3 : 3 + self._n] = self._by_f * np.where(self._sticks, 1.0, f_n)
        nu = w - self._offset_f @ f_n - self._offset_a @ a_m_s2 - np.einsum("kij,kj->ki", H, mean)
        HP = H @ P
        S = HP @ H.transpose(0, 2, 1) + np.diag(NOISE_VARIANCE)
        inverse = np.linalg.inv(S)
        log_likelihood = -0.5 * (np.einsum("ki,kij,kj->k", nu, inverse, nu) + np.linalg.slogdet(S)[1])
        # 4. update
        K = HP.transpose(0, 2, 1) @ inverse
        mean += np.einsum("kij,kj->ki", K, nu)
        P -= K @ HP
        P = (P + P.transpose(0, 2, 1)) / 2  # or errors of rounding grow
        # 5. cumulative sums, in waves with a memory; a hypothesis that is no better than `sound` begins afresh from it
        #    one reading tells MOST at most, of the best against `sound`; what is behind the best stays behind
        gained = TEMPER * (log_likelihood - log_likelihood[0])
        excess = max(0.0, float(gained.max()) - MOST)
        is_rough = (wave > WAVE_MARGIN * NOISE_VARIANCE).any()
        kept = known * (np.exp(-dt_s / MEMORY_S) if is_rough else 1.0)
        nats = kept * state.nats + np.where(gained > 0.0, np.maximum(gained - excess, 0.0), np.maximum(gained, -MOST))
        beyond = max(0.0, nats.max() - CEILING)
        nats -= beyond
        anew = nats <= 0.0
        nats[anew], anew[0] = 0.0, False
        peak = np.maximum(np.where(anew, 0.0, kept * state.peak - beyond), nats)
        mean[anew], P[anew] = self._afresh(anew, mean[0], P[0])
        age_s = np.where(anew, 0.0, state.age_s + dt_s)
        rough_s = state.rough_s + dt_s if is_rough else 0.0
        return BankState(mean, P, nats, age_s, noise, peak, past, state.count + 1, rough_s)

    def _predicted(self, state: BankState, wave: np.ndarray, dt_s: float) -> tuple[np.ndarray, np.ndarray]:
        """A tick later: d forgets itself in D_TIME_S, waves of variances `wave` (3,) go on, what has just stuck spins
        up or down.
        """
        F, decay, axes = np.eye(self._size), np.exp(-dt_s / D_TIME_S), np.arange(3)
        Phi, new = transition(dt_s)
        F[axes, axes] = decay
        for states in self._waves:
            F[states, states] = Phi
        mean, P = state.mean @ F.T, F @ state.P @ F.T
        P[:, axes, axes] += (1 - decay**2) * self._d_sigma**2
        for states, variance in zip(self._waves, wave, strict=True):
            P[:, states, states] += variance * new
        P[:, -1, -1] += (state.age_s < SPIN_UP_S) * self._free[:, -1] * SPIN_UP_N**2 * dt_s
        return mean, P

    def _learned(self, state: BankState, past: Sequence[tuple[np.ndarray, np.ndarray]], dt_s: float) -> np.ndarray:
        """Noise (K, 3) with one change more: of half a second, without what each hypothesis makes of the forces."""
        if len(past) < 6:
            return state.noise
        by_f = self._by_f * np.where(self._sticks, 0.0, state.mean[:, None, 3 : 3 + self._n]) + self._offset_f
        changed = past[-1][0] - past[0][0] - by_f @ (past[-1][1] - past[0][1])
        return state.noise + min(1.0, dt_s / 3.0) * (changed**2 / 2 - state.noise)

    def _afresh(self, which: np.ndarray, mean: np.ndarray, P: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What `sound` knows, but for what each of these hypotheses is free in."""
        free, kept = self._free[which], ~self._free[which]
        P = P * kept[:, :, None] * kept[:, None, :]
        diagonal = np.arange(P.shape[1])
        P[:, diagonal, diagonal] += free * self._variance0[which]
        return np.where(free, self._mean0[which], mean), P

    def _measurements(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """H0 (K, 3, 10 + n), by_f and offset_f (K, 3, n), offset_a (K, 3, 2): with these

        w = (H0 + [0 by_f * f 0 0]) x + offset_f f + offset_a a     (by_f alone for one that sticks)
        """
        n, K, B = self._n, len(self.hypotheses), self.B
        H0, by_f, offset_f, offset_a = (np.zeros((K, 3, m)) for m in (self._size, n, n, 2))
        H0[:, :, :3], by_f[:] = np.eye(3), B
        for axis, states in enumerate(self._waves):
            H0[:, axis, states] = 0.0, 1.0
        for k, h in enumerate(self.hypotheses):
            if self._blamed[k]:
                continue
            if h.kind == "stuck":
                H0[k, :, -1], by_f[k, :, h.i], offset_f[k, :, h.i] = B[:, h.i], 0.0, -B[:, h.i]
            elif h.kind == "swap":
                offset_f[k, :, h.j] = B[:, h.i] - B[:, h.j]
                offset_f[k, :, h.i] = -offset_f[k, :, h.j]
            elif h.kind == "reversed":
                offset_f[k] = -2.0 * B
            elif h.kind == "accel":
                H0[k, :, :2] = self.M[:, :2]
            elif h.kind == "askew":
                offset_a[k] = self.M[:, :2] @ (AXES[h.i] - np.eye(2))
        offset_f[:, :, self._sticks] = -B[:, self._sticks]
        return H0, by_f, offset_f, offset_a


def _wave_variance(noise: np.ndarray) -> np.ndarray:
    """Of waves (3,): what the best hypothesis about thrusters leaves beyond NOISE; a fault is not noise."""
    return WAVE_MARGIN * np.maximum(noise - NOISE_VARIANCE, 0.0)
