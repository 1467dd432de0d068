"""Plans that cannot be meant are not sent, and no plan is sent faster than the thrusters' rate limit."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from companion.core import messages as m
from companion.core.pilot.plan_check import NO_PROPOSALS, PlanCheck
from tests.companion.core.pilot.pilot_shell import VESSEL, N, attitude, heartbeat, on_the_leg, plan

RATE_N = 12.0
"""120 N/s of the vessel file in a tick."""
MOST_N, LEAST_N = 38.0, -30.0


def proposed(shell, f_n):
    """One tick with this plan; its lease."""
    shell.feed(heartbeat(shell.t_ns), attitude(shell))
    shell.tick()
    shell.wait(10)
    shell.feed(plan(shell.index, f_n=f_n))
    shell.wait(-10)
    return shell.lease


@pytest.mark.parametrize(
    ("f_n", "words"),
    [
        (((1e6, -1e6, 0.0, 0.0),) * 20, "1e+06 N of thruster 1, which has -30 to 38 N"),
        (((0.0, 0.0, 0.0, -31.0),) * 20, "-31 N of thruster 4"),
        (((MOST_N,) * N, (LEAST_N,) * N) * 10, "jumps by 68 N between stages, at most 48.5 N"),
    ],
    ids=["far beyond", "beyond", "alternating stages"],
)
def test_a_plan_that_no_controller_of_ours_makes_is_not_sent(f_n, words):
    shell = on_the_leg()
    proposed(shell, None)
    lease = proposed(shell, f_n)
    assert lease.source == "pd" and "not plausible" in lease.reason and words in lease.reason
    assert proposed(shell, None).source == "plan"


def test_a_plan_that_misses_a_limit_by_a_rounding_is_sent_within_it():
    shell = on_the_leg()
    for _ in range(6):
        lease = proposed(shell, ((MOST_N + 0.1, 0.0, 0.0, LEAST_N - 0.1),) * 20)
    assert lease.source == "plan" and lease.f_command_n == (MOST_N, 0.0, 0.0, LEAST_N)


def test_a_rounding_on_a_dead_thruster_is_no_reason_to_refuse_a_plan():
    first, *others = VESSEL.thrusters
    vessel = replace(VESSEL, thrusters=(replace(first, gain=0.0), *others))
    check = PlanCheck(vessel, step_s=0.2, period_s=0.1)
    assert check.judge(NO_PROPOSALS, plan(1, f_n=((1e-6, 5.0, 5.0, 5.0),) * 20)).problem is None


def test_a_plan_is_sent_within_the_rate_limit():
    shell = on_the_leg()
    before = proposed(shell, ((0.0,) * N,) * 20)
    for k in range(1, 6):
        lease = proposed(shell, ((MOST_N, LEAST_N, 5.0, 0.0),) * 20)
        wanted = (min(MOST_N, k * RATE_N), max(LEAST_N, -k * RATE_N), 5.0, 0.0)
        assert (before.f_command_n, lease.source) == ((0.0,) * N, "plan") and lease.f_command_n == wanted


def test_full_force_that_alternates_every_tick_is_first_slowed_then_refused():
    """Each plan is sound by itself."""
    shell = on_the_leg()
    proposed(shell, ((0.0,) * N,) * 20)
    forces, sources = [(0.0,) * N], []
    for k in range(40):
        lease = proposed(shell, ((MOST_N if k % 2 else LEAST_N,) * N,) * 20)
        forces.append(lease.f_command_n)
        sources.append(lease.source)
    assert np.abs(np.diff(forces, axis=0)).max() <= RATE_N + 1e-9 and np.abs(forces).max() < 20.0
    assert sources.count("plan") <= 8 and set(sources[8:]) == {"pd"}, "an earlier plan of it is not gone on with"
    assert "turn about at every tick" in lease.reason
    told = [o.text for o in shell.outputs if isinstance(o, m.Alert)]
    assert sum("turn about" in text for text in told) == 1
    lease = [proposed(shell, ((1.0,) * N,) * 20) for _ in range(3)][-1]
    assert lease.source == "plan", "a controller that has come to its senses"


def test_after_a_pause_the_rate_limit_begins_at_rest():
    """What was sent in between was neutral."""
    shell = on_the_leg()
    for _ in range(4):
        proposed(shell, ((30.0,) * N,) * 20)
    assert shell.lease.f_command_n == (30.0,) * N
    shell.wait(400)
    assert proposed(shell, ((30.0,) * N,) * 20).f_command_n == (RATE_N,) * N
