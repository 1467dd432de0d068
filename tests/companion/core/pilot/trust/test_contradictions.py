"""Who keeps thrusters from being blamed, and a model's motion that begins anew once one was found."""

import numpy as np
import pytest

from companion.core.estimation.filter_state import NU
from companion.core.pilot.trust.contradictions import findings, is_suspect
from companion.core.pilot.trust.model_motion import ModelMotion
from companion.core.pilot.trust.sensors.accelerometer_check import AccelerometerState
from companion.core.pilot.trust.sensors.heading_check import HeadingState
from companion.core.pilot.trust.sensors.motion_check import SUSPECT, MotionState
from companion.core.pilot.trust.sensors.path_check import PathState
from companion.core.pilot.trust.verdict import Finding
from tests.support.drive_fixture import setup, under_way

FOUND = (Finding("sensor", "accel", "the accelerometer is wrong", 0),)
DOUBTFUL = (
    HeadingState(is_suspect=True),
    PathState(is_suspect=True),
    MotionState(sum=SUSPECT),
    AccelerometerState(findings=FOUND),
)


@pytest.mark.parametrize("doubtful", DOUBTFUL, ids=lambda state: type(state).__name__)
def test_any_sensor_that_may_be_wrong_keeps_thrusters_from_being_blamed(doubtful):
    state, _ = under_way()
    assert not is_suspect(state)
    assert is_suspect(state.with_monitors(doubtful))


def test_what_monitors_of_sensors_found_is_one_list():
    state = under_way()[0].with_monitors(HeadingState(findings=FOUND), PathState(findings=FOUND))
    assert findings(state) == FOUND * 2


def test_the_models_motion_begins_anew_from_the_filters():
    settings = setup().pilot
    belief = under_way()[0].estimator.history[-1].belief
    motion, before = ModelMotion(settings.vessel, settings.control.period_s), (0.9, -0.4, 0.3)
    assert np.abs(np.subtract(motion.step(before, belief), before)).max() < 0.2
    assert motion.step(before, belief, anew=True) == tuple(belief.x[NU])
