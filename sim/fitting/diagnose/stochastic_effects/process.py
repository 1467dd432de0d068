"""Likelihood of residual accelerations: ambient noise in body axes and one random process that acts by a pattern.

    c_dot = -g c - w s + noise,  s_dot = w c - g s + noise     c of unit size (w = 0: Gauss-Markov)
    n_dot = -n / T_n + noise                                   ambient, three axes
    rho_dot = -rho / T_r + p_3(t) c + n_3
    y = [p_1(t) c + n_1, p_2(t) c + n_2, rho] + white

by a Kalman filter over all blocks and all hypotheses at once (last axis of every array), each block from the stationary
state. Processes with spectra of their own: Harvey (1989), Forecasting, structural time series models, 2.3 and 3.4.
"""

from __future__ import annotations

import numpy as np

from sim.fitting.diagnose.stochastic_effects.residual_acceleration import ResidualAcceleration

AMBIENT, WHITE, TIME = slice(0, 3), slice(3, 6), 6
NUISANCE = 7
"""log of: ambient sigma [m/s^2, m/s^2, rad/s^2], white sigma of a mean [m/s^2, m/s^2, rad/s], ambient time [s]."""
C, S, N, RHO = 0, 1, slice(2, 5), 5
LOG_2PI = float(np.log(2 * np.pi))


def log_likelihood(
    data: ResidualAcceleration,
    nuisance: np.ndarray,
    pattern: np.ndarray,
    decay_1_s: np.ndarray,
    omega_rad_s: np.ndarray,
) -> np.ndarray:
    """Log likelihood (h,) of h hypotheses [nats].

    nuisance (h, 7); pattern (T, 3, h, B) times the process's size; decay g (h,) [1/s]; angular frequency w (h,).
    """
    # 1. Discrete transition, process noise, and the stationary covariance at the beginning of each block.
    T, _, h, B = pattern.shape
    R = h * B

    def each(values: np.ndarray) -> np.ndarray:
        return np.repeat(values, B)

    sigma, white = np.exp(nuisance[:, AMBIENT]).T, np.exp(2 * nuisance[:, WHITE]).T
    variance, white = np.repeat(sigma**2, B, axis=1), np.repeat(white, B, axis=1)
    dt = data.step_s
    keep_n = each(np.exp(-dt / np.exp(nuisance[:, TIME])))
    keep, turn = each(np.exp(-decay_1_s * dt)), each(omega_rad_s * dt)
    cos, sin, keep_rho = keep * np.cos(turn), keep * np.sin(turn), float(np.exp(-data.yaw_rate_1_s * dt))
    noise = np.concatenate([np.tile(1 - keep**2, (2, 1)), variance * (1 - keep_n**2)])
    x, P = np.zeros((6, R)), np.zeros((6, 6, R))
    P[[C, S], [C, S]] = 1.0
    P[[2, 3, 4], [2, 3, 4]] = variance
    P[RHO, RHO] = white[2]
    total = np.zeros(R)
    y, p = np.tile(data.y, (1, 1, h)), pattern.reshape(T, 3, R)
    diagonal = np.arange(5)
    # 2. Kalman filter: scalar updates channel by channel, then prediction P = F P F^T + Q.
    for k in range(T):
        for i in range(3):
            total += _update(x, P, y[k, i], p[k, i], i, white[i])
        push = dt * p[k, 2]

        def advance(v: np.ndarray, push: np.ndarray = push) -> np.ndarray:
            out = np.empty_like(v)
            out[C], out[S] = cos * v[C] - sin * v[S], sin * v[C] + cos * v[S]
            out[N] = keep_n * v[N]
            out[RHO] = keep_rho * v[RHO] + push * v[C] + dt * v[4]
            return out

        x = advance(x)
        P = advance(advance(P).swapaxes(0, 1))
        P[diagonal, diagonal] += noise
    return total.reshape(h, B).sum(axis=1)


def _update(x: np.ndarray, P: np.ndarray, y: np.ndarray, p: np.ndarray, channel: int, white: np.ndarray) -> np.ndarray:
    """Kalman update of x (6, R), P (6, 6, R) in place by one channel; its log likelihood (R,), 0 without a sample."""
    known = np.isfinite(y)
    if not known.any():
        return np.zeros(len(y))
    if channel < 2:
        column, mean = p * P[C] + P[2 + channel], p * x[C] + x[2 + channel]
        variance = p * column[C] + column[2 + channel] + white
    else:
        column, mean = P[RHO], x[RHO]
        variance = column[RHO] + white
    innovation = np.where(known, y - mean, 0.0)
    gain = np.where(known, column / variance, 0.0)
    x += gain * innovation
    P -= gain[:, None] * column[None]
    return np.where(known, -0.5 * (innovation**2 / variance + np.log(variance) + LOG_2PI), 0.0)
