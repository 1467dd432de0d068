"""What is found of a dead thruster, and what a new order and a second finding leave of it. Seeds 5 and 6."""

from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from companion.core.messages import OperatorCommand
from companion.core.model.manoeuvring import mass_matrix
from companion.core.model.thrusters import configuration_matrix
from companion.core.pilot.monitors.monitor import TickView
from companion.core.pilot.trust.thrusters.hypothesis_bank import ThrusterBank, ThrustHypothesis
from companion.core.pilot.trust.thrusters.remaining_thrust import ThrusterHealth
from companion.core.pilot.trust.thrusters.thruster_verdict import ThrusterState, ThrusterVerdicts
from tests.companion.core.pilot.trust.thrusters.driven_bank import (
    BANK,
    MONITOR,
    REMAINING,
    VERDICTS,
    VESSEL,
    B,
    believing,
    driven,
)
from tests.support.drive_fixture import driving, healthy, voyage
from tests.support.vessel_fixtures import boat

AHEAD = np.full(4, 7.0)
S = 1_000_000_000


def ordered(state, command):
    return MONITOR.on_message(state, OperatorCommand(t_ns=0, command=command), 0)[0]


def comes(state, first_n):
    """The body force that comes where `AHEAD` is asked for."""
    told = REMAINING.redistribute(AHEAD, state.health)
    return B @ np.array([first_n, *told[1:]])


def crippled():
    state = driven(MONITOR.initial, 20.0, 20)
    assert "stuck" in state.hopeless and state.health.stuck_n[0] > 15.0
    return state


def test_a_boat_whose_stuck_thruster_was_switched_off_as_told_does_not_hold_against_it_any_more():
    state = driven(ordered(crippled(), "start"), 0.0, 30)
    assert not state.hopeless and not state.suspected
    assert comes(state, 0.0) == pytest.approx(B @ AHEAD, abs=0.5)


def test_a_thruster_that_is_still_stuck_stops_the_boat_again_after_a_new_start():
    assert "stuck" in driven(ordered(crippled(), "start"), 20.0, 20).hopeless


def test_a_boat_that_is_fetched_by_hand_holds_against_it_and_a_stop_changes_nothing():
    assert comes(ordered(ordered(crippled(), "stop"), "manual"), 20.0) == pytest.approx(B @ AHEAD, abs=2.0)


def test_a_new_order_says_what_is_still_taken_for_granted():
    health = ThrusterHealth((0.0, 1.0, -1.0, 0.4), (None, 0.0, None, None), (0, 3, 2, 1))
    state = replace(MONITOR.initial, health=health)
    _, report = MONITOR.on_message(state, OperatorCommand(t_ns=0, command="start"), 0)
    (alert,) = report.alerts
    assert alert.level == "warning" and alert.text == (
        "as found before: thruster front_port pushes hardly or not at all; thruster rear_port pushes the wrong way: its"
        " pulses are turned round; thruster rear_starboard gives 40 % of its force; thruster front_starboard counts as"
        " switched off; thrusters front_starboard and rear_starboard get each other's pulses. Once repaired, restart"
        " the boat's program"
    )
    for before, command in ((state, "stop"), (MONITOR.initial, "start")):
        assert not MONITOR.on_message(before, OperatorCommand(t_ns=0, command=command), 0)[1].alerts


def test_a_thruster_that_was_stuck_and_is_free_of_it_is_named_and_no_longer_held_against():
    state = driven(believing(10.0), 0.0, 120, seed=6)
    assert state.health.stuck_n[0] == pytest.approx(0.0, abs=3.0) and not state.suspected


@pytest.mark.parametrize("seed", [5, 6])
def test_a_dead_thruster_is_called_dead_and_not_one_of_two_that_say_the_same(seed):
    """Nothing of what is asked for, or stuck at nothing: both explain it alike, for ever, and nobody took over."""
    state = driven(MONITOR.initial, 0.0, 40, seed)
    assert state.health.gains == (0.0, 1.0, 1.0, 1.0) and not state.suspected


@pytest.mark.parametrize(("known", "now", "share"), [(0.4, 1.0, 1.0), (0.3, 0.6, 0.6), (-0.4, -1.0, -1.0)])
def test_a_weak_thruster_that_comes_to_its_force_again_is_not_driven_harder_any_more(known, now, share):
    """Weed that goes: it got a pulse for 2.5 times the force, and gave that, for the rest of the run."""
    weak = replace(MONITOR.initial, health=ThrusterHealth((known, 1.0, 1.0, 1.0), (None,) * 4, (0, 1, 2, 3)))
    state = weak
    for _ in range(10):
        state = driven(state, lambda told_n, state=state: told_n * now / state.health.gains[0], 20)
        if state.health != weak.health:
            break
    assert state.health.gains[0] == pytest.approx(share, abs=0.15)


