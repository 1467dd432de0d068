"""Gusts, waves and fixes without line of sight in vessel files: what is written, and what the simulated world draws."""

import casadi as ca
import numpy as np
import pytest
from msgspec.structs import replace

from companion.core.model.load_vessel import load_vessel
from companion.core.model.manoeuvring import StructuredModel
from companion.core.model.vessel_text import vessel_toml
from sim.fitting.diagnose.catalogue.stochastic import GUSTY_WIND, NLOS, WAVES
from sim.fitting.diagnose.vessel_edits.edits import CauseValues
from sim.fitting.diagnose.vessel_edits.extend import with_causes
from sim.studies.boats.draw import in_still_air
from sim.world.environment import Environment, Weather, with_terms_of
from sim.world.plant import Motion
from sim.world.sensors import UwbFaults, UwbSensor, hidden_anchor
from sim.world.teleop_log import corner_anchors
from tests.support.vessel_fixtures import boat


def test_a_file_carries_what_pushes_and_reports_by_chance():
    """Filter and NMPC take the mean: a steady wind of the gusts' mean pressure, and no waves."""
    told = {"V_w_m_s": 4.0, "beta_w_deg": 50.0, "gustiness": 0.3, "gust_time_s": 9.0}
    rocked = {"F_w_N": 1.2, "T_p_s": 2.4, "beta_wave_deg": 200.0}
    hidden = {"share": 0.08, "extra_m": 0.9, "anchor": 2.0}
    plain = in_still_air(boat("aritra"))
    causes = [CauseValues(e, own, own, "found") for e, own in ((GUSTY_WIND, told), (WAVES, rocked), (NLOS, hidden))]
    vessel, left = with_causes(plain, causes)
    assert left == {} and load_vessel(vessel_toml(vessel), name="x") == vessel
    written = {k: vessel.terms["wind"][k] for k in told} | {k: vessel.terms["waves"][k] for k in rocked}
    written["beta_w_deg"] %= 360
    assert written == pytest.approx(told | rocked)
    uwb = vessel.sensors.tag
    assert (uwb.nlos_share, uwb.nlos_extra_m, uwb.nlos_anchor) == (0.08, 0.9, "2")
    steady = replace(plain, terms={"wind": plain.terms["wind"] | {"V_w_m_s": 4.0 * np.sqrt(1.09), "beta_w_deg": 50.0}})
    args = ca.DM([0.0, 0.0, 0.4]), ca.DM([0.5, -0.2, 0.3]), ca.DM.zeros(3)
    one, other = (np.array(StructuredModel.of(v).nu_dot(*args)) for v in (vessel, steady))
    np.testing.assert_allclose(one, other, rtol=1e-9)
    assert with_causes(vessel, causes)[1] == {
        "waves": "the file has waves already", "nlos": "the file has an anchor out of sight already"
    }  # fmt: skip


def test_the_world_draws_gusts_and_waves_of_the_file():
    """Four hours, seed 3: size and time of the gusts; rms, period and width of the waves."""
    terms = {"wind": {"V_w_m_s": 5.0, "gustiness": 0.2, "gust_time_s": 20.0, "source": "test"},
             "waves": {"F_w_N": 2.0, "T_p_s": 2.5, "beta_wave_deg": 70.0, "source": "test"}}  # fmt: skip
    world = Environment(with_terms_of(Weather(), replace(boat("aritra"), terms=terms)), np.random.default_rng(3))
    step_s = 0.25
    moments = [world.step(k * step_s, step_s) for k in range(60_000)]
    gust = np.array([m.V_w_m_s for m in moments]) / 5.0 - 1
    assert gust.std() == pytest.approx(0.2, rel=0.1)
    lag = round(20.0 / step_s)
    assert (gust[:-lag] * gust[lag:]).mean() / gust.var() == pytest.approx(np.exp(-1), abs=0.1)
    a = np.array([m.along_waves_n for m in moments])
    assert a.std() == pytest.approx(2.0, rel=0.05) and abs(a.mean()) < 0.03 and moments[0].beta_wave_deg == 70.0
    spectrum = (np.abs(np.fft.rfft(a.reshape(-1, 2400), axis=1)) ** 2).mean(axis=0)
    off = np.fft.rfftfreq(2400, step_s) * 2.5
    assert off[spectrum.argmax()] == pytest.approx(1.0, abs=0.02)
    half = off[spectrum > spectrum.max() / 2]
    assert (half.max() - half.min()) / 2 == pytest.approx(0.04, abs=0.02)


def test_the_simulated_tag_lies_too_far_from_the_anchor_out_of_sight():
    """A share of 0.3, exponential of mean 0.8 m, away from the second anchor; the id goes before the number."""
    uwb = replace(boat("aritra").sensors.tag, nlos_share=0.3, nlos_extra_m=0.8, nlos_anchor="1", range_sigma_m=1e-6,
                  range_bias_sigma_m=0.0, x_m=0.0, y_m=0.0)  # fmt: skip
    anchors = corner_anchors()
    sensor = UwbSensor(uwb, anchors, UwbFaults(), np.random.default_rng(4))
    still = Motion(0, np.array([12.0, 9.0, 0.3, 0, 0, 0, 0, 0, 0, 0]), np.zeros(3))
    found = [fix[:2] for _ in range(2000) if (fix := sensor.fix(sensor.measure(still)))]
    fixes = np.array(found)[:, ::-1] - (12.0, 9.0)
    away = np.array([12.0 - 30.0, 9.0]) / np.hypot(18.0, 9.0)
    along, across = fixes @ away, fixes @ [-away[1], away[0]]
    assert (along > 0.001).mean() == pytest.approx(0.3, abs=0.03) and np.abs(across).max() < 1e-3
    assert along[along > 0.001].mean() == pytest.approx(0.8, rel=0.1) and along.min() > -1e-3
    assert hidden_anchor(replace(uwb, nlos_anchor="elsewhere"), anchors) is None
    zeros = [replace(anchor, id=f"00{i + 51}") for i, anchor in enumerate(anchors)]
    assert hidden_anchor(replace(uwb, nlos_anchor="52"), zeros) is zeros[1]
