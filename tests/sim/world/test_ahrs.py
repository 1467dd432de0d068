"""The simulated autopilot's low-pass: as late as the real one's, which runs ten times as fast."""

import numpy as np
import pytest
from scipy import signal

from companion.core.configuration.imu_filters import low_pass_delay_s
from sim.world.ahrs import LowPass

RATE_HZ = 100.0


@pytest.mark.parametrize("cutoff_hz", [4.0, 10.0, 20.0, 40.0])
def test_a_steady_change_comes_as_late_as_by_the_firmware(cutoff_hz):
    """Oracle: scipy's digital Butterworth filter at 1 kHz, the least rate of a board's gyros; within 0.6 per cent."""
    through, seconds = LowPass(RATE_HZ), 2.0
    for k in range(round(seconds * RATE_HZ) + 1):
        out = through((k / RATE_HZ, -k / RATE_HZ, 0.0), cutoff_hz)
    late_s = seconds - out[0]
    t = np.arange(round(seconds * 1000) + 1) / 1000
    firmware_s = seconds - signal.lfilter(*signal.butter(2, cutoff_hz, fs=1000.0), t)[-1]
    assert late_s == pytest.approx(low_pass_delay_s(cutoff_hz), rel=1e-9)
    assert late_s == pytest.approx(firmware_s, rel=6e-3)
    assert out[1] == -out[0] and out[2] == 0.0


def test_without_a_filter_all_goes_through():
    assert LowPass(RATE_HZ)((1.0, 2.0, 3.0), 0.0) == (1.0, 2.0, 3.0)
