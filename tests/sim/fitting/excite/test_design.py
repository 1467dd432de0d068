"""Fisher information before and after a flight, advice on the next manoeuvre, plans. Reference boat."""

from functools import cache, partial

import msgspec
import numpy as np
import pytest

from companion.core.configuration.tables import ConfigError
from companion.core.excitation.file import Idle
from sim.fitting.engine.noise import STATE, L
from sim.fitting.engine.split import JobError
from sim.fitting.excite.design import advise, candidates, choose, design, least_share, worth_per_s
from sim.fitting.excite.information import (
    PLANNED,
    TRUTH,
    Knowledge,
    indices_of_interest,
    planned_information,
    recorded_knowledge,
)
from sim.fitting.excite.nominal import fly_nominal
from sim.fitting.identify.result import fit_structured
from sim.fitting.identify.structured_fit import StructuredFit
from sim.studies.boats.draw import in_still_air
from sim.world.teleop_log import Habits, KeyboardPilot, teleop_run
from tests.support.excitation_fixture import BASIN, LIBRARY
from tests.support.vessel_fixtures import boat

NAMES = ("surge steps", "strafe", "spin both ways", "sideways turns", "opposed thrusters", "idle")
VESSEL = boat("aritra")


@cache
def library():
    few = tuple(s for s in LIBRARY.segments if s.name in NAMES)
    return msgspec.structs.replace(LIBRARY, segments=few)


@cache
def found():
    return {c.segment.name: c for c in candidates(library(), VESSEL, BASIN)[0]}


def prior():
    return Knowledge.prior(VESSEL)


def after(*names):
    return prior().with_information(sum(found()[name].information for name in names))


def index(name):
    return prior().parameters.names.index(name)


@pytest.mark.long
def test_a_manoeuvre_shows_what_it_moves_and_nothing_else():
    surge, spin, idle = (after(n).share for n in ("surge steps", "spin both ways", "idle"))
    assert surge[index("X_uu_N_s2_m2")] < 0.1 and surge[index("Y_vv_N_s2_m2")] > 0.95
    assert spin[index("N_rr_N_m_s2")] < 0.1 and spin[index("X_uu_N_s2_m2")] > 0.95
    assert idle[indices_of_interest(VESSEL)] == pytest.approx(1.0, abs=0.02)
    assert after("opposed thrusters").share[index("gain_rear_port")] < 0.7 < after("surge steps").share[index("M22_kg")]


@pytest.mark.long
def test_knowledge_only_grows_and_a_flight_twice_is_twice_the_information():
    once = found()["strafe"].information
    assert np.linalg.eigvalsh(once).min() > -1e-6 * np.linalg.eigvalsh(once).max()
    assert (after("strafe").share <= 1 + 1e-9).all()
    assert (after("strafe", "surge steps").share <= after("strafe").share + 1e-9).all()


def precision_at_truth(runs, noise=None):
    """Precision (P, P) of w from these runs with the prior, at the true states and parameters, and the noise used."""
    fit = StructuredFit(runs, VESSEL, PLANNED)
    z = np.zeros((fit.windows.size[0], L))
    for run, span in zip(runs, fit.windows.spans, strict=True):
        t, truth = run.samples(*TRUTH)
        truth[:, 2] = np.unwrap(truth[:, 2])
        z[span, STATE] = np.column_stack([np.interp(fit.windows.t_s[span, 0], t, c) for c in truth.T])
    noise = noise or fit.noise
    return fit.assemble(fit.point(fit.parameters.prior[0], z), noise)[0].solve()[2], noise


def test_information_adds_up_over_runs():
    """Two flights linearised together, with one noise, tell as much as each by itself."""
    runs = [fly_nominal(msgspec.structs.replace(library(), segments=(s,)), VESSEL, BASIN).run
            for s in library().segments if s.name in ("strafe", "spin both ways")]  # fmt: skip
    together, noise = precision_at_truth(runs)
    before = prior().precision
    summed = before + sum(precision_at_truth([run], noise)[0] - before for run in runs)
    of = indices_of_interest(VESSEL)
    ratio = np.sqrt(np.diag(np.linalg.inv(together))[of] / np.diag(np.linalg.inv(summed))[of])
    assert ratio == pytest.approx(1.0, abs=1e-3)


@pytest.mark.long
def test_what_is_expected_of_a_log_is_what_the_fit_finds():
    """A noisy log of 150 s (seed 3): standard errors of the fit against those expected from its motion alone."""
    vessel = in_still_air(VESSEL)
    run = teleop_run(vessel, 3, 150.0, imu_hz=50.0)
    fitted, expected = fit_structured([run], vessel), prior().with_information(planned_information(run, vessel))
    of = indices_of_interest(VESSEL)
    ratio = np.array([p.se for p in fitted.parameters])[of] / expected.se[of]
    print(dict(zip(np.array(expected.parameters.names)[of], ratio.round(2), strict=True)))
    assert (ratio > 1 / 1.5).all() and (ratio < 1.5).all()
    known = recorded_knowledge([run], vessel)
    assert known.share[of] == pytest.approx([p.share_of_prior for p in fitted.parameters[: len(of)]], rel=0.2)


