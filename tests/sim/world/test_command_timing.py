"""When a command acts: `control.latency_s` and the dead time after it was sent, also between two steps of the world."""

from itertools import pairwise

import numpy as np
import pytest

from companion.core.messages import GroundTruth, OverrideLease
from sim.world.world import STEP_NS, Afloat, WorldSetup
from tests.support.drive_fixture import START, driving, setup, voyage

KNOWN = setup().pilot
NEUTRAL, TURN = (1500,) * 4, (1600, 1400, 1600, 1400)


def test_pulses_that_change_within_a_step_act_from_their_instant_on():
    one, two = (Afloat(WorldSetup(KNOWN.vessel, KNOWN.site, start=START), 1) for _ in range(2))
    one.advance(NEUTRAL, changes=[(one.t_ns + 4_000_000, TURN)])
    two.advance(NEUTRAL, 4_000_000)
    two.advance(TURN, STEP_NS - 4_000_000)
    for _ in range(30):
        one.advance(TURN)
        two.advance(TURN)
    assert one.plant.motion.x == pytest.approx(two.plant.motion.x, abs=1e-9)
    assert abs(one.plant.motion.x[6]) > 1.0


def test_a_commanded_force_comes_when_the_run_file_and_the_vessel_file_say():
    """Seed 3: the delay that explains what is left of the true forces, by least squares; the world's step: 10 ms."""
    run = voyage(3)
    run.run(driving, 60.0)
    run.run(lambda _: False, 15.0)
    leases, truths = run.of(OverrideLease), run.of(GroundTruth)
    propulsion = KNOWN.vessel.propulsion
    act_s = 1e-9 * np.array([lease.t_ns for lease in leases]) + KNOWN.control.latency_s + propulsion.dead_time_s
    commands = np.array([lease.f_command_n for lease in leases])

    def after(f, command, s):
        return command + (f - command) * np.exp(-s / propulsion.lag_s)

    f, slope, left = np.zeros(4), [], []
    for command, (t_s, until_s) in zip(commands[:-1], pairwise(act_s), strict=True):
        for truth in (g for g in truths if t_s <= 1e-9 * g.t_ns < until_s):
            now = after(f, command, 1e-9 * truth.t_ns - t_s)
            slope.append((command - now) / propulsion.lag_s)
            left.append(truth.f_n - now)
        f = after(f, command, until_s - t_s)
    delay_s = -np.sum(np.multiply(slope, left)) / np.sum(np.square(slope))
    assert abs(delay_s) < 1.5e-3
