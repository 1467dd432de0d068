"""A companion that stands still while the boat goes on: afterwards the estimate is not healthy until it is right.

All that the devices have sent meanwhile arrives at once, as after SIGSTOP and SIGCONT.
"""

import pytest

from companion.core.messages import StateEstimate
from tests.evidence.firmware.missions import WAVES
from tests.evidence.firmware.stall import stand_still
from tests.support.drive_fixture import driving, voyage

CASES = [(6.0, 1, {})]
MORE = [(stall_s, seed, world) for stall_s in (2.0, 6.0, 20.0) for seed in (2, 3) for world in ({}, {"weather": WAVES})]


@pytest.mark.parametrize(
    ("stall_s", "seed", "world"), CASES + [pytest.param(*case, marks=pytest.mark.long) for case in MORE]
)
def test_after_a_stall_the_estimate_is_not_healthy_until_it_is_right(stall_s, seed, world):
    run = voyage(seed, **world)
    assert run.run(lambda r: driving(r) and r.state.guidance.s_m > 4.0 + seed, 120.0), "under way"
    back_ns = run.world.t_ns + round(stall_s * 1e9)
    stalled = stand_still(run, stall_s)
    after = [e.health for e in run.of(StateEstimate) if e.t_ns > back_ns]
    assert after[0] != "healthy" and after[-1] == "healthy"
    assert stalled.away_m < 0.5
    assert stalled.off_m_s < 0.2
    assert stalled.alerts == 1
