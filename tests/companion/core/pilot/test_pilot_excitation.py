"""The pilot flies an excitation: one lease a tick, and neutral as soon as anything is not as it should be."""

from functools import cache

import numpy as np
import pytest

from companion.boat.load_run import setup_of
from companion.core.excitation.file import Idle, Steps, excitation_toml
from companion.core.messages import (
    Alert,
    ExcitationStatus,
    GroundTruth,
    OperatorCommand,
    OverrideLease,
    SolveRequest,
    Tick,
)
from companion.core.pilot.pilot import Pilot
from sim.world.stepped import PEER, SteppedRun
from sim.world.stepped_controller import no_plan
from sim.world.world import World, WorldSetup
from tests.support.drive_fixture import mission_text, nmpc, setup
from tests.support.excitation_fixture import of

PLAN = of(
    Steps(name="ahead", X=0.15, levels=(1.0, -1.0), hold_s=4.0),
    Steps(name="spin", N=0.1, levels=(1.0, -1.0), hold_s=3.0),
    Idle(name="rest", duration_s=2.0),
)


@cache
def pilot() -> Pilot:
    told = setup(None)
    texts = {**told.files, "excitation.toml": excitation_toml(PLAN)}
    return Pilot(setup_of(texts, {name: name for name in texts}).pilot)


def begun(seed=1, begin="excite", **world) -> SteppedRun:
    site, vessel = pilot().settings.site, pilot().settings.vessel
    chosen = WorldSetup(vessel, site, **{"start": (15.0, 15.0, 0.3), **world})
    return SteppedRun(World(chosen, seed), pilot(), nmpc().solve, begin=begin)


def under_way(seed=1, **world) -> SteppedRun:
    run = begun(seed, **world)
    assert run.run(lambda r: (r.state.flight.phase, r.state.flight.segment) == ("fly", 0), 20.0)
    run.run(lambda r: False, 1.0)
    assert run.of(OverrideLease)[-1].source == "excitation"
    return run


def command(run, word) -> None:
    run.feed([OperatorCommand(t_ns=run.world.t_ns, command=word)])


def sources(run, since_ns) -> set[str]:
    return {lease.source for lease in run.of(OverrideLease) if lease.t_ns > since_ns}


def in_neutral(run, since_ns) -> bool:
    leases = [lease for lease in run.of(OverrideLease) if lease.t_ns > since_ns]
    return bool(leases) and all(lease.source == "neutral" and set(lease.pwm_us) == {1500} for lease in leases)


@pytest.fixture(scope="module")
def flight() -> SteppedRun:
    run = begun()
    assert run.run(
        lambda r: r.state.helm.mode == "idle" and r.state.flight.t_ns is None and r.of(ExcitationStatus), 60.0
    )
    run.run(lambda r: False, 1.0)
    return run


def test_every_tick_has_one_lease_and_no_plan_is_asked_for(flight):
    leases = flight.of(OverrideLease)
    assert [lease.index for lease in leases] == [tick.index for tick in flight.of(Tick)]
    assert {lease.source for lease in leases} == {"neutral", "excitation"} and not flight.of(SolveRequest)
    assert all(1100 <= pwm <= 1900 for lease in leases for pwm in lease.pwm_us)


def test_it_ends_stopped_and_neutral_and_says_what_it_flew(flight):
    assert flight.state.helm.why == "excitation done"
    last = flight.of(ExcitationStatus)[-1]
    assert last.phase == "done" and in_neutral(flight, last.t_ns - 1)
    names = [s.name for s in flight.of(ExcitationStatus) if s.phase == "fly"]
    assert list(dict.fromkeys(names)) == ["ahead", "spin", "rest"]
    told = [m.text for m in flight.of(Alert)]
    assert any("segment 2 of 3, spin, begins" in text for text in told) and "excitation done" in told
    assert np.abs([m.r_rad_s for m in flight.messages if hasattr(m, "f_n") and hasattr(m, "r_rad_s")]).max() > 0.2


def test_the_operators_stop_ends_it_in_neutral_and_excite_goes_on_where_it_was():
    run = under_way()
    command(run, "stop")
    since = run.world.t_ns
    run.run(lambda r: False, 1.0)
    assert in_neutral(run, since)
    left = run.state.flight.elapsed_s
    command(run, "excite")
    assert run.run(lambda r: r.of(ExcitationStatus)[-1].t_ns > since, 10.0)
    assert run.run(lambda r: r.state.flight.phase == "fly", 20.0)
    assert run.state.flight.segment == 0 and run.state.flight.elapsed_s == pytest.approx(left, abs=0.15)


def test_hold_keeps_station_with_the_controller_and_start_drives_the_mission():
    run = under_way()
    command(run, "hold")
    since = run.world.t_ns
    run.run(lambda r: False, 2.0)
    assert "plan" in sources(run, since) and "excitation" not in sources(run, since)
    assert run.state.guidance.phase == "station"
    command(run, "start")
    run.run(lambda r: False, 1.0)
    assert run.state.guidance.phase == "leg"


def test_a_lost_autopilot_ends_it_in_neutral():
    run = under_way()
    run.world.rover.remove_link(PEER)
    run.world.rover.receive = lambda data, peer, t_ns: b""
    assert run.run(lambda r: r.state.helm.mode == "safe", 10.0)
    since = run.world.t_ns
    run.run(lambda r: False, 0.5)
    assert in_neutral(run, since)


@pytest.mark.long
def test_without_the_tag_it_waits_in_neutral_then_stops():
    run = under_way(2)
    run.world.silent_uwb = True
    assert run.run(lambda r: r.state.estimate.health == "degraded", 15.0)
    since = run.world.t_ns + 100_000_000
    run.run(lambda r: False, 2.0)
    assert in_neutral(run, since) and run.state.helm.mode == "paused"
    run.world.silent_uwb = False
    assert run.run(lambda r: r.of(OverrideLease)[-1].source == "excitation", 20.0), "it goes on with the tag back"
    run.world.silent_uwb = True
    assert run.run(lambda r: r.state.helm.mode == "safe", 60.0)
    assert "degraded for more than" in run.state.helm.why


def test_it_keeps_out_of_what_the_mission_fences_off():
    """A zone where the site's own middle is, between the boat and the only water that is wide enough."""
    zone = "[[fences]]\ninclusion = false\npolygon = [[10, 10], [20, 10], [20, 20], [10, 20]]\n"
    texts = {
        **setup(None).files,
        "mission.toml": mission_text(((4.0, 4.0), (4.0, 26.0))) + zone,
        "excitation.toml": excitation_toml(PLAN),
    }
    fenced = Pilot(setup_of(texts, {name: name for name in texts}).pilot)
    world = World(WorldSetup(fenced.settings.vessel, fenced.settings.site, start=(4.0, 4.0, 0.0)), 1)
    run = SteppedRun(world, fenced, no_plan, begin="excite")
    assert run.run(lambda r: (r.state.flight.phase, r.state.flight.segment) == ("fly", 1), 60.0)
    track = np.array([(m.north_m, m.east_m) for m in run.of(GroundTruth)])
    assert fenced.settings.fence.clearances(track).min() > 1.0


def test_excite_without_an_excitation_is_told_and_changes_nothing():
    plain = Pilot(setup(None).pilot)
    state = plain.initial(0)
    after, outputs = plain.step(state, [OperatorCommand(t_ns=0, command="excite")], 0)
    assert after == state and [type(m) for m in outputs] == [Alert] and "no excitation" in outputs[0].text
