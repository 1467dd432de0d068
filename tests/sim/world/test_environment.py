"""Weather: what was asked for, on average, from a seed."""

import numpy as np
import pytest
from msgspec.structs import replace

from sim.world.environment import GUST_TIME_S, Environment, Weather, with_terms_of
from tests.support.vessel_fixtures import boat

DT = 0.01


def history(weather, seed, seconds):
    environment = Environment(weather, np.random.default_rng(seed))
    return [environment.step(k * DT, DT) for k in range(round(seconds / DT))]


def test_calm_is_calm():
    for moment in history(Weather(), 1, 2):
        assert (moment.V_c_m_s, moment.V_w_m_s, moment.phi_rad, moment.theta_rad) == (0, 0, 0, 0)
        assert not moment.wave_n.any()


def test_current_turns_at_its_rate():
    moments = history(Weather(V_c_m_s=0.2, beta_c_deg=30.0, turn_deg_s=2.0), 1, 10)
    assert {moment.V_c_m_s for moment in moments} == {0.2}
    assert moments[500].beta_c_deg == pytest.approx(40.0)


def test_gusts_have_their_spread_and_their_time():
    """Seed 4, 4000 s: 400 correlation times, so the spread is known to about 5 %."""
    environment = Environment(Weather(V_w_m_s=5.0, gustiness=0.2), np.random.default_rng(4))
    speed = np.array([environment.step(k * 0.1, 0.1).V_w_m_s for k in range(40_000)])
    assert speed.mean() == pytest.approx(5.0, abs=0.15)
    assert speed.std() == pytest.approx(1.0, abs=0.1)
    share = speed / 5.0 - 1
    lag = round(GUST_TIME_S / 0.1)
    assert np.corrcoef(share[:-lag], share[lag:])[0, 1] == pytest.approx(np.exp(-1), abs=0.12)


def test_wind_does_not_turn_round_in_a_lull():
    environment = Environment(Weather(V_w_m_s=3.0, gustiness=1.5), np.random.default_rng(5))
    speeds = [environment.step(k * 0.5, 0.5).V_w_m_s for k in range(2000)]
    assert min(speeds) == 0.0


@pytest.mark.parametrize(("H_s_m", "T_p_s"), [(0.1, 2.0), (0.2, 4.0)])
def test_waves_scale_with_height_and_keep_to_their_period(H_s_m, T_p_s):
    """The figures are amplitudes of the whole group: rms is 1/sqrt(2) of them. Seed 6."""
    environment = Environment(Weather(H_s_m=H_s_m, T_p_s=T_p_s), np.random.default_rng(6))
    moments = [environment.step(k * 0.05, 0.05) for k in range(20_000)]
    surge = np.array([moment.wave_n[0] for moment in moments])
    assert surge.std() == pytest.approx(60.0 * H_s_m / np.sqrt(2), rel=0.1)
    assert abs(surge.mean()) < 0.05 * surge.std()
    spectrum = np.abs(np.fft.rfft(surge)) ** 2
    peak_hz = np.fft.rfftfreq(len(surge), 0.05)[spectrum.argmax()]
    assert peak_hz == pytest.approx(1 / T_p_s, rel=0.3)
    roll = np.array([moment.phi_rad for moment in moments])
    assert roll.std() == pytest.approx(0.25 * H_s_m / np.sqrt(2), rel=0.1)


def test_the_seed_decides():
    rough = Weather(V_w_m_s=4.0, gustiness=0.3, H_s_m=0.1)

    def numbers(seed):
        return [(m.V_w_m_s, *m.wave_n, m.phi_rad, m.theta_rad) for m in history(rough, seed, 3)]

    assert numbers(1) == numbers(1) != numbers(2)


def test_what_the_weather_does_not_state_is_the_vessel_files_and_zero_is_none():
    terms = {"current": {"V_c_m_s": 0.1}, "wind": {"V_w_m_s": 4.0}, "waves": {"F_w_N": 2.0}}
    vessel = replace(boat("aritra"), terms={name: {**term, "source": "test"} for name, term in terms.items()})
    for weather, wanted in (
        (Weather(), (0.1, 4.0, 2.0)),
        (Weather(V_c_m_s=0.0), (0.0, 4.0, 2.0)),
        (Weather(V_w_m_s=0.0), (0.1, 0.0, 2.0)),
        (Weather(0.0, V_w_m_s=0.0, H_s_m=0.0), (0.0, 0.0, None)),
        (Weather(0.3, V_w_m_s=1.0, H_s_m=0.1), (0.3, 1.0, None)),
    ):
        found = with_terms_of(weather, vessel)
        assert (found.V_c_m_s, found.V_w_m_s, (found.waves or {}).get("F_w_N")) == wanted
