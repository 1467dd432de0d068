"""Effects of the hidden-effect cases: a complete catalogue, sizes that can be seen, signs and units as documented."""

import math

import numpy as np
import pytest

from tests.hidden import draw, names, write
from tests.hidden.effects import catalogue as effects
from tests.hidden.effects import outside
from tests.hidden.plant.sail import Recorded, replay, sail
from tests.hidden.plant.sensors import fix_clean, imu_clean, stamp_delay
from tests.hidden.plant.world import STEP_S, STEPS_HZ

# -- effects -------------------------------------------------------------------------------------------------------


def test_the_catalogue_is_complete():
    assert tuple(effects.CATALOGUE) == names.FAMILIES
    assert len(names.FAMILIES) == 39  # 42 with one gain for each of four thrusters
    assert len(outside.OUTSIDE) >= 6
    for entry in outside.OUTSIDE:
        assert set(entry.depends_on) <= set(names.DEPENDENCIES)


@pytest.fixture(scope="module")
def calm():
    """A noise-free run of 25 s of a boat as believed, and its start."""
    case = draw.draw("effects", 0, kind="none", uwb_hz=5)
    world, start = case.base, (17.0, 12.0, 0.8, 0.0, 0.0, 0.0)
    rng = np.random.default_rng(8)
    pwm = [(k, [float(p) for p in rng.integers(1300, 1700, 4)]) for k in range(0, 25 * STEPS_HZ, 3 * STEPS_HZ // 2)]
    return world, start, pwm, noise_free(world, start, pwm)


def noise_free(world, start, pwm):
    track = sail(world, Recorded(pwm), 25.0, 0.0, start, [np.random.default_rng(1), np.random.default_rng(2)])
    t = track.fix_step * STEP_S
    imu = imu_clean(world, track.imu_step * STEP_S, track.state, track.rate, track.tilt)
    fix = fix_clean(world.sense, track.fix_state)
    late = stamp_delay(world.sense, t) - 0.1
    return imu[:, :4], np.stack([np.interp(t - late, t, fix[:, i]) for i in range(2)], 1)


def nats(a, b, sense):
    """Half the sum of squared differences in sigmas: what perfect knowledge of the rest would give."""
    imu = (a[0] - b[0]) / (sense.heading_sigma, sense.gyro_sigma, sense.accel_sigma, sense.accel_sigma)
    return 0.5 * float((imu**2).sum() + (((a[1] - b[1]) / sense.uwb_sigma) ** 2).sum())


@pytest.mark.parametrize("family", [f for f in names.FAMILIES if f != "nlos"])
def test_each_effect_at_medium_size_changes_the_readings(family, calm):
    world, start, _, quiet = calm
    effect = effects.CATALOGUE[family]
    params = effect.draw(np.random.default_rng(4), 4 * effect.smallest, world)
    if "t_on_s" in params:
        params["t_on_s"] = 5.0
    if family == "clock_drift":
        params["drift"] *= 300 / 25  # what five minutes would show
    if family == "shallow_zone":
        params |= {"north_m": start[0], "east_m": start[1]}
    plain = noise_free_with(effect.apply, params, calm)
    assert nats(plain, quiet, world.sense) > 5  # ten minutes: over 100
    for name, variant in effect.variants.items():
        if name not in ("warms", "late", "on_off"):  # these differ over minutes
            assert nats(noise_free_with(variant, params, calm), plain, world.sense) > 0.5


def noise_free_with(apply, params, calm):
    world, start, pwm, _ = calm
    changed = world.copy()
    apply(changed, params)
    return noise_free(changed, start, pwm)


def test_blocked_fixes_lie_away_from_their_anchor():
    case = draw.draw("nlos", 0, kind="medium", family="nlos", uwb_hz=10, train_s=60.0)
    track, said = write.record(case.world, case, 0, 60.0, 0.0, case.open_rng())
    t = said.fixes[:, 0] - case.world.sense.latency
    at = np.rint(t * 10).astype(int)
    off = said.fixes[:, 1:] - fix_clean(case.world.sense, track.fix_state[at])
    far = np.hypot(*off.T) > 0.35
    assert 0.3 * case.world.sense.nlos < far.mean() < 1.5 * case.world.sense.nlos


@pytest.mark.parametrize("entry", outside.OUTSIDE, ids=lambda e: e.name)
def test_each_outside_effect_changes_the_readings(entry, calm):
    world, start, pwm, quiet = calm
    changed = world.copy()
    entry.make(changed, np.random.default_rng(3), 1.0)
    assert nats(noise_free(changed, start, pwm), quiet, world.sense) > 50


def test_signs_and_units_are_as_documented(calm):
    world, start, _, quiet = calm

    def readings(family, **params):
        return noise_free_with(effects.CATALOGUE[family].apply, params, calm)

    assert readings("heading_offset", offset_deg=2.0)[0][:, 0] - quiet[0][:, 0] == pytest.approx(math.radians(2.0))
    assert readings("gyro_bias", b_r_rad_s=0.01)[0][:, 1] - quiet[0][:, 1] == pytest.approx(0.01)
    assert readings("accel_bias", b_x_m_s2=0.05, b_y_m_s2=0.0)[0][:, 2] - quiet[0][:, 2] == pytest.approx(0.05)
    turned = readings("imu_misalignment", yaw_deg=90.0)[0]
    assert turned[:, 2] == pytest.approx(quiet[0][:, 3])
    adrift = world.copy()
    effects.CATALOGUE["current"].apply(adrift, {"V_c_m_s": 0.2, "beta_c_deg": 90.0})
    end = replay(adrift, [], [(0, 15.0)], 0.0, {0: start}, 60 * STEPS_HZ)[-1]
    assert end[1] - start[1] > 5.0
    assert abs(end[0] - start[0]) < 1.0
    windy = world.copy()
    effects.CATALOGUE["wind"].apply(windy, {"V_w_m_s": 8.0, "beta_w_deg": 0.0})
    assert replay(windy, [], [(0, 15.0)], 0.0, {0: start}, 20 * STEPS_HZ)[-1][0] < start[0] - 0.5
