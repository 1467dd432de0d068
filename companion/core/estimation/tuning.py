"""What the estimator needs beyond the vessel file's sensor noise. All assumed or tuned, none measured.

"Tuned" means: chosen on the test world (tests/companion/core/estimation/estimator_world.py), so that position, speed
and heading errors agree with the filter's own covariance both with an exact model and with current, wind and a
model off by up to 10 %.
"""

from __future__ import annotations

import math

from companion.core.configuration.tables import Table
from companion.core.configuration.vessel_file import ModelError
from companion.core.sensors.sensor import GateRule

RANGE_GATE = GateRule(limit=3.29, floor=0.10, ceiling=0.50, reopen_count=3, reopen_span_s=1.5, agreement=1.0)
"""Ranges [m]. 3.29 sigma: 99.9 % of a Gaussian. Ceiling and agreement: assumed (outliers of 0.5-46 m)."""

HEADING_GATE = GateRule(limit=3.29, floor=0.02, ceiling=0.10, reopen_count=25, reopen_span_s=0.5, agreement=0.2)
"""Autopilot heading [rad]; assumed: a reset of the autopilot's yaw lasts, a glitch is shorter than 0.5 s."""

POSITION_GATE = GateRule(limit=3.72, floor=0.15, ceiling=0.70, reopen_count=3, reopen_span_s=1.5, agreement=1.5)
"""Positions that a tag computed itself [m]: 99.9 % of two degrees of freedom; otherwise as ranges."""


class EstimatorTuning(Table, frozen=True, kw_only=True):
    """Process noise, trust and health limits of the extended Kalman filter."""

    rest_force_sigma_n: float = 1.0
    """Stationary sigma of the latent surge and sway force of a boat without thrust [N]; tuned."""
    rest_moment_sigma_nm: float = 0.5
    """The same of the yaw moment [N m]; tuned."""
    thrust_share: float = 0.5
    """So much of |B| |f|, the thrusters' force with signs left out, adds to them: what a model leaves out shows more
    in a boat that is driven than in one on station. Tuned."""
    latent_time_s: float = 20.0
    """Correlation time of the latent force [s]; tuned: errors of the model act as long as a manoeuvre."""
    lively_force_sigma_n: float = 3.0
    """Sigma of the latent surge and sway force that nothing is known of, and the unit of its activity [N]; tuned."""
    lively_moment_sigma_nm: float = 1.5
    """The same of the yaw moment [N m]; tuned."""
    lively_time_s: float = 8.0
    """Correlation time of it, and of what the vessel file states [s]; tuned."""
    accel_walk_m_s2_sqrt_s: float = 0.002
    """White acceleration that neither model nor latent force explain, surge and sway; tuned."""
    yaw_walk_rad_s2_sqrt_s: float = 0.002
    """The same in yaw; tuned."""
    start_tilt_sigma_rad: float = 0.01
    """Error of the autopilot's roll and pitch at the start: what was seen of a real one under way was 0.012 at most."""
    ahrs_tilt_sigma_rad: float = 0.02
    """The same after a gap, in waves: assumed; with 0.35 m of waves a DCM without GPS errs by 0.015."""
    gyro_drift_sigma_rad_s2: float = math.radians(0.05) / 60
    """How fast a gyro's bias drifts, on top of the file's random walk: a board that warms up does so steadily,
    ArduPilot's simulated one by 0.05 deg/s a minute (SIM_DRIFT_SPEED)."""
    gyro_drift_time_s: float = 300.0
    """Correlation time of that; assumed: a board is warm after some minutes."""
    rates_hold_s: float = 0.2
    """Roll and pitch rate are held so long after the last attitude; assumed: a tenth of a wave's period."""
    unseen_tilt_rad_sqrt_s: float = 0.05
    """Random walk of roll and pitch without rates; assumed: a wave of 4 degrees in half its period."""
    imu_limit: float = 5.0
    """An IMU axis off by more than this many sigma is trusted less, in proportion; assumed."""
    range_gate: GateRule = RANGE_GATE
    heading_gate: GateRule = HEADING_GATE
    position_gate: GateRule = POSITION_GATE
    start_velocity_sigma_m_s: float = 0.5
    """Sigma of u and v at the start; assumed: the boat rests or drifts."""
    start_rate_sigma_rad_s: float = 0.2
    """Sigma of r at the start; assumed: what it may change between a range and the reading at hand."""
    start_agreement_m: float = 1.5
    """Two fixes in a row must agree so well before the filter starts; assumed."""
    fix_spread_m: float = 0.6
    """Residual beyond which a range plays no part in a fix; assumed: six sigma of a range."""
    fix_window_s: float = 0.3
    """Ranges no older than this make up one fix; assumed: three cycles at 10 Hz."""
    max_step_s: float = 0.05
    """Longest integration step; a longer wait is cut into several. Yaw time constant: about 2 s."""
    history_s: float = 1.0
    """How late a measurement may come and still be placed at its own stamp; assumed."""
    restart_gap_s: float = 10.0
    """After such a silence of all sensors the filter starts afresh; assumed."""
    model_error: ModelError | None = None
    """The latent force's sigma by axis, if the vessel file states it; None: that at rest and the thrusters' share."""
    doubt_limit: float = 40.0
    """Cumulative sum of the ranges' surprise at which the file's word is no longer taken (`trust`). Assumed: by chance
    once in ten hours at four ranges a second, within 7 s where d2 has a mean of 3."""
    imu_timeout_s: float = 0.5
    """No IMU or no heading for so long: degraded; assumed."""
    settle_s: float = 3.0
    """After a start, or a gap in all sensors of more than `imu_timeout_s`, the estimate is degraded for so long, until
    `settle_fixes` positions have been accepted, and until the sigma of u and v is below `settled_velocity_sigma_m_s`
    at one of them and below `settled_before_fix_sigma_m_s` right before it: speed is known to 0.2 m/s then, by three
    sigma at the worst moment. `settle_most_s` ends it in any case. Assumed."""
    settle_fixes: int = 4
    settled_velocity_sigma_m_s: float = 0.045
    settled_before_fix_sigma_m_s: float = 0.2 / 3
    settle_most_s: float = 20.0

    @property
    def latent_sigma(self) -> tuple[float, float, float]:
        """Stationary sigma of the latent force X, Y [N] and moment N [N m], without what thrust adds."""
        if e := self.model_error:
            return e.X_sigma_N, e.Y_sigma_N, e.N_sigma_N_m
        return self.rest_force_sigma_n, self.rest_force_sigma_n, self.rest_moment_sigma_nm

    @property
    def lively_sigma(self) -> tuple[float, float, float]:
        """The same of the unit of activity: where the file states the model's error, that."""
        return self.latent_sigma if self.model_error else self._unknown_sigma

    @property
    def wary_latent_sigma(self) -> tuple[float, float, float]:
        """The same where innovations contradict the file's `model_error`: the larger of the two for each axis."""
        X, Y, N = (max(own, file) for own, file in zip(self._unknown_sigma, self.latent_sigma, strict=True))
        return X, Y, N

    @property
    def _unknown_sigma(self) -> tuple[float, float, float]:
        return self.lively_force_sigma_n, self.lively_force_sigma_n, self.lively_moment_sigma_nm
