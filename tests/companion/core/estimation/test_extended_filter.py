"""The filter with effects of hull, water and thrusters in its file is as consistent as without; else it is not."""

import numpy as np
import pytest
from msgspec.structs import replace

from companion.core.configuration.vessel_file import Wash
from companion.core.estimation.estimator import Estimator
from companion.core.model.thrust_lag import lagged
from tests.companion.core.estimation.estimator_world import basin, estimate, simulate
from tests.support.vessel_fixtures import boat

BASE = boat("aritra")
EXTENDED = replace(
    BASE,
    propulsion=replace(
        BASE.propulsion,
        slew_N_s=40.0,
        advance_loss_sqrt_N_s_m=0.8,
        wash=(Wash(behind="rear_port", ahead="front_port", share=0.4),),
    ),
    thrusters=(*BASE.thrusters[:3], replace(BASE.thrusters[3], gain=0.8)),
    terms={
        "munk_moment": {"k_kg": 30.0, "source": "test"},
        "tether": {"north_m": 15.0, "east_m": 0.0, "slack_m": 5.0, "stiffness_N_m": 0.8, "source": "test"},
        "shallow_zone": {"north_m": 18.0, "east_m": 15.0, "radius_m": 5.0, "share": 1.5, "source": "test"},
    },
)


def pushed(score):
    """RMS of the latent surge force [N] in the second half of a run; there is none."""
    late = score.estimates[len(score.estimates) // 2 :]
    return float(np.sqrt(np.mean([e.disturbance_n[0] ** 2 for e in late])))


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2])
def test_nees_is_that_of_the_plain_boat(seed):
    """Without the effects in its file the filter takes them for a force on the body."""
    plain = estimate(simulate(seed, disturbed=False, seconds=80.0), Estimator(BASE, basin()))
    run = simulate(seed, disturbed=False, seconds=80.0, vessel=EXTENDED)
    known, unknown = (estimate(run, Estimator(v, basin())) for v in (EXTENDED, BASE))
    assert known.nees.mean() < 1.3 * plain.nees.mean() < 13.0
    assert pushed(known) < 0.25 * pushed(unknown)


def test_slew_limited_lag_is_exact_and_its_mean_is_the_mean():
    """Against a fine Euler integration of f_dot = clip((c - f) / T, -s, s): ramp only, ramp then lag, lag only."""
    f, c = np.array([0.0, 10.0, 1.0, -3.0]), np.array([30.0, 2.0, 1.5, -3.0])
    end, mean = lagged(f, c, 0.2, 0.1, 50.0)
    x, area, n = f.copy(), np.zeros(4), 20_000
    for _ in range(n):
        step = np.clip((c - x) / 0.1, -50.0, 50.0) * (0.2 / n)
        area += (x + step / 2) * (0.2 / n)
        x += step
    np.testing.assert_allclose(end, x, atol=1e-3)
    np.testing.assert_allclose(mean, area / 0.2, atol=1e-3)
    plain = lagged(f, c, 0.2, 0.1)
    np.testing.assert_allclose(lagged(f, c, 0.2, 0.1, 1e6), plain, atol=1e-12)