def found(state, kind, i=-1, j=-1):
    k = next(n for n, h in enumerate(BANK.hypotheses) if (h.kind, h.i, h.j) == (kind, i, j))
    return VERDICTS.found(state, k, TickView(0, 0, None, 0, True, driving=True))[0]


def test_an_accelerometer_that_is_still_wrong_after_a_new_start_is_left_out_again():
    state = found(MONITOR.initial, "accel")
    assert state.accel_off
    state = ordered(state, "start")
    assert not state.accel_off and found(state, "accel").accel_off


def test_three_thrusters_that_changed_places_are_told_apart_by_two_findings():
    """Channel c drives thruster hangs[c]. What the first finding leaves is that 0 and 2 have changed places."""
    hangs = (1, 2, 0, 3)
    health = found(found(MONITOR.initial, "swap", 0, 1), "swap", 0, 2).health
    f = np.array([2.0, 4.0, 6.0, 8.0])
    pulses, sound = REMAINING.pulses(f, health, 15.0), REMAINING.pulses(f, MONITOR.initial.health, 15.0)
    assert [pulses[hangs.index(i)] for i in range(4)] == list(sound)


def judged(verdicts=VERDICTS, bank=BANK, **found):
    """What is found where hypotheses KIND_I stand at (nats, last of the mean, its sigma)."""
    state = replace(bank.initial(), count=100)
    for name, (nats, mean, sigma) in found.items():
        kind, _, i = name.partition("_")
        k, at = bank.hypotheses.index(ThrustHypothesis(kind, int(i or -1))), 3 + int(i) if kind == "gain" else -1
        state.nats[k], state.mean[k, at], state.P[k, at, at] = nats, mean, sigma**2
    health = ThrusterHealth.sound(bank.B.shape[1])
    return verdicts.judge(replace(MONITOR.initial, bank=state, health=health), TickView(0, 0, None, 0, True))[0]


@pytest.mark.parametrize(
    ("found", "named"),
    [
        ({"stuck_1": (20.0, 30.0, 1.0), "pushed": (14.0, 0.0, 1.0)}, True),
        ({"stuck_1": (20.0, 30.0, 1.0), "pushed": (16.0, 0.0, 1.0)}, False),
        ({"stuck_1": (20.0, 8.0, 1.0), "pushed": (9.0, 0.0, 1.0)}, True),
        ({"stuck_1": (20.0, 8.0, 1.0), "pushed": (11.0, 0.0, 1.0)}, False),
        ({"stuck_1": (18.0, 30.0, 1.0), "pushed": (20.0, 0.0, 1.0)}, False),
        ({"gain_1": (27.0, -2.0, 0.1), "pushed": (16.0, 0.0, 1.0)}, True),
        ({"gain_1": (25.0, -2.0, 0.1), "pushed": (16.0, 0.0, 1.0)}, False),
        ({"gain_1": (16.0, -2.0, 0.1)}, True),
    ],
)
def test_a_thruster_is_named_where_a_push_explains_it_less_well(found, named):
    state = judged(**found)
    assert [f.what for f in state.findings] == [VESSEL.thrusters[1].name] * named
    assert state.probing != named and bool(state.suspected) != named


@pytest.mark.parametrize(("peak", "named"), [(18.0, True), (21.0, False)])
def test_a_thruster_for_which_less_and_less_speaks_is_not_named(peak, named):
    seen = replace(BANK.initial(), peak=np.full(len(BANK.hypotheses), peak))
    bank = SimpleNamespace(initial=lambda: seen, hypotheses=BANK.hypotheses, B=BANK.B)
    assert bool(judged(bank=bank, gain_1=(17.0, -2.0, 0.1)).findings) == named


def test_a_thruster_that_gives_nothing_or_may_be_stuck_at_a_little_is_dead():
    dead = judged(gain_0=(17.0, -0.95, 0.1), stuck_0=(15.0, 5.0, 2.0))
    assert dead.health.gains[0] == 0.0 and dead.health.stuck_n[0] is None
    undecided = judged(gain_0=(17.0, -0.95, 0.1), stuck_0=(15.0, 12.0, 6.0))
    assert undecided.suspected and not undecided.findings
    stuck = judged(gain_0=(14.0, -0.95, 0.1), stuck_0=(16.0, 5.0, 2.0))  # not what nobody is sure of
    assert stuck.health.stuck_n[0] == 5.0


