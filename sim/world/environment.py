"""Water and air around the boat, drawn from a seed: current, wind with gusts, waves.

    current   V_c towards beta_c, turning by `turn_deg_s`
    wind      V_w (1 + g), g a Gauss-Markov gust of `gustiness` and `gust_time_s`
    sea       body force and moment from 24 sinusoids round the peak period, random phases, no mean
    waves     of the vessel file's term: a narrow band of force along one direction over ground (`effects.waves`)

Wave loads are first-order and scaled per metre of significant height with figures for this size of hull:
assumed. Roll and pitch follow the same sinusoids.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from msgspec import Meta

from companion.core.configuration.vessel_file import VesselFile
from companion.core.model.effects.current import direction_deg
from companion.core.model.effects.waves import next_phasor
from companion.core.model.loads import values
from sim import world_limits as limits

GUST_TIME_S = 10.0  # assumed
WAVE_FORCE_N_M = np.array([60.0, 90.0, 15.0])  # amplitude of X, Y [N/m], N [N m/m] per metre of H_s; assumed
WAVE_TILT_RAD_M = np.array([0.25, 0.15])  # roll, pitch amplitude per metre of H_s; assumed


Direction = Annotated[float, Meta(ge=-limits.ANGLE_DEG, le=limits.ANGLE_DEG)]


@dataclass(frozen=True)
class Weather:
    """What the world is like. Directions in degrees from north: current towards, wind and waves from.

    Current, wind, height of waves that nobody states (None) are the vessel file's (`with_terms_of`), or none.
    """

    V_c_m_s: Annotated[float, Meta(ge=0, le=limits.CURRENT_M_S)] | None = None
    beta_c_deg: Direction = 0.0
    turn_deg_s: Annotated[float, Meta(ge=-limits.TURN_DEG_S, le=limits.TURN_DEG_S)] = 0.0
    V_w_m_s: Annotated[float, Meta(ge=0, le=limits.WIND_M_S)] | None = None
    beta_w_deg: Direction = 0.0
    gustiness: Annotated[float, Meta(ge=0, le=limits.GUSTINESS)] = 0.0
    H_s_m: Annotated[float, Meta(ge=0, le=limits.WAVES_M)] | None = None
    T_p_s: Annotated[float, Meta(ge=limits.WAVE_PERIOD_S[0], le=limits.WAVE_PERIOD_S[1])] = 2.0
    gust_time_s: Annotated[float, Meta(ge=limits.GUST_TIME_S[0], le=limits.GUST_TIME_S[1])] = GUST_TIME_S
    waves: Mapping[str, float] | None = None


OWN_WEATHER = {
    "current": ("V_c_m_s", "beta_c_deg", "turn_deg_s"),
    "wind": ("V_w_m_s", "beta_w_deg", "gustiness", "gust_time_s"),
}
"""Parameters of the vessel file's terms that are weather, by term; the first one of size."""


def with_terms_of(weather: Weather, vessel: VesselFile) -> Weather:
    """The weather asked for; what it does not state of current, wind and waves is of the vessel file's own terms.

    Turn and gusts that are asked for without a speed are those of the file's current and wind, where it states none.
    """
    for name, keys in OWN_WEATHER.items():
        if name in vessel.terms and getattr(weather, keys[0]) is None:
            own = values(name, vessel.terms[name])
            weather = replace(weather, **{key: own[key] or getattr(weather, key) for key in keys})
    if "waves" in vessel.terms and weather.H_s_m is None:
        weather = replace(weather, waves=values("waves", vessel.terms["waves"]))
    return weather


@dataclass(frozen=True)
class Moment:
    """The environment at one instant, as the plant's model takes it; roll and pitch with two derivatives.

    `wave_n` (3,): force of the sea in body axes; `along_waves_n`: that of waves along one direction over ground, a.
    """

    V_c_m_s: float
    beta_c_deg: float
    V_w_m_s: float
    beta_w_deg: float
    wave_n: np.ndarray
    phi_rad: float
    theta_rad: float
    tilt_rate_rad_s: tuple[float, float] = (0.0, 0.0)
    tilt_rate_rad_s2: tuple[float, float] = (0.0, 0.0)
    along_waves_n: float = 0.0
    beta_wave_deg: float = 0.0


class Environment:
    """Advances gusts and phases; the same weather and seed give the same history."""

    def __init__(self, weather: Weather, rng: np.random.Generator):
        self._weather, self._rng = weather, rng
        self._gust, self._phasor = 0.0, 0j
        spread = rng.uniform(0.75, 1.35, 24)
        self._omega = 2 * np.pi / weather.T_p_s * spread
        self._phase = rng.uniform(0, 2 * np.pi, (5, 24))
        self._amplitude = np.exp(-(((spread - 1) / 0.15) ** 2))
        self._amplitude /= np.sqrt((self._amplitude**2).sum())
        if weather.waves and weather.waves["F_w_N"]:
            self._phasor = complex(*rng.normal(size=2))

    def step(self, t_s: float, dt_s: float) -> Moment:
        """Environment at `t_s`, `dt_s` after the last call."""
        w = self._weather
        if w.gustiness:
            decay = np.exp(-dt_s / w.gust_time_s)
            self._gust = decay * self._gust + w.gustiness * np.sqrt(1 - decay**2) * self._rng.normal()
        waves, tilt, along, beta = np.zeros(3), np.zeros((3, 2)), 0.0, 0.0
        if w.waves and w.waves["F_w_N"]:
            self._phasor = next_phasor(w.waves, self._phasor, dt_s, complex(*self._rng.normal(size=2)))
            along, beta = w.waves["F_w_N"] * self._phasor.real, w.waves["beta_wave_deg"]
        if w.H_s_m:
            elevation = (self._amplitude * np.sin(self._omega * t_s + self._phase)).sum(axis=1)
            waves = WAVE_FORCE_N_M * w.H_s_m * elevation[:3]
            tilt = WAVE_TILT_RAD_M * w.H_s_m * np.array([elevation[3:], *self._slopes(t_s)])
        return Moment(
            w.V_c_m_s or 0.0,
            direction_deg(w.beta_c_deg, w.turn_deg_s, t_s),
            max(0.0, (w.V_w_m_s or 0.0) * (1 + self._gust)),
            w.beta_w_deg,
            waves,
            float(tilt[0, 0]),
            float(tilt[0, 1]),
            (float(tilt[1, 0]), float(tilt[1, 1])),
            (float(tilt[2, 0]), float(tilt[2, 1])),
            along,
            beta,
        )

    def _slopes(self, t_s: float) -> tuple[np.ndarray, np.ndarray]:
        """First and second derivative of the sinusoids of roll and pitch."""
        angle = self._omega * t_s + self._phase[3:]
        rate = (self._amplitude * self._omega * np.cos(angle)).sum(axis=1)
        return rate, -(self._amplitude * self._omega**2 * np.sin(angle)).sum(axis=1)
