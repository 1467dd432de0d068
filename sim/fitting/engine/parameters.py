"""The parameters of the fit: what is estimated of a boat, within which physical limits, with which priors.

Two vectors of P numbers describe the same boat:

    q   in the vessel file's units and signs: M11 M22 M33 M23 | X_u Y_v N_r Y_r N_v X_uu Y_vv N_rr | gains |
        t_d T_lag | latency arm | warp | trims | azimuths | curves | astern shares | terms
    w   unconstrained: every w gives positive definite inertia and damping, so a free motion that loses energy

    M11, M22, M33 = e^w,  M23 = sqrt(M22 M33) tanh w            M > 0
    X_u, Y_v, N_r, X_uu, Y_vv, N_rr = -e^w                      damping > 0
    Y_r + N_v = -2 sqrt(Y_v N_r) tanh w,  Y_r - N_v = -w        D + D^T > 0
    gains, t_d, T_lag = e^w, gains times the sign that the file has (dead: 0)
    latency, arm, warp, trims, azimuths = w;  curves = tanh w   force rises with the command
    astern shares = e^w
    terms' parameters: e^w or -e^w where their bounds allow one sign only, else w

Trim, azimuth and curve are estimated for thrusters with a pitch map (blades set by linkages), the share astern of each
other map that states one; of the terms in the vessel file those parameters that the registry marks as fitted, and an
advance loss that it states. The warp W (2 x 2) models how range biases and surveying errors bend the positions:
measured = p + W (p - middle). Mass and added mass enter the motion only through M: motion cannot separate them. Every w
has a normal prior around the file's value.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import casadi as ca
import numpy as np

from companion.core.configuration.vessel_file import PitchMap, VesselFile
from companion.core.model.effects.term import LoadParameter
from companion.core.model.manoeuvring import linear_damping, mass_matrix
from sim.fitting.engine.free_parameters import IMU, SURROUNDINGS, PriorSigmas, fitted_terms, stated
from sim.fitting.engine.thrust.fitted import adjustable, astern_maps, astern_share, pitch_maps

INERTIA = ("M11_kg", "M22_kg", "M33_kg_m2", "M23_kg_m")
DAMPING = (
    "X_u_N_s_m",
    "Y_v_N_s_m",
    "N_r_N_m_s",
    "Y_r_N_s",
    "N_v_N_s",
    "X_uu_N_s2_m2",
    "Y_vv_N_s2_m2",
    "N_rr_N_m_s2",
)
HULL = INERTIA + DAMPING
SENSORS = ("uwb_latency_s", "tag_x_m", "tag_y_m")
WARP = ("warp_nn", "warp_ne", "warp_en", "warp_ee")
REACH_M = 10.0  # distance over which biases of anchors change: a third of the basin
_LOG = (0, 1, 2, 4, 5, 6, 9, 10, 11)  # entries of HULL whose w is a logarithm
_M23, _SUM, _DIFF = 3, 7, 8  # entries of w for M23, Y_r + N_v, Y_r - N_v
EITHER_SHARE = 0.02  # prior sigma of a parameter that may have either sign, as a share of its bounds; assumed
LEAST_TERM = 1e-3  # start of a parameter of one sign that is 0 in the file, whose logarithm would be infinite


@dataclass(frozen=True)
class Parameters:
    """Names, priors and the maps between w and q for one vessel file.

    `overrides`: name -> (centre in file units or None for the file's value, sigma of w). A sigma of 0 fixes it.
    `surroundings`: current and wind, the same in all runs, are fitted too; no property of the boat.
    `unmeasured_imu`: the IMU's lever arm and the compass's hard iron are fitted too.
    The slices below are places in q and w alike.
    """

    vessel: VesselFile
    sigmas: PriorSigmas = field(default_factory=PriorSigmas)
    overrides: Mapping[str, tuple[float | None, float]] | None = None
    surroundings: bool = False
    unmeasured_imu: bool = False

    @cached_property
    def _terms(self) -> tuple[tuple[str, LoadParameter], ...]:
        """Terms and their parameters that are fitted."""
        return fitted_terms(self.vessel, self.surroundings)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the P parameters, in the order of q and w."""
        gains = tuple(f"gain_{t.name}" for t in self.vessel.thrusters)
        able = [self.vessel.thrusters[i].name for i in adjustable(self.vessel)]
        trims = tuple(f"trim_{name}_us" for name in able)
        azimuths = tuple(f"azimuth_{name}_deg" for name in able)
        curves = tuple(f"curve_{name}" for name in pitch_maps(self.vessel))
        asterns = tuple(f"astern_{name}" for name in astern_maps(self.vessel))
        terms = tuple(p.name for _, p in self._terms)
        return (
            HULL
            + gains
            + ("dead_time_s", "lag_s")
            + SENSORS
            + WARP
            + trims
            + azimuths
            + curves
            + asterns
            + terms
            + IMU * self.unmeasured_imu
        )

    @property
    def thrusters(self) -> slice:
        """Gains of all n thrusters."""
        return slice(len(HULL), len(HULL) + len(self.vessel.thrusters))

    @cached_property
    def warp(self) -> slice:
        """Entries of the warp W, by row."""
        first = self.names.index(WARP[0])
        return slice(first, first + len(WARP))

    @cached_property
    def trims(self) -> slice:
        """Trims [us], in the order of `adjustable`."""
        return slice(self.warp.stop, self.warp.stop + len(adjustable(self.vessel)))

    @cached_property
    def azimuths(self) -> slice:
        """Azimuths [deg], in the order of `adjustable`."""
        return slice(self.trims.stop, 2 * self.trims.stop - self.trims.start)

    @cached_property
    def curves(self) -> slice:
        """Curves of the pitch maps, in the order of `pitch_maps`."""
        return slice(self.azimuths.stop, self.azimuths.stop + len(pitch_maps(self.vessel)))

    @cached_property
    def curve_of(self) -> np.ndarray:
        """Selection matrix (a, curves): row i is 1 at the curve of the i-th adjustable thruster."""
        maps, able = pitch_maps(self.vessel), adjustable(self.vessel)
        return np.array([[self.vessel.thrusters[i].force_map == m for m in maps] for i in able], dtype=float)

    @cached_property
    def asterns(self) -> slice:
        """Shares astern, in the order of `astern_maps`."""
        return slice(self.curves.stop, self.curves.stop + len(astern_maps(self.vessel)))

    @cached_property
    def astern_of(self) -> np.ndarray:
        """Selection matrix (n, shares): row i is 1 at the share astern of thruster i."""
        maps = astern_maps(self.vessel)
        return np.array([[t.force_map == m for m in maps] for t in self.vessel.thrusters], dtype=float)

    @cached_property
    def astern_stated(self) -> np.ndarray:
        """Each thruster's share astern in the vessel file (n,); 1 where its map states none."""
        maps = (self.vessel.force_maps[t.force_map] for t in self.vessel.thrusters)
        return np.array([astern_share(m) or 1.0 for m in maps])

    @cached_property
    def terms(self) -> slice:
        """Parameters of the terms, in the order of `fitted_terms`."""
        return slice(self.asterns.stop, self.asterns.stop + len(self._terms))

    @property
    def imu(self) -> slice:
        """Lever arm of the IMU, x and y [m], and hard iron, cos and sin [rad]; empty where the file is believed."""
        return slice(self.terms.stop, len(self.names))

    @cached_property
    def moving(self) -> np.ndarray:
        """Indices of the parameters that change the motion: all but latency, place and warp of the position sensor."""
        return np.r_[0 : self.thrusters.stop + 2, self.warp.stop : self.terms.stop]

    @cached_property
    def _gain_signs(self) -> np.ndarray:
        """Sign of each gain (n,): 1, -1 for a reversed thruster, 0 for a dead one."""
        return np.sign([t.gain for t in self.vessel.thrusters])

    @cached_property
    def _term_signs(self) -> np.ndarray:
        """Sign that the bounds of each term's parameter allow: 1, -1, or 0 for either."""
        return np.array([np.sign(p.lower + p.upper) * (p.lower * p.upper >= 0) for _, p in self._terms])

    @cached_property
    def _maps(self) -> tuple[ca.Function, ca.Function]:
        w = ca.SX.sym("w", len(self.names))
        q = self._file_units(w)
        return ca.Function("q", [w], [q]), ca.Function("dq", [w], [ca.densify(ca.jacobian(q, w))])

    def _file_units(self, w: ca.SX) -> ca.SX:
        n_log = self.thrusters.stop + 2
        e = ca.exp(w[:n_log])
        half_sum = -ca.sqrt(e[5] * e[6]) * ca.tanh(w[_SUM])
        half_diff = -w[_DIFF] / 2
        return ca.vertcat(
            e[:3],
            ca.sqrt(e[1] * e[2]) * ca.tanh(w[_M23]),
            -e[4:7],
            half_sum + half_diff,
            half_sum - half_diff,
            -e[9:12],
            e[self.thrusters] * ca.DM(self._gain_signs),
            e[self.thrusters.stop :],
            w[n_log : self.curves.start],
            ca.tanh(w[self.curves]),
            ca.exp(w[self.asterns]),
            *(s * ca.exp(x) if s else x for s, x in zip(self._term_signs, ca.vertsplit(w[self.terms]), strict=True)),
            w[self.imu],
        )

    def file_units(self, w: np.ndarray) -> np.ndarray:
        """q (P,) of w (P,)."""
        return self._maps[0](w).full().ravel()

    def jacobian(self, w: np.ndarray) -> np.ndarray:
        """dq/dw, (P, P)."""
        return self._maps[1](w).full()

    def unconstrained(self, q: np.ndarray) -> np.ndarray:
        """w (P,) of q (P,). Damping that is zero or of the wrong sign becomes small and of the right sign."""
        w = np.array(q, dtype=float)
        linear = np.maximum(-q[4:7], 1e-3 * np.abs(q[4:7]).max() + 1e-9)
        d = np.concatenate([linear, np.maximum(-q[9:12], 0.02 * linear)])
        w[:3], w[4:7], w[9:12] = np.log(q[:3]), np.log(d[:3]), np.log(d[3:])
        w[_M23] = np.arctanh(np.clip(q[3] / np.sqrt(q[1] * q[2]), -0.99, 0.99))
        w[_SUM] = np.arctanh(np.clip(-(q[7] + q[8]) / (2 * np.sqrt(d[1] * d[2])), -0.99, 0.99))
        w[_DIFF] = -(q[7] - q[8])
        tail = slice(len(HULL), self.thrusters.stop + 2)
        w[tail] = np.log(np.maximum(np.abs(q[tail]), 1e-3))
        w[self.curves] = np.arctanh(np.clip(q[self.curves], -0.99, 0.99))
        w[self.asterns] = np.log(q[self.asterns])
        for i, sign in enumerate(self._term_signs, self.terms.start):
            w[i] = np.log(max(sign * q[i], LEAST_TERM)) if sign else q[i]
        return w

    @cached_property
    def prior(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean and standard deviation of w, (P,) each. The overrides apply last."""
        q, s = file_values(self.vessel, self.surroundings, self.unmeasured_imu), self.sigmas
        sigma = np.full(len(q), s.hull)
        sigma[[_M23, _SUM]] = s.coupling
        sigma[_DIFF] = s.coupling * 2 * np.sqrt(q[5] * q[6])
        sigma[self.thrusters] = [s.gain if t.gain_sigma is None else t.gain_sigma for t in self.vessel.thrusters]
        at = self.thrusters.stop
        sigma[at : at + 5] = (s.dead_time, s.lag, s.latency_s, s.arm_m, s.arm_m)
        sigma[self.warp] = self.vessel.sensors.position_bias_sigma_m / REACH_M
        sigma[self.trims], sigma[self.azimuths] = s.trim_us, s.azimuth_deg
        sigma[self.curves], sigma[self.asterns] = s.curve, s.astern
        either = np.array([EITHER_SHARE * (p.upper - p.lower) for _, p in self._terms])
        sigma[self.terms] = np.where(self._term_signs == 0, either, s.term)
        if self.unmeasured_imu:
            sigma[self.imu] = (s.arm_m, s.arm_m, s.hard_iron_rad, s.hard_iron_rad)
        if self.surroundings:
            sigma[self.terms][-len(SURROUNDINGS) :] = (s.current_m_s, s.current_m_s, s.wind_m_s, s.wind_m_s)
        for name, (centre, own) in (self.overrides or {}).items():
            i = self.names.index(name)
            q[i] = q[i] if centre is None else centre
            sigma[i] = own
        return self.unconstrained(q), np.maximum(sigma, 1e-6)

    def is_positive(self) -> np.ndarray:
        """Mask (P,) of the parameters that keep their sign; their confidence intervals are those of a logarithm."""
        positive = np.zeros(len(self.names), dtype=bool)
        positive[list(_LOG)] = True
        positive[len(HULL) : self.thrusters.stop + 2] = True
        positive[self.asterns] = True
        positive[self.terms] = self._term_signs != 0
        return positive


def file_values(vessel: VesselFile, surroundings: bool = False, unmeasured_imu: bool = False) -> np.ndarray:
    """q (P,) as stated in the vessel file."""
    M, D, d = mass_matrix(vessel), linear_damping(vessel), vessel.damping
    tag, propulsion = vessel.sensors.position, vessel.propulsion
    hull = [M[0, 0], M[1, 1], M[2, 2], M[1, 2], -D[0, 0], -D[1, 1], -D[2, 2], -D[1, 2], -D[2, 1]]
    quadratic = [d.X_uu_N_s2_m2, d.Y_vv_N_s2_m2, d.N_rr_N_m_s2]
    gains = [t.gain for t in vessel.thrusters]
    sensors = [tag.latency_s, tag.x_m, tag.y_m] + [0.0] * len(WARP)
    able = [vessel.thrusters[i] for i in adjustable(vessel)]
    extras = [t.trim_us for t in able] + [t.azimuth_deg for t in able]
    maps = [vessel.force_maps[name] for name in pitch_maps(vessel)]
    extras += [m.curve for m in maps if isinstance(m, PitchMap)]
    extras += [astern_share(vessel.force_maps[name]) or 1.0 for name in astern_maps(vessel)]
    extras += [stated(vessel, name, p) for name, p in fitted_terms(vessel)]
    extras += [p.default for _, p in SURROUNDINGS * surroundings]
    imu = vessel.sensors.imu
    extras += [imu.x_m, imu.y_m, imu.hard_iron_cos_rad, imu.hard_iron_sin_rad] * unmeasured_imu
    lags = [propulsion.dead_time_s, propulsion.lag_s]
    return np.array(hull + quadratic + gains + lags + sensors + extras, dtype=float)
