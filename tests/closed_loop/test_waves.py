"""A mission in waves that roll the hull by 5 degrees and push it with 20 to 30 N, on the worst AHRS. Seeds 1 to 3."""

import pytest

from sim.world.environment import Weather
from tests.evidence.firmware.missions import WAVES
from tests.support.drive_fixture import CORNER, figures, settled, voyage

SMALL = Weather(H_s_m=0.1, T_p_s=1.8)


MORE = [(WAVES, 1), (WAVES, 3), (SMALL, 3)]


@pytest.mark.parametrize(
    ("weather", "seed"),
    [
        (WAVES, 2),
        pytest.param(SMALL, 1, marks=pytest.mark.long),
        *(pytest.param(*more, marks=(pytest.mark.long, pytest.mark.matrix)) for more in MORE),
    ],
)
def test_the_estimate_is_right_in_waves_and_the_boat_stays_on_its_track(weather, seed):
    run = voyage(seed, weather=weather)
    assert run.run(settled(10.0), 120.0), run.state.helm
    told = figures(run, CORNER)
    assert told["position_rmse_m"] < 0.2 and told["velocity_rmse_m_s"] < 0.1
    assert told["nees"] < 14.0
    assert told["cross_track_rms_m"] < 0.3
