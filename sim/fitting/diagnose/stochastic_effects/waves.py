"""Waves: a narrow band of force along one direction over ground, by a pattern in body axes.

Equation: `companion.core.model.effects.waves`; a has rms F_w, a spectral peak at 1 / T_p, relative half width `width`.

1. Screening: residual accelerations are projected on the pattern of each direction (|pattern| never vanishes), and one
   band of the periodogram is compared with its neighbours (Whittle: k ordinates whose mean is R times the background
   gain k (R - 1 - log R) nats).
2. The best band is fitted by the likelihood in `process`, and tested against ambient noise alone and against the same
   band of a force fixed to the body axes (an oscillating controller does not depend on north).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.core.model.effects.waves import WIDTH, pattern
from sim.fitting.diagnose.stochastic_effects.ambient import SCALE as NUISANCE_SCALE
from sim.fitting.diagnose.stochastic_effects.ambient import fit_ambient, initial_noise, nats_over, with_noise_prior
from sim.fitting.diagnose.stochastic_effects.estimate import PosteriorPeak, fit_peak, maximise, normal_log_density
from sim.fitting.diagnose.stochastic_effects.process import NUISANCE, log_likelihood
from sim.fitting.diagnose.stochastic_effects.residual_acceleration import ResidualAcceleration

STEP_S, BLOCK_S = 0.2, 30.0
SMALLEST_N = 0.4
BROAD = 0.12  # width beyond which the form is in doubt; assumed
MOST_WIDTH = 0.4  # width beyond which it is no band but sudden forces, such as gusts; assumed
PERIODS_S = (0.9, 8.0)  # within which a small boat's waves lie; assumed
OTHER = 0.5  # power of a second peak over that of the first; assumed
BESIDE = (0.55, 0.6, 0.65, 0.7, 0.75, 0.8, 1.2, 1.27, 1.35, 1.43, 1.52, 1.62, 1.75)  # frequencies over the peak's
STEPS = 20  # of each search
QUICK_NATS = 25.0  # nats of the screening from which the likelihood is fitted
TAPER_LOSS = 1.94  # factor by which a Hann window's correlation reduces independent ordinates
MASS_SHARE = 0.04  # relative sigma of the boat's mass, and of the force with it
DIRECTIONS = 12  # of the screening, over half a turn
F, T_P, BETA, BAND = range(NUISANCE, NUISANCE + 4)  # log N, log s, rad, log
OWN_SCALE = np.array([0.1, 0.02, 0.1, 0.2])


@dataclass(frozen=True)
class WaveScreening:
    """Result of the screening: F_w [N], T_p [s], direction modulo pi [rad], nats."""

    F_w_N: float
    T_p_s: float
    beta_rad: float
    nats: float


@dataclass(frozen=True)
class WaveEstimate:
    """Posterior of [noise, log F_w, log T_p, beta, log width]; nats over ambient noise and over a body-fixed band."""

    posterior: PosteriorPeak
    nats: float
    over_body_fixed: float

    @property
    def T_p_s(self) -> float:
        """Period of the spectral peak [s]."""
        return float(np.exp(self.posterior.at[T_P]))

    @property
    def beta_rad(self) -> float:
        """Direction they come from [rad]."""
        return float(self.posterior.at[BETA] % (2 * np.pi))

    @property
    def width(self) -> float:
        """Relative half width of the band."""
        return float(np.exp(self.posterior.at[BAND]))

    @property
    def broad(self) -> bool:
        """Whether the band is broader than the entry's form."""
        return self.width > BROAD


def wave_force(q: np.ndarray) -> np.ndarray:
    """Body force (T, 3, n) of a = 1 N at angles q (T, n)."""
    return np.stack(pattern(q), axis=1)


