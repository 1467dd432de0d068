"""The estimator as a whole: start, late messages, spikes, offsets. World: estimator_world."""

import math

import msgspec
import numpy as np
import pytest

from companion.core.estimation.estimator import Estimator
from companion.core.messages import StateEstimate, UwbRanges
from tests.companion.core.estimation.changed_runs import S, between, changed
from tests.companion.core.estimation.estimator_world import Run, Score, estimate, step_all


@pytest.fixture(scope="module")
def plain(run: Run, estimator: Estimator) -> Score:
    return estimate(run, estimator, settle_s=15.0)


def with_range(m: UwbRanges, number: int, extra_m: float) -> UwbRanges:
    ranges = [
        msgspec.structs.replace(r, range_m=r.range_m + extra_m) if i == number else r for i, r in enumerate(m.ranges)
    ]
    return msgspec.structs.replace(m, ranges=tuple(ranges))


def away(a: StateEstimate, b: StateEstimate) -> float:
    return math.hypot(a.north_m - b.north_m, a.east_m - b.east_m)


def test_it_starts_by_itself_and_is_healthy_and_near_the_truth(run: Run, plain: Score) -> None:
    """It has a position after two fixes, and is healthy once speed has had time to settle."""
    health = [e.health for e in plain.estimates]
    first = health.index("degraded")
    assert set(health[:first]) == {"initialising"} and first < 20
    healthy = health.index("healthy")
    assert set(health[first:healthy]) == {"degraded"} and 30 <= healthy - first <= 120
    assert set(health[healthy:]) == {"healthy"}
    rms = plain.rms()
    assert rms["position_m"] < 0.15
    assert max(rms["u_m_s"], rms["v_m_s"]) < 0.05
    assert rms["heading_deg"] < 2.0
    assert plain.state.refused == {}


def test_a_late_message_counts_as_if_it_had_come_in_time(run: Run, estimator: Estimator) -> None:
    """Oracle: the same messages sorted by the instant they speak of give the same numbers."""
    state = estimator.initial()
    for t_ns, f in run.commands:
        state = estimator.command(state, t_ns, f)
    for m in (m for m in run.messages if between(m, 0, 5)):
        state, _ = estimator.step(state, m)
    rest = [m for m in run.messages if between(m, 5, 12)]
    ends = []
    late_ns = np.random.default_rng(6).integers(0, 400_000_000, 1000)  # the same for one instant's messages
    jittered = sorted(rest, key=lambda m: m.t_rx_ns + late_ns[m.t_rx_ns // 5_000_000 % 1000])
    for order in (sorted(rest, key=estimator.instant_ns), rest, jittered):
        end = state
        for m in order:
            end, _ = estimator.step(end, m)
        assert end.refused == {}
        ends.append(end.history[-1].belief)
    for late in ends[1:]:
        np.testing.assert_allclose(late.x, ends[0].x, atol=1e-9)
        np.testing.assert_allclose(late.P, ends[0].P, atol=1e-9)


def test_steps_do_not_change_the_state_they_were_given(run: Run, estimator: Estimator) -> None:
    state = estimator.initial()
    for m in run.messages[:600]:
        state, _ = estimator.step(state, m)
    before = estimator.estimate(state, 8 * S)
    other = state
    for m in run.messages[600:900]:
        other, _ = estimator.step(other, m)
    assert estimator.estimate(state, 8 * S) == before
    assert other is not state


def test_spikes_of_one_range_do_not_move_the_estimate(run, estimator, plain) -> None:
    spikes = {22: (1, 15.0), 26: (3, -8.0), 30: (0, 1.0), 34: (2, 46.0)}

    def spike(m):
        at = m.t_rx_ns // S
        return with_range(m, *spikes[at]) if isinstance(m, UwbRanges) and at in spikes else m

    hit = estimate(changed(run, spike), estimator)
    assert max(away(a, b) for a, b in zip(hit.estimates, plain.estimates, strict=True)) < 0.1


def test_rejected_measurements_are_reported_too(run: Run, estimator: Estimator) -> None:
    seen = []

    def hear(state, m):
        hit = with_range(m, 2, 15.0) if isinstance(m, UwbRanges) and between(m, 12, 13) else m
        state, innovations = estimator.step(state, hit)
        seen.extend(i for i in innovations if i.sensor == "range 111C" and between(hit, 12, 13))
        return state

    step_all(run, estimator, 20.0, hear)
    assert [i.accepted for i in seen] == [False]
    assert seen[0].innovation[0] == pytest.approx(15.0, abs=0.5)
    assert seen[0].d2 == pytest.approx(seen[0].innovation[0] ** 2 / seen[0].S[0])


def test_a_lasting_offset_of_one_anchor_becomes_its_bias(run, estimator, plain) -> None:
    def offset(m):
        return with_range(m, 0, 3.0) if isinstance(m, UwbRanges) and between(m, 20, 99) else m

    hit = estimate(changed(run, offset), estimator)
    assert hit.estimates[-1].anchor_bias_m["1151"] == pytest.approx(3.0, abs=0.3)
    assert max(away(a, b) for a, b in zip(hit.estimates, plain.estimates, strict=True)) < 0.3