def test_a_log_counts_once_and_one_of_another_boat_is_refused():
    """Named twice, a log made every parameter known better by a third than it was."""
    run, twin = teleop_run(VESSEL, 3, 60.0), teleop_run(boat("twin"), 3, 60.0)
    with pytest.raises(JobError, match="holds the same data as"):
        recorded_knowledge([run, run], VESSEL)
    with pytest.raises(JobError, match="another boat's log"):
        recorded_knowledge([twin], VESSEL)


def moves(candidate, column):
    flown = fly_nominal(msgspec.structs.replace(library(), segments=(candidate.segment,)), VESSEL, BASIN)
    return float(flown.run.table[column].abs().max())


@pytest.mark.long
def test_after_surge_alone_comes_a_manoeuvre_that_moves_sideways():
    advice = advise(after("surge steps"), tuple(found().values()))
    assert {index(n) for n in ("M22_kg", "Y_v_N_s_m", "Y_vv_N_s2_m2")} <= set(advice.about)
    assert moves(advice.ranked[0], "true_v_m_s") > 0.3
    assert advice.ranked[-1].segment.name in ("idle", "surge steps")
    row = next(r for r in advice.rows if r.index == index("Y_vv_N_s2_m2"))
    assert moves(row.best, "true_v_m_s") > 0.3 and row.after.share[row.index] < 0.2


def test_after_surge_and_sway_comes_a_turn_and_after_a_spin_comes_thrust():
    turn = advise(after("surge steps", "strafe"), tuple(found().values()))
    assert moves(turn.ranked[0], "true_r_rad_s") > 0.3
    push = advise(after("spin both ways"), tuple(found().values()))
    assert index("X_uu_N_s2_m2") in push.about and index("N_rr_N_m_s2") not in push.about
    assert max(moves(push.ranked[0], f"true_{c}_m_s") for c in "uv") > 0.3


def test_a_recorded_log_of_surge_alone_asks_for_sway_too():
    """A teleop log in which the pilot only drives ahead and astern (seed 4)."""
    pilot = partial(KeyboardPilot, habits=Habits(use=(1.0, 0.0, 0.0), home_n=0.0))
    run = teleop_run(VESSEL, 4, 90.0, pilot=pilot)
    advice = advise(recorded_knowledge([run], VESSEL), tuple(found().values()))
    assert index("Y_vv_N_s2_m2") in advice.about and index("X_uu_N_s2_m2") not in advice.about
    assert moves(advice.ranked[0], "true_v_m_s") > 0.3


@pytest.mark.long
@pytest.mark.parametrize("criterion", ["d", "worst"])
def test_a_plan_keeps_to_its_time_and_to_the_fence_and_beats_its_first_segment_flown_over(criterion):
    known, every = prior(), tuple(found().values())
    chosen = choose(known, every, 100.0, criterion)
    plan, flown = design(known, library(), chosen, BASIN, 100.0, name="plan")
    assert flown.done and flown.duration_s <= 100.0 and flown.least_clearance_m > plan.margin_m
    assert "idle" not in [s.name for s in plan.segments]
    told = known.with_information(planned_information(flown.run, VESSEL))
    same = known.with_information(3 * found()["surge steps"].information)
    of = indices_of_interest(VESSEL)
    assert np.linalg.slogdet(told.covariance[np.ix_(of, of)])[1] < np.linalg.slogdet(same.covariance[np.ix_(of, of)])[1]
    assert not told.undetermined[of].any()


def test_greedy_takes_the_worthiest_first_and_worth_falls_as_more_is_known():
    known, every = prior(), tuple(found().values())
    least = least_share(known, every)
    first = choose(known, every, 40.0)[0]
    values = {c.segment.name: worth_per_s(known, c, least, "d") for c in every if c.duration_s <= 56.0}
    assert first.segment.name == max(values, key=lambda name: values[name])
    assert worth_per_s(known.with_information(first.information), first, least, "d") < values[first.segment.name] / 3


def test_what_a_boat_cannot_fly_is_left_out_and_nothing_at_all_is_an_error():
    found_, left_out = candidates(library(), boat("twin"), BASIN)
    assert [c.segment.name for c in found_] == ["surge steps", "spin both ways", "idle"]
    assert len(left_out) == 3 and any("strafe" in text and ".Y" in text for text in left_out)
    short = msgspec.structs.replace(library(), segments=(Idle(name="blink", duration_s=0.5),))
    with pytest.raises(ConfigError, match="no segment can be flown"):
        candidates(short, VESSEL, BASIN)