def screen_waves(data: ResidualAcceleration) -> WaveScreening:
    """Screening: the best direction and band; `data` in blocks of whole logs."""
    B = data.y.shape[2]
    best = WaveScreening(0.0, 1.0, 0.0, -np.inf)
    for beta in np.arange(DIRECTIONS) * np.pi / DIRECTIONS:
        frequency, power = _projected(data, beta)
        power = power.mean(axis=1)
        for period in np.exp(np.arange(np.log(PERIODS_S[0]), np.log(PERIODS_S[1]), WIDTH)):
            ratio, background, count = _contrast(frequency, power, 1 / period)
            nats = count * B * (ratio - 1 - np.log(ratio)) / 1.5 if ratio > 1 else 0.0  # taper: correlated ordinates
            if nats > best.nats:
                rms = np.sqrt(max(ratio - 1, 0.0) * background * count * frequency[1])
                best = WaveScreening(float(rms), float(period), float(beta), float(nats))
    return best


def _projected(data: ResidualAcceleration, beta: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies [Hz] and one-sided spectra (k, B) [N^2/Hz] of the force that acts by the pattern of a direction."""
    p = data.pattern(wave_force(beta + np.pi - data.x[:, 2]))[:, :2]
    a = (np.nan_to_num(data.y[:, :2]) * p).sum(axis=1) / (p**2).sum(axis=1)
    taper = np.hanning(len(a))[:, None] * np.isfinite(data.y[:, 0])
    power = np.abs(np.fft.rfft(taper * a, axis=0)) ** 2 * 2 * data.step_s / np.maximum((taper**2).sum(axis=0), 1e-9)
    return np.fft.rfftfreq(len(a), data.step_s), power


def rms_force(data: ResidualAcceleration, beta: float, period_s: float) -> tuple[float, float]:
    """F_w [N] from the power in the band, whatever its shape, and its relative standard error.

    Ordinates of a periodogram are exponential: var(sum) = sum of S^2, and S^2 is half the mean of its square. Near zero
    power the relative error of the root is the root of that of the power.
    """
    frequency, power = _projected(data, beta)
    off = frequency * period_s
    inside = (off > 0.7) & (off < 1.4)
    background = np.median(power[((off > 0.5) & (off < 0.7)) | ((off > 1.4) & (off < 2.0))]) / np.log(2.0)
    total = max(float((power[inside] - background).sum()), 1e-12)
    spread = TAPER_LOSS * float((power[inside] ** 2).sum()) / 2 / total**2
    rms = np.sqrt(total * frequency[1] / power.shape[1]) / np.sinc(data.step_s / period_s)
    share = min(np.sqrt(spread) / 2, spread**0.25)
    return float(rms), float(np.hypot(share, MASS_SHARE))


def beside_peak(data: ResidualAcceleration, beta: float, period_s: float) -> float:
    """Highest power beside the peak over that at the peak: above `OTHER` there are two, or the band is broad."""
    frequency, power = _projected(data, beta)
    off, power = frequency * period_s, power.mean(axis=1)
    background = float(np.median(power[(off > 0.4) & (off < 2.5)]))

    def level(at: float) -> float:
        away = np.abs(off / at - 1)
        return float(power[(away < 0.05) | (away == away.min())].mean()) - background  # one at least, of a short log

    return max(level(at) for at in BESIDE) / max(level(1.0), 1e-12)


def _contrast(frequency: np.ndarray, power: np.ndarray, centre: float) -> tuple[float, float, int]:
    """Mean power within 10 % of a frequency over the background around it; the background; number of ordinates."""
    off = frequency / centre
    inside = np.abs(off - 1) < 0.1
    around = ((off > 0.6) & (off < 0.8)) | ((off > 1.25) & (off < 1.7))
    if inside.sum() < 2 or around.sum() < 4:
        return 1.0, 1.0, 0
    background = max(float(np.median(power[around])), 1e-30) * 1.05  # mean over median, of a mean of few periodograms
    return float(power[inside].mean()) / background, background, int(inside.sum())


def fit_waves(data: ResidualAcceleration, seen: WaveScreening) -> WaveEstimate:
    """Fit of the likelihood from the screening's result, and of its rival, a body-fixed band."""
    about = initial_noise(data)
    noise, height = fit_ambient(data, about)

    def own(q: np.ndarray) -> np.ndarray:
        return _nats(data, q) + _prior(q)

    f = with_noise_prior(data, about, own)
    scale = np.concatenate([NUISANCE_SCALE, OWN_SCALE])
    begin = [np.log(max(seen.F_w_N, 0.1)), np.log(seen.T_p_s), seen.beta_rad, np.log(WIDTH)]
    starts = np.array([[*about, *begin], [*about, *begin], [*noise, *begin], [*noise, *begin]])
    starts[1::2, BETA] += np.pi
    top = fit_peak(f, starts[int(f(starts).argmax())], scale, STEPS)
    _, rival = maximise(lambda q: _own_band(data, q) + _rival_prior(data, q, about), *_rival_start(data, top), STEPS)
    return WaveEstimate(top, nats_over(height, top), top.height - rival)


def _nats(data: ResidualAcceleration, q: np.ndarray) -> np.ndarray:
    T, _, B = data.y.shape
    angle = q[:, BETA][None, :, None] + np.pi - data.x[:, 2][:, None, :]
    period = np.exp(q[:, T_P])
    size = np.exp(q[:, F]) * np.sinc(data.step_s / period)
    pattern = data.pattern(wave_force(angle.reshape(T, -1))).reshape(T, 3, len(q), B) * size[:, None]
    return _banded(data, q, pattern)


def _banded(data: ResidualAcceleration, q: np.ndarray, pattern: np.ndarray) -> np.ndarray:
    omega = 2 * np.pi / np.exp(q[:, T_P])
    return log_likelihood(data, q[:, :NUISANCE], pattern, np.exp(q[:, BAND]) * omega, omega)


def _prior(q: np.ndarray) -> np.ndarray:
    size = normal_log_density(q[:, F], float(np.log(3 * SMALLEST_N)), 1.0) - np.log(2 * np.pi)
    return size + _band_prior(q)


def _band_prior(q: np.ndarray) -> np.ndarray:
    low, high = np.log(PERIODS_S)
    outside = np.maximum(np.abs(q[:, T_P] - (low + high) / 2) - (high - low) / 2, 0.0)
    return normal_log_density(q[:, BAND], float(np.log(WIDTH)), 0.7) - np.log(high - low) - 0.5 * (outside / 0.02) ** 2


def _own_band(data: ResidualAcceleration, q: np.ndarray) -> np.ndarray:
    """Log likelihood (h,) of a body-fixed band: columns F, BETA and the last are its components in the channels."""
    T, _, B = data.y.shape
    fixed = np.stack([q[:, F], q[:, BETA], q[:, -1]])
    pattern = np.broadcast_to(fixed[None, :, :, None], (T, 3, len(q), B))
    return _banded(data, q, pattern)


def _rival_start(data: ResidualAcceleration, top: PosteriorPeak) -> tuple[np.ndarray, np.ndarray]:
    """Start and scale of the rival: noise and band of the waves, with their rms in each channel."""
    rms = np.sqrt((data.pattern(wave_force(top.at[BETA] + np.pi - data.x[:, 2])) ** 2).mean(axis=(0, 2)))
    rms *= np.exp(top.at[F])
    start = np.append(top.at, rms[2])
    start[F], start[BETA] = rms[0], rms[1]
    scale = np.concatenate([NUISANCE_SCALE, OWN_SCALE, [0.2 * rms[2]]])
    scale[[F, BETA]] = 0.2 * rms[:2]
    return start, scale


def _rival_prior(data: ResidualAcceleration, q: np.ndarray, about: np.ndarray) -> np.ndarray:
    return with_noise_prior(data, about, _band_prior)(q)
