"""A companion that stands still while the boat goes on: afterwards the estimate is not healthy until it is right.

All that the devices have sent meanwhile arrives at once, as after SIGSTOP and SIGCONT.
"""

import math

import pytest

from companion.core.messages import Alert, GroundTruth, StateEstimate
from sim.world.environment import Weather
from tests.support.drive_fixture import driving, voyage

WAVES = {"weather": Weather(H_s_m=0.35, T_p_s=2.5)}


def errors(run, since_ns):
    """(health, position error [m], velocity error [m/s]) of every estimate since then."""
    truths = {m.t_ns: m for m in run.of(GroundTruth)}
    for e in run.of(StateEstimate):
        if e.t_ns > since_ns:
            t = truths[e.t_ns]
            away_m = math.hypot(e.north_m - t.north_m, e.east_m - t.east_m)
            yield e.health, away_m, math.hypot(e.u_m_s - t.u_m_s, e.v_m_s - t.v_m_s)


CASES = [(6.0, 1, {})]
MORE = [(stall_s, seed, world) for stall_s in (2.0, 6.0, 20.0) for seed in (2, 3) for world in ({}, WAVES)]


@pytest.mark.parametrize(
    ("stall_s", "seed", "world"), CASES + [pytest.param(*case, marks=pytest.mark.long) for case in MORE]
)
def test_after_a_stall_the_estimate_is_not_healthy_until_it_is_right(stall_s, seed, world):
    run = voyage(seed, **world)
    assert run.run(lambda r: driving(r) and r.state.guidance.s_m > 4.0 + seed, 40.0)
    run.stall(stall_s)
    back_ns = run.world.t_ns
    run.run(lambda r: False, 20.0)
    after = list(errors(run, back_ns))
    assert after[0][0] != "healthy" and after[-1][0] == "healthy"
    healthy = [(away_m, off_m_s) for health, away_m, off_m_s in after if health == "healthy"]
    assert max(away_m for away_m, _ in healthy) < 0.5
    assert max(off_m_s for _, off_m_s in healthy) < 0.2
    assert sum(f"stood still for {stall_s:.1f} s" in alert.text for alert in run.of(Alert)) == 1
