"""Which flights a commissioning asks for: no way back under power before signs are known, and nothing for nothing."""

import numpy as np
import pytest
from msgspec.structs import replace

from companion.boat.load_run import EXAMPLES, load_setup
from companion.core.configuration.tables import ConfigError
from companion.core.excitation.file import Multisine, Pulses, Steps, excitation_toml, load_excitation
from sim.commission.belief import CARE, BoatBelief
from sim.commission.stages import PROVEN, PULSE_S, SIGNS, STAGES, check_library, propose, scaled
from sim.fitting.excite.information import Knowledge
from sim.fitting.wiring.record import WiringFinding, WiringReport

SETUP = load_setup(EXAMPLES / "aritra.toml").pilot
LIBRARY = load_excitation((EXAMPLES / "excitations" / "library.toml").read_text(encoding="utf-8"), name="library")
FIRST = BoatBelief.beginning(SETUP.vessel)
MIRRORED = WiringFinding(name="positions:east", text="east_m counts to the west", nats=20.0, certain=True)
SWAPPED = WiringFinding(name="swapped:a+b", text="a and b", nats=20.0, certain=True, thrusters=True)
HULL = next(stage for stage in STAGES if stage.name == "hull")


def with_wiring(report: WiringReport) -> BoatBelief:
    return BoatBelief(FIRST.first, FIRST.vessel, FIRST.known, report)


def certain(sigma: float) -> BoatBelief:
    """A belief whose every parameter is known to `sigma` of its prior."""
    known = Knowledge(FIRST.vessel, FIRST.known.precision / sigma**2, FIRST.known.w, FIRST.known.settings)
    return BoatBelief(FIRST.first, FIRST.vessel, known, WiringReport(logs=1))


def asked(stage, belief, *, left_s=600.0, flown=0, yielded=1.0):
    return propose(stage, belief, LIBRARY, SETUP.site, left_s, flown, yielded)


@pytest.mark.parametrize("flown", range(len(PULSE_S)))
def test_until_signs_are_known_the_boat_never_drives_back_and_the_file_is_not_trusted(flown):
    proposal = asked(SIGNS, FIRST, flown=flown)
    plan, vessel = proposal.plan, proposal.vessel
    assert plan is not None and not plan.homing and plan.caution == CARE[1]
    assert any(isinstance(segment, Pulses) and segment.on_s == PULSE_S[flown] for segment in plan.segments)
    assert load_excitation(excitation_toml(plan), name="x") == plan
    assert vessel is not None and vessel.model_error is not None and vessel.damping == FIRST.first.damping


def test_longer_pulses_each_time_then_it_gives_up():
    assert list(PULSE_S) == sorted(PULSE_S)
    assert asked(SIGNS, FIRST, flown=len(PULSE_S)).plan is None


def test_nothing_more_is_flown_by_a_boat_whose_positions_are_mirrored():
    mirrored = with_wiring(WiringReport(logs=2, findings=(MIRRORED,)))
    told = asked(SIGNS, mirrored, flown=2)
    assert told.plan is None and MIRRORED.text in told.why and not mirrored.signs_known
    assert asked(SIGNS, mirrored, flown=1).plan is not None  # one flight is not enough to say so


def test_signs_are_known_after_two_flights_that_leave_no_fault_open():
    clear = with_wiring(WiringReport(logs=2))
    assert clear.signs_known and asked(SIGNS, clear, flown=1).plan is not None
    assert asked(SIGNS, clear, flown=2).plan is None


@pytest.mark.parametrize(
    "report",
    [
        WiringReport(),
        WiringReport(logs=0),
        WiringReport(logs=1, unknown=("a and b have changed places",)),
        WiringReport(logs=1, findings=(WiringFinding(name="x", text="a", certain=False, thrusters=True),)),
        WiringReport(logs=1, findings=(replace(MIRRORED, certain=False),)),
        WiringReport(logs=1, findings=(replace(SWAPPED, rivals=("b pushes the wrong way",)),)),
        WiringReport(logs=1, findings=(SWAPPED,), unknown=("north_m counts to the south",)),
    ],
)
def test_what_is_not_certain_is_not_known(report):
    assert not with_wiring(report).signs_known