def test_a_thruster_that_gives_a_quarter_is_not_asked_for_four_times_as_much_where_it_can_be_spared():
    state = judged(gain_2=(17.0, -0.75, 0.1))
    assert state.health.gains[2] == 0.0 and REMAINING.redistribute(AHEAD, state.health)[2] == 0.0


def test_of_two_thrusters_none_can_be_spared():
    twin = boat("twin")
    bank = ThrusterBank(configuration_matrix(twin), mass_matrix(twin))
    verdicts = ThrusterVerdicts(twin, bank)
    weak, dead = (judged(verdicts, bank, gain_0=(17.0, share - 1.0, 0.1)) for share in (0.25, 0.1))
    assert weak.health.gains == (pytest.approx(0.25), 1.0) and dead.health.gains == (0.0, 1.0)
    assert [s.findings[0].text.partition("; ")[2] for s in (weak, dead)] == ["the others take over what they can"] * 2


def shown(kind, nats, force_n=0.0, state=MONITOR.initial, t_s=10.0, displaced=False, settled=True, **seen):
    """State and finding where so much speaks for a hypothesis, on thruster 0 if on any, stuck at this force."""
    k = next(k for k, h in enumerate(BANK.hypotheses) if h.kind == kind)
    bank = replace(BANK.initial(), count=100)
    bank.nats[k], bank.mean[k, -1] = nats, force_n
    belief = SimpleNamespace(was_displaced=lambda t_ns, within_s: displaced, settled=settled)
    view = TickView(round(t_s * S), 0, None, 0, True, belief=belief, driving=True, **seen)
    state, report = VERDICTS.judge(replace(state, bank=bank), view)
    return state, [f.what for f in state.findings], [a.text for a in report.alerts]


def test_no_thruster_is_blamed_while_sensors_contradict_each_other_nor_right_after():
    state, found, (alert,) = shown("gain", 30.0, suspect=True)
    assert not found and alert.endswith("gives another force or sensors contradict each other")
    assert not shown("gain", 30.0, state=state, t_s=11.9)[1]
    assert shown("gain", 30.0, state=state, t_s=12.1)[1] == ["front_port"]


@pytest.mark.parametrize(
    ("kind", "force_n", "found"), [("gain", 0.0, []), ("stuck", 3.0, []), ("stuck", 30.0, ["front_port"])]
)
def test_after_positions_have_moved_the_boat_only_a_thruster_that_nobody_holds_against_is_named(kind, force_n, found):
    assert shown(kind, 30.0, force_n, displaced=True)[1] == found


@pytest.mark.parametrize(("kind", "what"), [("accel", "accel"), ("pushed", "pushed")])
def test_what_the_error_of_a_speed_may_be_is_not_named_before_the_filter_knows_its_speed(kind, what):
    assert not shown(kind, 60.0, settled=False)[1]
    assert shown(kind, 60.0)[1] == [what]
    assert shown("gain", 30.0, settled=False)[1] == ["front_port"]


def test_what_was_just_found_is_over_after_a_second_and_where_the_clock_went_back():
    state = replace(MONITOR.initial, quiet_until_ns=11 * S)
    assert [state.has_changed(round(t_s * S)) for t_s in (5.0, 10.5, 11.0)] == [False, True, False]


def test_what_spoke_for_a_push_until_the_filter_knew_its_speed_speaks_no_more():
    run = voyage(3)
    run.run(lambda run: driving(run) and run.world.t_ns > 6 * S, 10.0)
    at_work = run.state.monitor(ThrusterState)
    nats = np.where([h.kind in ("pushed", "accel") for h in BANK.hypotheses], 60.0, 0.0)
    run.state = run.state.with_monitors(replace(at_work, bank=replace(at_work.bank, nats=nats, count=100)))
    assert not run.run(healthy, 1.0)
    assert run.state.monitor(ThrusterState).bank.nats.max() > 40.0
    assert run.run(healthy, 20.0)
    run.run(lambda _run: False, 0.3)
    after = run.state.monitor(ThrusterState)
    assert after.bank.nats.max() < 5.0 and not after.findings
