"""A boat with GNSS and no UWB on the stepped clock: it drives, and says when its fix is lost or frozen. Seed 7."""

import pytest
from msgspec.structs import replace

from companion.core.messages import OperatorCommand, StateEstimate
from tests.closed_loop.lake_fixture import LIMIT_S, alarms, arrived, lake_figures, lake_voyage
from tests.support.drive_fixture import driving, healthy

NORTH_10_M = 9e-5
"""Degrees of latitude."""


def mode(run) -> str:
    return run.state.helm.mode


def under_way(**world):
    run = lake_voyage(7, **world)
    assert run.run(lambda r: driving(r) and r.state.guidance.s_m > 3.0 and healthy(r), 40.0)
    return run


def frozen(run):
    """The receiver says the same from now on, with new stamps."""
    kept = []

    def same(m):
        kept.append(m)
        return replace(kept[0], t_ns=m.t_ns, t_rx_ns=m.t_rx_ns)

    run.world.tamper["gnss"] = same


@pytest.mark.long
def test_a_fix_lost_for_20_s_degrades_then_stops_until_the_operator_starts_again():
    run = under_way()
    run.world.tamper["gnss"] = lambda m: replace(m, fix_type=1)
    assert run.run(lambda r: r.of(StateEstimate)[-1].health == "degraded", 5.0) and mode(run) == "auto"
    assert "no GNSS position accepted for" in run.of(StateEstimate)[-1].reason
    assert run.run(lambda r: mode(r) == "safe", 15.5)  # control.blind_s = 15
    run.run(lambda r: False, 2.0)
    run.world.tamper.clear()
    run.run(lambda r: False, 10.0)
    assert healthy(run) and mode(run) == "safe", "it does not drive on by itself"
    run.feed([OperatorCommand(t_ns=run.world.t_ns, command="start")])
    assert run.run(driving, 10.0)


@pytest.mark.long
def test_a_frozen_receiver_is_left_out_and_named():
    run = under_way()
    frozen(run)
    assert run.run(lambda r: any("GNSS: the same reading for" in text for text in alarms(r)), 5.0)
    assert run.run(lambda r: not healthy(r), 4.0)


@pytest.mark.long
def test_one_wild_fix_moves_nothing_and_a_lasting_jump_is_believed():
    run = under_way()
    run.world.tamper["gnss"] = lambda m: replace(m, lat_deg=m.lat_deg + NORTH_10_M)
    run.run(lambda r: False, 0.5)
    here = run.of(StateEstimate)[-1]
    assert abs(here.north_m - run.world.truth().north_m) < 0.2
    assert run.run(lambda r: r.of(StateEstimate)[-1].north_m - r.world.truth().north_m > 8.0, 6.0)


@pytest.mark.long
@pytest.mark.parametrize(
    ("plain", "cross_m"),
    [pytest.param(False, 0.06, id="rtk", marks=pytest.mark.matrix), pytest.param(True, 3.0, id="plain")],
)
def test_the_mission_on_the_lake(plain, cross_m):
    run = lake_voyage(7, plain=plain)
    assert run.run(arrived, LIMIT_S)
    got = lake_figures(run)
    assert len(run.state.guidance.passed) == 5 and alarms(run) == []
    assert got["cross_track_rms_m"] < cross_m and got["nees_velocity"] < 6.0
