"""Excitations flown by the whole chain, over wire formats: inside the fence, and worth their time to the fit."""

from functools import cache, partial

import numpy as np
import pytest

from companion.boat.load_run import EXAMPLES, load_setup, setup_of
from companion.core.excitation.file import Idle, Steps, excitation_toml
from companion.core.messages import OverrideLease, Tick
from companion.logs.readers.read_run import ReadOptions, read_run
from sim.fitting.engine.parameters import Parameters, file_values
from sim.fitting.excite.design import candidates, choose, design
from sim.fitting.excite.fly import fly, write_logs
from sim.fitting.excite.information import Knowledge
from sim.fitting.identify.result import fit_structured
from sim.studies.boats.campaign import scale_free
from sim.studies.boats.draw import draw_boat, in_still_air
from sim.world.environment import Weather
from sim.world.sensors import UwbFaults
from sim.world.teleop_log import Habits, KeyboardPilot, teleop_run
from sim.world.world import WorldSetup
from tests.support.excitation_fixture import BASIN, LIBRARY, of
from tests.support.vessel_fixtures import boat

WILD = of(
    Steps(name="run", X=0.5, levels=(1.0, -1.0), hold_s=9.0),
    Steps(name="side", Y=0.8, hold_s=10.0),
    Idle(name="drift", duration_s=8.0),
)
FAR = of(Steps(name="run", X=0.5, levels=(1.0, -1.0), hold_s=16.0), Steps(name="side", Y=0.8, hold_s=30.0))
MIDDLE = (15.0, 15.0, 0.4)
BEGIN_UNIX_NS = 1_790_000_000_000_000_000


def setup_with(excitation):
    told = load_setup(EXAMPLES / "aritra.toml")
    texts = {**told.files, "excitation.toml": excitation_toml(excitation)}
    return setup_of(texts, {name: name for name in texts})


def rough(seed):
    """A hull up to 30 % off its file, current, wind, a tag that misses and lies."""
    rng = np.random.default_rng(seed)
    to, come = rng.uniform(0, 360, 2)
    sky = Weather(V_c_m_s=0.1, beta_c_deg=to, V_w_m_s=3.0, beta_w_deg=come, gustiness=0.2)
    return WorldSetup(
        boat("aritra"), BASIN, start=MIDDLE, weather=sky, mismatch=0.3, faults=UwbFaults(dropout=0.1, nlos=0.03)
    )


def check(flown, margin_m):
    assert flown.done and flown.ending == "excitation done"
    assert flown.least_clearance_m > margin_m
    leases = [m for m in flown.messages if isinstance(m, OverrideLease)]
    assert [m.index for m in leases] == [m.index for m in flown.messages if isinstance(m, Tick)]
    assert all(1100 <= pwm <= 1900 for m in leases for pwm in m.pwm_us)
    assert {m.source for m in leases} == {"neutral", "excitation"}


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, 1])
def test_hard_driving_in_rough_water_stays_inside(seed):
    flown = fly(setup_with(WILD), rough(seed), seed)
    check(flown, WILD.margin_m - 0.4)
    assert max(np.hypot(m.u_m_s, m.v_m_s) for m in flown.truths) > 1.0


@pytest.mark.long
@pytest.mark.parametrize("seed", [10, *(pytest.param(s, marks=pytest.mark.matrix) for s in range(11, 20))])
def test_runs_longer_than_the_basin_stay_inside_on_ten_more_seeds(seed):
    flown = fly(setup_with(FAR), rough(seed), seed)
    check(flown, FAR.margin_m - 0.4)
    assert max(np.hypot(m.u_m_s, m.v_m_s) for m in flown.truths) > 1.0


# --- five minutes of a designed plan against five minutes of a pilot who only drives ahead and astern --------

MINUTES = 5.0
AHEAD_AND_ASTERN = partial(KeyboardPilot, habits=Habits(use=(1.0, 0.0, 0.0), home_n=0.0))
"""In open water: in a basin the ways back would be manoeuvres, too, and tell of sway and yaw."""


@cache
def designed():
    vessel = boat("aritra")
    known, found = Knowledge.prior(vessel), candidates(LIBRARY, vessel, BASIN)[0]
    chosen = choose(known, found, 60 * MINUTES)
    return design(known, LIBRARY, chosen, BASIN, 60 * MINUTES, name="plan")[0]


def errors(run, true):
    """Shares by which the fit misses inertia and damping over the mean gain, which no motion can show."""
    vessel = in_still_air(boat("aritra"))
    parameters = Parameters(vessel)
    found, truth, _ = scale_free(fit_structured([run], vessel), file_values(true), parameters)
    return np.abs(found / truth - 1)[: parameters.thrusters.start]


@pytest.mark.matrix
@pytest.mark.long
def test_five_minutes_of_a_plan_tell_more_than_five_minutes_of_surge(tmp_path):
    """Boats of seeds 1 to 3, within 30 % of the file, thrusters 2.5 % apart: these make even a straight run turn."""
    plan, surge = [], []
    for seed in (1, 2, 3):
        true = draw_boat(boat("aritra"), np.random.default_rng(seed))
        setup = setup_with(designed())
        flown = fly(setup, WorldSetup(true, BASIN, start=MIDDLE), seed, limit_s=60 * MINUTES + 60)
        log, _ = write_logs(flown, setup, tmp_path, BEGIN_UNIX_NS)
        plan.append(errors(read_run(log, ReadOptions(setup.pilot.vessel, BASIN)), true))
        surge.append(errors(teleop_run(true, seed, 60 * MINUTES, imu_hz=50.0, pilot=AHEAD_AND_ASTERN), true))
        print(f"seed {seed}: median error {np.median(plan[-1]):.2%} of the plan, {np.median(surge[-1]):.2%} of surge")
    print("pooled", np.median(plan), np.median(surge), "worst", np.max(plan), np.max(surge))
    assert np.median(plan) < np.median(surge) and np.max(plan) < np.max(surge)
