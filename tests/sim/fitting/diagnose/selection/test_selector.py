"""Which cause is taken next, and which of those taken stand beside their rivals."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from companion.logs.runs.splits import parts
from sim.fitting.diagnose.catalogue import catalogue
from sim.fitting.diagnose.posterior.evidence import Posterior, Prior
from sim.fitting.diagnose.posterior.fit import PosteriorFit
from sim.fitting.diagnose.posterior.noise import stated_noise
from sim.fitting.diagnose.posterior.physics import EffectPhysics
from sim.fitting.diagnose.selection.candidate_score import Candidate, score_candidate
from sim.fitting.diagnose.selection.greedy_selection import Rivals, Selection, Selector, justifies_removal
from sim.fitting.diagnose.selection.model import CandidateModel
from sim.fitting.diagnose.selection.search import search_causes
from tests.sim.fitting.diagnose.posterior_fixture import VESSEL, bench, short


def test_a_special_case_makes_room_only_for_what_explains_more():
    def model(evidence, *active):
        return CandidateModel(frozenset(active), None, None, (), None, evidence)

    steady = model(0.0, "current")
    assert not justifies_removal(steady, model(11.0, "turning_current@1"))
    assert justifies_removal(steady, model(13.0, "turning_current@1"))
    assert justifies_removal(steady, model(1.0, "current", "lag")), "judged by its own nats"


def searching(before: CandidateModel, gains: dict[str, float], refused: tuple[str, ...] = ()) -> Selector:
    """A search whose refits end with the evidence `gains` (by id), of which all but `refused` are acceptable."""
    selector = Selector(copy(bench()[0]))
    selector.refit = lambda _start, active, values: replace(before, active=active, evidence=gains[next(iter(values))])
    selector.start_values = lambda _model, _candidate: np.zeros(1)
    selector.score_active = lambda _model, id_: hopeful(id_, 0.5 if id_ in refused else 8.0)
    return selector


def first(selector: Selector, start: CandidateModel, ranking: list[Candidate]) -> Selection:
    """The search from `start` where `ranking` are the candidates, and none is left once one was taken."""
    selector.screen = lambda model: ranking if model is start else []
    selector.linearise_catalogue = lambda _model: None
    return selector.run(start)


def hopeful(id_: str, lower: float = 8.0, size: float = 9.0) -> Candidate:
    return Candidate(id_, 500.0, 500.0, np.ones(len(bench()[0].effects)), np.eye(1), size, lower)


def before(*active: str) -> CandidateModel:
    return CandidateModel(frozenset(active), SimpleNamespace(cost=100.0), None, (), None, 0.0)


def turning() -> str:
    return next(e.id for e in bench()[0].effects if e.name == "turning_current")


def test_a_special_case_that_stays_does_not_end_the_search():
    """A turning current gains 10 nats over the steady one, in whose place it would come; a lag 9 beside it."""
    steady = before("current")
    selector = searching(steady, {turning(): 10.0, "lag": 9.0})
    found = first(selector, steady, [hopeful(turning()), hopeful("lag")])
    assert found.final.active == {"current", "lag"} and found.rivals == {"lag": []}


def test_what_explains_more_than_the_special_case_that_is_taken_is_told_if_it_could_be_named():
    """A turning current is too small, the steady one is taken in its place: a lag explains more than that."""
    nothing, gains = before(), {turning(): 30.0, "lag": 25.0, "current": 20.0}
    ranking = [hopeful(id_) for id_ in gains]
    found = first(searching(nothing, gains, (turning(),)), nothing, ranking)
    assert found.final.active == {"current"} and found.rivals == {"current": [("lag", 0.0)]}
    found = first(searching(nothing, gains, (turning(), "lag")), nothing, ranking)
    assert found.final.active == {"current"} and found.rivals == {"current": []}


def test_what_lies_between_the_places_that_are_tried_seems_small_and_is_refitted_if_nothing_else_stands():
    zone = next(e.id for e in bench()[0].effects if e.name == "shallow_zone")
    nothing, gains = before(), {"lag": 20.0, zone: 30.0}
    small = [hopeful(zone, size=0.5), hopeful("lag")]
    assert first(searching(nothing, gains, ("lag",)), nothing, small).final.active == {zone}
    found = first(searching(nothing, gains), nothing, small)
    assert found.final.active == {"lag"} and found.rivals == {"lag": []}
    found = first(searching(nothing, gains), nothing, [hopeful("lag", size=0.5)])
    assert found.final is nothing and found.rivals == {}


def test_an_impossible_value_at_one_of_many_places_hides_no_cause_that_explains_nearly_as_much():
    """A shallow that would weaken the damping, 3 nats before a scale of the gyro, which could be named."""
    zone = next(e.id for e in bench()[0].effects if e.name == "shallow_zone")
    nothing, ranking = before(), [hopeful(zone), hopeful("gyro_scale")]

    def best(scale: float, lower: float) -> frozenset[str]:
        selector = searching(nothing, {zone: 42.0, "gyro_scale": scale})
        selector.score_active = lambda _model, id_: hopeful(id_, lower if id_ == zone else 8.0)
        return first(selector, nothing, ranking).final.active

    assert best(39.0, -np.inf) == {"gyro_scale"}
    assert best(29.0, -np.inf) == frozenset(), "12 nats and more are no chance: there is something"
    assert best(39.0, 0.5) == frozenset(), "possible, but perhaps too small: nothing else may stand in for it"


def weighing(evidence: dict[frozenset[str], float]) -> Selector:
    """A search in which believing in a set is worth what `evidence` says, for all who stand a test."""
    selector = Selector(copy(bench()[0]))
    selector.refit = lambda _start, active, _values: replace(before(*active), evidence=evidence[active])
    selector.screen = lambda _model: [hopeful("payload"), hopeful("dead_time")]
    selector.linearise_catalogue = lambda _model: None
    selector.start_values = lambda _model, _candidate: np.zeros(1)
    selector.score_active = lambda _model, id_: hopeful(id_)
    return selector


def test_rivals_are_judged_beside_what_was_found_later():
    """Dead time was 1 nat behind a lag when that was taken; beside the wash it is 30 behind."""
    sets = {("lag", "wash"): 100.0, ("wash",): 20.0, ("dead_time", "wash"): 70.0}
    selector = weighing({frozenset(k): v for k, v in sets.items()})
    whole = both_with({"lag": [("dead_time", 1.0), ("payload", 8.0)]})
    assert selector.without(whole, ()).rivals == {"lag": [("dead_time", 30.0), ("payload", 8.0)]}


def both_with(rivals: Rivals) -> Selection:
    """A lag and a wash are active in."""
    return Selection(before(), before("lag", "wash"), [hopeful("lag"), hopeful("wash")], [], rivals)


def test_a_rival_without_which_the_boat_is_thrown_out_of_bounds_is_none():
    selector = weighing({})

    def thrown(_start: CandidateModel, active: frozenset[str], _values: dict[str, np.ndarray]) -> CandidateModel:
        if active == {"lag", "wash"}:
            return before(*active)
        raise np.linalg.LinAlgError

    selector.refit = thrown
    whole = both_with({"lag": [("dead_time", 1.0)]})
    assert selector.without(whole, ()).rivals == {"lag": [("dead_time", np.inf)]}


def test_rivals_are_judged_without_what_was_taken_back():
    """Dead time was 5 nats behind a lag beside a wash that is gone; now it explains as much."""
    pairs = {("lag",): 60.0, ("dead_time",): 61.0, (): 0.0}
    selector = weighing({frozenset(k): v for k, v in pairs.items()})
    causes = [hopeful("lag"), hopeful("wash")]
    whole = Selection(before(), before("lag", "wash"), causes, [], {"lag": [("dead_time", 5.0)]})
    assert selector.without(whole, {"wash"}).rivals == {"lag": [("dead_time", 0.0)]}


@pytest.mark.long
def test_pieces_of_a_log_tell_no_more_of_a_bias_than_the_log():
    """What one log's accelerometers may have is no cause: its standard error is nearly that of a bias as drawn."""
    sigma, errors = VESSEL.sensors.imu.accel_bias_sigma_m_s2, []
    for runs in ([short()], parts(short(), [(10.0 * k, 10.0 * k + 8.0) for k in range(4)])):
        fit = PosteriorFit(EffectPhysics(runs, VESSEL, 1.0), catalogue(VESSEL, runs), stated_noise(VESSEL, runs))
        selector = Selector(fit)
        (bias,) = selector.fit_causes(selector.base(), ["accel_bias"]).causes
        errors.append(np.sqrt(np.diag(bias.covariance)))
    assert errors[1] == pytest.approx(errors[0], rel=0.03) and (errors[0] > 0.85 * sigma).all()