def test_a_fault_that_was_put_right_and_an_uncalibrated_compass_leave_signs_known():
    compass = WiringFinding(name="compass", text="c", nats=9.0, certain=False, advice="calibrate it")
    assert with_wiring(WiringReport(logs=2, findings=(SWAPPED, compass))).signs_known


def test_caution_falls_from_the_worst_plausible_boat_to_that_of_a_measured_one():
    cautions = [certain(sigma).caution for sigma in (1.0, 0.3, 0.1, 0.01)]
    assert cautions[0] == CARE[1] and cautions[-1] == CARE[0]
    assert cautions == sorted(cautions, reverse=True)


def test_a_library_of_more_caution_than_the_belief_asks_for_keeps_it():
    careful = replace(LIBRARY, caution=4.0)
    plans = [propose(stage, FIRST, careful, SETUP.site, 600.0, 0).plan for stage in (SIGNS, PROVEN)]
    assert [plan and plan.caution for plan in plans] == [4.0, 4.0]


def test_a_library_of_which_a_stage_can_fly_nothing_ends_the_stage_and_says_why():
    only = replace(LIBRARY, segments=(Steps(name="a touch", X=0.1, levels=(1.0,), hold_s=0.3),))
    proposal = propose(HULL, certain(0.1), only, SETUP.site, 600.0, 0)
    assert proposal.plan is None and "no segment can be flown" in proposal.why and "a touch" in proposal.why


def test_a_library_that_cannot_prove_a_file_is_refused_by_name():
    check_library(LIBRARY, name="mine.toml")
    with pytest.raises(ConfigError, match=r'mine\.toml: segments: none has the name "zig-zag" or "multisine"'):
        check_library(replace(LIBRARY, segments=()), name="mine.toml")


def test_levels_grow_with_what_is_known():
    surge = next(s for s in LIBRARY.segments if isinstance(s, Steps) and s.name == "surge steps")
    careful, sure = scaled(surge, FIRST), scaled(surge, certain(0.01))
    assert isinstance(careful, Steps)
    assert np.allclose(careful.levels, np.array(surge.levels) * CARE[0] / CARE[1])
    assert sure == surge


@pytest.mark.long
def test_a_stage_ends_where_a_minute_tells_too_little_and_says_how_little():
    few = replace(LIBRARY, segments=tuple(s for s in LIBRARY.segments if s.name in ("pulses", "surge steps")))
    first = propose(HULL, FIRST, few, SETUP.site, 600.0, 0)
    assert first.plan is not None and first.nats > 5 and 0 < first.minutes <= 2.5
    nothing = propose(HULL, FIRST, few, SETUP.site, 600.0, 0, yielded=0.01)
    assert nothing.plan is None and "nats" in nothing.why
    assert propose(HULL, FIRST, few, SETUP.site, 5.0, 0).why == "no time left"
    assert propose(HULL, FIRST, few, SETUP.site, 600.0, HULL.most).plan is None


def test_the_proof_of_a_boat_that_cannot_push_sideways_does_not_ask_it_to():
    two = tuple(replace(t, azimuth_deg=0.0) for t in SETUP.vessel.thrusters[:2])
    boat = BoatBelief.beginning(replace(SETUP.vessel, thrusters=two))
    assert sideways_share(boat) == 0.0 and sideways_share(FIRST) > 0.0


def sideways_share(belief: BoatBelief) -> float:
    plan = asked(PROVEN, belief).plan
    assert plan is not None
    (multisine,) = (s for s in plan.segments if isinstance(s, Multisine))
    return multisine.Y
