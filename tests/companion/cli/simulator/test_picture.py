"""What the demo's picture says above it."""

import math

from companion.cli.simulator.picture import headline


def test_what_was_not_measured_is_left_out():
    """A demo that was stopped before its first leg."""
    figures = {"waypoints_passed": 0, "waypoints_total": 5, "position_rmse_m": 0.114}
    figures |= {"cross_track_rms_m": math.nan, "nmpc_p50_ms": 0.21}
    assert headline(figures) == "0 of 5 waypoints, position estimate 0.11 m rms, NMPC 0.2 ms median"