def test_what_does_not_stand_without_a_cause_that_is_taken_back_goes_too():
    """The lag is too small without the wash, and the refit that counts is the one without both."""
    selector = Selector(bench()[0])
    there = {"wash", "lag", "payload"}
    tried: list[frozenset[str]] = []
    selector.refit = lambda _start, active, _values: tried.append(active) or before(*active)
    selector.score_active = lambda _model, id_: hopeful(id_, 0.5 if id_ == "lag" else 8.0)
    selector.linearise_catalogue = lambda _model: None
    rivals = {"lag": [("dead_time", 1.0)], "payload": []}
    whole = Selection(before(), before(*there), [hopeful(id_) for id_ in sorted(there)], [], rivals)
    left = selector.without(whole, {"wash"})
    assert [c.id for c in left.causes] == ["payload"] and left.final.active == {"payload"}
    assert tried == [{"lag", "payload"}, {"payload"}] and left.rivals == {"payload": []}


def test_two_causes_of_which_one_contains_the_other_are_not_known_together():
    fit, _ = bench()
    with pytest.raises(ValueError, match="'turning_current' or 'current', not both"):
        search_causes(fit, known_causes=("current", "turning_current"))


def test_a_constant_force_is_no_tether():
    """A pull of 5 N from an anchor 5,000 km away is not one that somebody could look for; of a long rope it is."""
    tether = next(e for e in bench()[0].effects if e.name == "tether")
    at, C = slice(0, 4), np.diag([0.01, 0.1, 0.1, 0.05]) ** 2
    for k, itself in ((0.001, False), (-0.004, False), (0.03, True)):
        posterior = Posterior(np.array([k, 5.0, 0.0, 0.0]), C, Prior.zero_mean(np.array([1.0, 10.0, 10.0, 1.0])))
        assert (score_candidate(posterior, at, tether).lower > 1.0) == itself
