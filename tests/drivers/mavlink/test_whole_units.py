"""Accelerations and rates that the autopilot cuts towards zero to whole milli-units come out without a bias."""

import math
import random

import pytest

from drivers.mavlink.codec import MavlinkCodec
from tests.drivers.mavlink.mavlink_autopilot import Sender


@pytest.mark.parametrize("name", ["raw_imu", "scaled_imu", "scaled_imu2"])
def test_whole_milli_units_stand_for_the_middle_of_what_was_cut(name):
    codec, draw, off = MavlinkCodec(target_system=1, imu_preference=[name.upper()]), random.Random(1), []
    for k in range(1, 4001):
        accel, rate = draw.uniform(-300, 300), draw.uniform(-60, 60)
        # cut as C cuts a float that is handed over as an int16
        frame = getattr(Sender(), name)(20 * k, int(accel), 0, -1000, 0, 0, int(rate), 0, 0, 0)
        (sample,) = codec.feed(frame, 20_000_000 * k)
        assert sample.ay_m_s2 == sample.p_rad_s == 0.0
        off.append((sample.r_rad_s * 1e3 - rate, sample.ax_m_s2 / 9.80665e-3 - accel, math.copysign(1.0, rate)))
    for error in (0, 1):
        assert max(abs(o[error]) for o in off) <= 1.0  # between -1 and 1 there is one number: 0
        assert abs(sum(o[error] for o in off)) / len(off) < 0.02
    assert abs(sum(o[0] * o[2] for o in off)) / len(off) < 0.02  # neither nearer to zero nor farther from it
