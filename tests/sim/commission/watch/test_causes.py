"""What is watched of a boat, and how far a mission's word is discounted."""

import numpy as np
import pytest

from sim.commission.watch.causes import unexplained, watched
from sim.commission.watch.mission_fit import MissionInformation, boat_effects
from tests.support.vessel_fixtures import boat

VESSEL = boat("aritra")
WATCHED = watched(VESSEL, boat_effects(VESSEL))


def shares(latent: tuple[float, float, float]) -> dict[str, float]:
    B = len(WATCHED.names)
    mission = MissionInformation(WATCHED.names, np.eye(B), np.zeros(B), {}, latent, (0.1, 0.05, 0.2))
    return dict(zip(WATCHED.names, unexplained(mission).tolist(), strict=True))


@pytest.mark.parametrize("name", ["aritra", "twin"])
def test_a_cause_for_every_thruster_and_for_drag_load_and_delay(name):
    vessel = boat(name)
    names = [c.name for c in watched(vessel, boat_effects(vessel)).causes]
    assert [n for n in names if n.startswith("thruster_gain:")] == [f"thruster_gain:{t.name}" for t in vessel.thrusters]
    assert {"hull_fouling", "surge_drag", "payload", "dead_time"} <= set(names)


def test_drag_ahead_is_linear_and_quadratic_damping_in_surge():
    (surge,) = (c for c in WATCHED.causes if c.name == "surge_drag")
    changed = {n for n, d in zip(WATCHED.names, surge.direction, strict=True) if d}
    assert changed == {"base:X_u_N_s_m", "base:X_uu_N_s2_m2"}


def test_what_the_model_explains_is_believed_but_for_a_hundredth():
    assert set(shares((0.0, 0.0, 0.0)).values()) == {0.01}


def test_a_disturbance_in_surge_is_a_drag_there_and_hardly_one_in_yaw():
    found = shares((0.02, 0.0, 0.0))  # a fifth of the thrust
    assert found["base:X_u_N_s_m"] == pytest.approx(0.4)
    assert found["base:N_r_N_m_s"] == pytest.approx(0.04 / 3)
    assert found["thruster_gain:rear_port"] == pytest.approx(0.04)
    assert found["hull_fouling"] == 0.01


def test_a_boat_that_did_nothing_has_nothing_to_say():
    B = len(WATCHED.names)
    mission = MissionInformation(WATCHED.names, np.eye(B), np.zeros(B), {}, (0.01, 0.01, 0.01), (0.0, 0.0, 0.0))
    assert unexplained(mission).max() > 10
