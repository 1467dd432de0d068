"""Flights that show signs and sides: to and fro on several headings, strong enough to see, by a file nobody trusts."""

import numpy as np
import pytest
from msgspec.structs import replace

from companion.core.excitation.file import Excitation, Pulses, Steps
from companion.core.excitation.signal import axis_reach, signals
from companion.core.messages import GroundTruth, StateEstimate
from companion.core.model.load_vessel import load_vessel
from companion.core.model.manoeuvring import mass_matrix
from companion.core.model.thrusters import configuration_matrix
from companion.core.model.vessel_text import vessel_toml
from companion.logs.log_file import LogFile
from sim.commission.belief import signs_checked
from sim.commission.journal import LOG
from sim.commission.signs import LEG_M_S, LEGS, PULSE_LEVEL, PULSE_S, PUSH_S, distrusted, signs_segments
from sim.fitting.engine.split import NamedLog
from sim.fitting.wiring.correction import MIRRORED
from sim.fitting.wiring.thrusters import reversed_ones
from sim.world.environment import Weather
from sim.world.stepped_logs import TRUTH
from tests.sim.commission.signs_flights import FOUR, TWO, excitation, flown, logs

TRIES = range(len(PULSE_S))


@pytest.mark.parametrize("vessel", [TWO, FOUR], ids=["two", "four"])
@pytest.mark.parametrize("flown", TRIES)
def test_every_flight_can_be_flown_and_drifts_for_about_a_minute_at_most(vessel, flown):
    assert sum(signal.duration_s for signal in signals(excitation(vessel, flown), vessel, name="x")) < 75.0


@pytest.mark.parametrize("vessel", [TWO, FOUR], ids=["two", "four"])
def test_the_first_flight_only_pulses_and_the_others_go_to_and_fro_first(vessel):
    assert all(isinstance(s, Pulses) for s in signs_segments(vessel, 0))
    hardest = PULSE_LEVEL * axis_reach(vessel)[:, 0] * PUSH_S / np.diag(mass_matrix(vessel))
    for number in TRIES[1:]:
        plan = excitation(vessel, number)
        legs = [i for i, s in enumerate(plan.segments) if isinstance(s, Steps) and s.X]
        turns = [i for i, s in enumerate(plan.segments) if isinstance(s, Steps) and s.N]
        sides = [i for i, s in enumerate(plan.segments) if isinstance(s, Steps) and s.Y]
        assert len(legs) == len(turns) == LEGS
        assert sorted([*legs, *sides, *turns]) == list(range(len(legs) + len(sides) + len(turns)))
        assert len(sides) == (LEGS if vessel is FOUR else 0)
        for axis, first in ((0, legs[0]), (1, sides[0] if sides else None)):
            if first is None:
                continue
            leg = signals(plan, vessel, name="x")[first]
            gained = configuration_matrix(vessel) @ leg.force(0.5, 1.0) * PUSH_S / np.diag(mass_matrix(vessel))
            assert gained[axis] == pytest.approx(min(LEG_M_S[number], hardest[axis]), rel=0.02)
            assert abs(np.delete(gained, axis)).max() < 0.01


def test_a_boat_that_cannot_go_ahead_and_turn_still_pulses():
    across = replace(FOUR, thrusters=tuple(replace(t, azimuth_deg=90.0) for t in FOUR.thrusters))
    assert all(isinstance(s, Pulses) for s in signs_segments(across, 1))


@pytest.mark.parametrize("vessel", [TWO, FOUR], ids=["two", "four"])
def test_the_filter_is_told_that_a_pulse_may_push_the_other_way(vessel):
    told = load_vessel(vessel_toml(distrusted(vessel)), name="told").model_error
    assert told is not None
    (pulses,) = {s for s in signs_segments(vessel, 0) if isinstance(s, Pulses)}
    plan = Excitation(format=1, name="x", segments=(pulses,))
    (signal,) = signals(plan, vessel, name="x")
    for t_s in np.arange(0.0, signal.duration_s, 0.1):
        wrong = 2 * np.abs(configuration_matrix(vessel) @ signal.force(t_s, 1.0))
        assert (wrong <= np.array([told.X_sigma_N, told.Y_sigma_N, told.N_sigma_N_m]) + 0.01).all()


@pytest.mark.long
def test_two_flights_of_a_boat_with_two_thrusters_rule_out_every_fault_and_name_mirrored_positions(tmp_path):
    uneven = tuple(replace(t, gain=gain) for t, gain in zip(TWO.thrusters, (0.75, 1.2), strict=True))
    found = logs(flown(replace(TWO, thrusters=uneven), TWO, tmp_path / "flights", 2), TWO)
    right = signs_checked(found, TWO).wiring
    assert right.findings == right.unknown == ()
    for fault in MIRRORED:  # each undoes itself
        wrong = [NamedLog(log.name, fault.apply(log.run)) for log in found]
        assert [f.name for f in signs_checked(wrong, TWO).wiring.corrected] == [fault.name]


@pytest.mark.long
def test_the_filter_knows_the_speed_of_a_boat_of_which_a_thruster_pushes_the_other_way(tmp_path):
    """By the plain file it was up to 0.7 m/s and 2.8 m off along an axis."""
    turned = load_vessel(vessel_toml(reversed_ones(FOUR, [FOUR.thrusters[0].name], "")), name="turned")
    (folder,) = flown(turned, FOUR, tmp_path / "flights", 1, weather=Weather(V_c_m_s=0.05, beta_c_deg=60.0), seed=7)
    truths = [m for m in LogFile(folder / TRUTH).messages(GroundTruth) if isinstance(m, GroundTruth)]
    at = np.array([m.t_ns for m in truths])
    for m in LogFile(folder / LOG).messages(StateEstimate):
        if isinstance(m, StateEstimate) and m.health == "healthy":
            true = truths[min(np.searchsorted(at, m.t_ns), len(at) - 1)]
            assert np.hypot(m.u_m_s - true.u_m_s, m.v_m_s - true.v_m_s) < 0.3
            assert np.hypot(m.north_m - true.north_m, m.east_m - true.east_m) < 0.5
