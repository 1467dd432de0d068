"""What is estimated of a boat, within which physical limits, and what is believed beforehand.

Two sets of numbers describe the same boat:

    q   file units and signs: M11 M22 M33 M23 | X_u Y_v N_r Y_r N_v X_uu Y_vv N_rr | gains | t_d T_lag |
        latency arm | warp
    w   free of limits: any w gives positive inertia, positive damping, so a model whose free motion loses energy

    M11, M22, M33 = e^w,  M23 = sqrt(M22 M33) tanh w            M > 0
    X_u, Y_v, N_r, X_uu, Y_vv, N_rr = -e^w                      damping > 0
    Y_r + N_v = -2 sqrt(Y_v N_r) tanh w,  Y_r - N_v = -w        D + D^T > 0
    gains, t_d, T_lag = e^w;  latency, arm, warp = w

The warp is what range biases and surveying leave of the positions: measured = p + W (p - middle), W 2 x 2.
Mass and added mass enter the motion only through M: the file's mass and I_z cannot be told from a run.
Every w has a normal prior round the vessel file's value.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from companion.core.vessel import linear_damping, mass_matrix
from companion.core.vessel_file import VesselFile

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
REACH_M = 10.0  # biases of anchors change over such distances: a third of the basin
_LOG = (0, 1, 2, 4, 5, 6, 9, 10, 11)  # hull entries with a logarithm
_M23, _SUM, _DIFF = 3, 7, 8
_UNITS = ("_N_s2_m2", "_N_m_s2", "_N_m_s", "_N_s_m", "_kg_m2", "_kg_m", "_N_s", "_kg", "_s", "_m")


@dataclass(frozen=True)
class PriorSigmas:
    """One sigma of each prior; of logarithms (shares) where the quantity is positive. All assumed.

    `gain`: single T200 and ESCs differ by a few per cent from the manufacturer's table. It alone says how large forces
    are in newtons: motion shows forces only relative to inertia.
    """

    hull: float = 0.5
    coupling: float = 0.3
    gain: float = 0.025
    dead_time: float = 0.5
    lag: float = 0.5
    latency_s: float = 0.05
    arm_m: float = 0.03


def unit_of(name: str) -> str:
    """Unit of a parameter, from its name; gains and warps have none.

    >>> unit_of("Y_vv_N_s2_m2"), unit_of("gain_bow")
    ('N s2/m2', '1')
    """
    if name.startswith(("gain_", "warp_")):
        return "1"
    suffix = next(s for s in _UNITS if name.endswith(s))
    return {
        "_N_s2_m2": "N s2/m2",
        "_N_m_s2": "N m s2",
        "_N_m_s": "N m s",
        "_N_s_m": "N s/m",
        "_kg_m2": "kg m2",
        "_kg_m": "kg m",
        "_N_s": "N s",
    }.get(suffix, suffix[1:])


@dataclass(frozen=True)
class Parameters:
    """Names, prior and the maps between w and q for one vessel file.

    `overrides`: name -> (centre in file units or None for the file's value, sigma of w). A sigma of 0 fixes it.
    """

    vessel: VesselFile
    sigmas: PriorSigmas = PriorSigmas()
    overrides: Mapping[str, tuple[float | None, float]] | None = None

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Parameters in the order of q and w."""
        gains = tuple(f"gain_{t.name}" for t in self.vessel.thrusters)
        return HULL + gains + ("dead_time_s", "lag_s") + SENSORS + WARP

    @property
    def thrusters(self) -> slice:
        """Where the gains are in q."""
        return slice(len(HULL), len(HULL) + len(self.vessel.thrusters))

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
            e[len(HULL) :],
            w[n_log:],
        )

    def file_units(self, w: np.ndarray) -> np.ndarray:
        """q of w, shape (P,)."""
        return self._maps[0](w).full().ravel()

    def jacobian(self, w: np.ndarray) -> np.ndarray:
        """dq/dw, shape (P, P)."""
        return self._maps[1](w).full()

    def free(self, q: np.ndarray) -> np.ndarray:
        """w of q, shape (P,). Damping that is nil or has the wrong sign becomes small, not nil."""
        w = np.array(q, dtype=float)
        linear = np.maximum(-q[4:7], 1e-3 * np.abs(q[4:7]).max() + 1e-9)
        d = np.concatenate([linear, np.maximum(-q[9:12], 0.02 * linear)])
        w[:3], w[4:7], w[9:12] = np.log(q[:3]), np.log(d[:3]), np.log(d[3:])
        w[_M23] = np.arctanh(np.clip(q[3] / np.sqrt(q[1] * q[2]), -0.99, 0.99))
        w[_SUM] = np.arctanh(np.clip(-(q[7] + q[8]) / (2 * np.sqrt(d[1] * d[2])), -0.99, 0.99))
        w[_DIFF] = -(q[7] - q[8])
        tail = slice(len(HULL), self.thrusters.stop + 2)
        w[tail] = np.log(np.maximum(q[tail], 1e-3))
        return w

    @cached_property
    def prior(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean and sigma of w, each (P,)."""
        q, s = file_values(self.vessel), self.sigmas
        sigma = np.full(len(q), s.hull)
        sigma[[_M23, _SUM]] = s.coupling
        sigma[_DIFF] = s.coupling * 2 * np.sqrt(q[5] * q[6])
        sigma[self.thrusters] = s.gain
        at = self.thrusters.stop
        sigma[at : at + 5] = (s.dead_time, s.lag, s.latency_s, s.arm_m, s.arm_m)
        sigma[at + 5 :] = self.vessel.sensors.uwb.range_bias_sigma_m / REACH_M
        for name, (centre, own) in (self.overrides or {}).items():
            i = self.names.index(name)
            q[i] = q[i] if centre is None else centre
            sigma[i] = own
        return self.free(q), np.maximum(sigma, 1e-6)

    def is_positive(self) -> np.ndarray:
        """Which parameters keep their sign (their intervals are those of a logarithm), shape (P,)."""
        positive = np.zeros(len(self.names), dtype=bool)
        positive[list(_LOG)] = True
        positive[len(HULL) : self.thrusters.stop + 2] = True
        return positive


def file_values(vessel: VesselFile) -> np.ndarray:
    """q as the vessel file has it, shape (P,)."""
    M, D, d = mass_matrix(vessel), linear_damping(vessel), vessel.damping
    uwb, propulsion = vessel.sensors.uwb, vessel.propulsion
    hull = [M[0, 0], M[1, 1], M[2, 2], M[1, 2], -D[0, 0], -D[1, 1], -D[2, 2], -D[1, 2], -D[2, 1]]
    quadratic = [d.X_uu_N_s2_m2, d.Y_vv_N_s2_m2, d.N_rr_N_m_s2]
    gains = [t.gain for t in vessel.thrusters]
    sensors = [uwb.latency_s, uwb.x_m, uwb.y_m] + [0.0] * len(WARP)
    return np.array(hull + quadratic + gains + [propulsion.dead_time_s, propulsion.lag_s] + sensors, dtype=float)
