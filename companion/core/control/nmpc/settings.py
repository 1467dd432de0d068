"""Numbers of the production NMPC, and what a vessel's thrusters allow.

Cost of one stage, each bracket squared and weighted (path frame of the stage's reference row):

    cross_track [y_e] + along_track station [x_e] + heading [psi - psi_ref]
    + surge [u - u_ref] + sway [v - v_ref] + yaw_rate [r - r_ref]
    + effort [c - c_ss] + null_space [(I - B^+ B) c] + rate [c - f] + soft limits + fence [margin - l]

c_ss = B^+ tau_ss is the steady thrust that the reference needs against drag, terms and disturbance: taking
the effort from there and not from zero is what makes the controller offset-free. `preset "production"`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import msgspec
import numpy as np

from companion.core.configuration.tables import NonNegative, Positive, Table
from companion.core.configuration.vessel_file import VesselFile
from companion.core.model.actuators.channel import EQUAL_CHANGE, EQUAL_UP_TO_N
from companion.core.model.actuators.propulsion import channels_of, common, control_limits

POSITION_M = 0.125
"""Error of a position by UWB, for the margin to the fence; assumed."""
Count = Annotated[int, msgspec.Meta(ge=1, le=200)]


class NmpcSettings(Table, frozen=True, kw_only=True):
    """Horizon, weights and limits of effort. All tuned in closed loop on the structured model of
    `deploy/boats/aritra.toml` (tests/companion/core/control/test_nmpc_closed_loop.py); none is a physical constant.
    """

    stages: Count = 20
    step_s: Positive = 0.2

    cross_track: NonNegative = 4.0
    """1/m^2."""
    along_track: NonNegative = 4.0
    """1/m^2, times the row's `station`."""
    heading: NonNegative = 4.0
    """1/rad^2."""
    surge: NonNegative = 10.0
    """s^2/m^2."""
    sway: NonNegative = 6.0
    """s^2/m^2."""
    yaw_rate: NonNegative = 3.0
    """s^2/rad^2."""
    effort: NonNegative = 2e-4
    """1/N^2 on c - c_ss; this and the next two of thrusters up to 38 N; of stronger ones over `strength`^2."""
    null_space: NonNegative = 2e-2
    """1/N^2: thrusters that push against each other waste power and chatter."""
    rate: NonNegative = 1e-2
    """1/N^2 on c - f = T_lag f_dot."""
    terminal: Positive = 4.0
    """Factor on the state cost of the last row, for the cost beyond the horizon."""
    speed_limit_m_s: Positive | None = None
    """Soft limit on |u| and |v|."""
    yaw_rate_limit_rad_s: Positive | None = 1.0
    """Soft limit on |r|."""
    fence: NonNegative = 100.0
    """1/m^2 on max(0, margin - l)^2 for each level l of the fence (`fence.levels`): a half-plane with a slack s >= 0 of
    cost w s^2, the slack eliminated. Soft, so that the problem stays feasible beyond the fence."""
    fence_margin_m: NonNegative = 0.5
    """About the error of the position plus half the beam, of boats up to 0.75 m wide (`nmpc_for`); assumed."""
    soft: NonNegative = 100.0
    """Weight on the excess over a soft limit, s^2/m^2 and s^2/rad^2."""

    method: Literal["rti", "interpreted", "hpipm"] = "rti"
    """Solver of the steps: Riccati kernel as machine code if possible, the same by CasADi's interpreter, or hpipm."""
    iterations: Count = 2
    """Newton-type steps on a usable warm start."""
    interpreted_iterations: Count = 1
    """The same by CasADi's interpreter: half the time, and 0.02 % more cost in closed loop."""
    most_iterations: Count = 6
    """Steps allowed until the dynamics close to `defect_tolerance`, before the rescue."""
    defect_tolerance: Positive = 0.1
    """Largest |F(x_k, c_k) - x_{k+1}| of a usable plan, in m, rad, m/s, rad/s and units of 10 N."""
    cold_iterations: Count = 50
    """Steps of each of the two cold starts until cost and gaps converge, before the rescue."""
    rescue_iterations: Count = 60
    """Interior-point iterations of the rescue."""
    rescue_time_s: Positive = 0.25
    """Wall time of the rescue, at most."""


def nmpc_for(vessel: VesselFile) -> NmpcSettings:
    """The settings for this boat: the margin to the fence is half its beam and the error of a position, at least the
    default.
    """
    settings = NmpcSettings()
    margin_m = max(settings.fence_margin_m, vessel.hull.beam_m / 2 + POSITION_M)
    return msgspec.structs.replace(settings, fence_margin_m=margin_m)


@dataclass(frozen=True)
class Actuation:
    """Limits of the commands, shape (n,) [N, rad], and of their rate, one number or (n,) [N/s, rad/s].

    Equal limits: a dead thruster. `equal_change`: changes that count alike (`channel.EQUAL_CHANGE`), one or (n,).
    """

    force_min_n: np.ndarray
    force_max_n: np.ndarray
    rate_limit_n_s: float | np.ndarray
    equal_change: float | np.ndarray = EQUAL_CHANGE["N"]

    @classmethod
    def of(cls, vessel: VesselFile) -> Actuation:
        """Limits from a vessel file. The plan stays within what the actuators can do, so the lag is exact."""
        channels = channels_of(vessel)
        rates = common([min(c.rate, c.slew or c.rate) for c in channels])
        strength = max(1.0, max(c.upper for c in channels if c.unit == "N") / EQUAL_UP_TO_N)
        changes = [EQUAL_CHANGE[c.unit] * (strength if c.unit == "N" else 1.0) for c in channels]
        return cls(*control_limits(vessel), rates, common(changes))

    @property
    def able(self) -> np.ndarray:
        """Whether each works, (n,): not where its limits are equal."""
        return np.asarray(self.force_min_n < self.force_max_n)

    @property
    def strength(self) -> float:
        """Full thrust over that for which the weights were chosen; 1 where it is less."""
        return float(np.max(self.equal_change)) / EQUAL_CHANGE["N"]
