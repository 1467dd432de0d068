"""What a monitor looks at in a tick, with a healthy estimate in the middle of the basin."""

from companion.core.messages import StateEstimate
from companion.core.pilot.monitors.monitor import TickView

ESTIMATE = StateEstimate(
    t_ns=0, north_m=5.0, east_m=5.0, psi_rad=0.0, u_m_s=0.0, v_m_s=0.0, r_rad_s=0.0, covariance=(0.0,) * 36,
    accel_bias_m_s2=(0.0, 0.0), gyro_bias_rad_s=0.0, anchor_bias_m={}, disturbance_n=(0.0, 0.0, 0.0),
    health="healthy", reason="",
)  # fmt: skip


def view(t_ns, *, lateness_ns=0, estimate=ESTIMATE, plan_ns=0, autopilot_alive=True):
    return TickView(t_ns, lateness_ns, estimate, plan_ns, autopilot_alive)
