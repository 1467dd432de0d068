"""How late a low-pass makes a slow motion, by scipy's filters; and which columns of a log are late."""

import numpy as np
import pytest
from scipy import signal

from companion.core.configuration.imu_filters import FILTER_PARAMETERS, late_by_filters, low_pass_delay_s


@pytest.mark.parametrize("cutoff_hz", [4.0, 10.0, 20.0, 40.0])
def test_the_delay_is_that_of_a_butterworth_filter_at_slow_motions(cutoff_hz):
    b, a = signal.butter(2, 2 * np.pi * cutoff_hz, analog=True)
    slow = 2 * np.pi * cutoff_hz * np.array([0.01, 0.02])
    phase = np.unwrap(np.angle(signal.freqs(b, a, slow)[1]))
    assert low_pass_delay_s(cutoff_hz) == pytest.approx(-np.diff(phase)[0] / np.diff(slow)[0], rel=1e-3)


def test_columns_are_late_by_their_own_filter():
    late = late_by_filters({"INS_GYRO_FILTER": 4.0, "INS_ACCEL_FILTER": 10.0, "SCHED_LOOP_RATE": 50.0})
    assert late == {
        "r_rad_s": low_pass_delay_s(4.0), "ax_m_s2": low_pass_delay_s(10.0), "ay_m_s2": low_pass_delay_s(10.0)
    }  # fmt: skip
    assert late["r_rad_s"] == pytest.approx(0.0563, abs=1e-4)
    assert late_by_filters({"INS_GYRO_FILTER": 0.0}) == {"r_rad_s": 0.0}  # no filter, and nothing known of the other
    assert late_by_filters({"INS_ACCEL_FILTER": float("nan")}) == {} == late_by_filters({})
    assert FILTER_PARAMETERS == ("INS_GYRO_FILTER", "INS_ACCEL_FILTER")
