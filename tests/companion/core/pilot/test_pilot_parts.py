"""What the pilot hands to its rooms, and what it keeps between modes: each thing that a mutant once changed unseen."""

from dataclasses import replace as with_settings
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from companion.boat.load_run import setup_of
from companion.core import messages as m
from companion.core.estimation.estimator import Estimator
from companion.core.excitation.file import Steps, excitation_toml
from companion.core.excitation.flight import Flight, FlightState
from companion.core.pilot import thrust_command, transitions
from companion.core.pilot.autopilot_state import AutopilotState
from companion.core.pilot.modes import THRUSTERS, ModeState
from companion.core.pilot.monitors.plan_gap import ControllerTime
from companion.core.pilot.pilot import Pilot
from tests.companion.core.pilot.pilot_shell import Shell, operator, plan
from tests.companion.core.pilot.test_pilot_modes import PLAN, Boat
from tests.support.drive_fixture import setup, under_way
from tests.support.excitation_fixture import of

S, MS = 1_000_000_000, 1_000_000


def pilot_of(**changed):
    return Pilot(with_settings(setup().pilot, **changed))


class Spy:
    """A room that notes what one of its functions was given, and does it."""

    def __init__(self, room, name):
        self._room, self._name, self.given = room, name, []

    def __getattr__(self, name):
        found = getattr(self._room, name)
        if name != self._name:
            return found

        def noted(*args, **kwargs):
            self.given.append((args, kwargs))
            return found(*args, **kwargs)

        return noted


# --- times and places -----------------------------------------------------------------------------------


@pytest.mark.long
def test_a_plan_begins_where_the_boat_will_be_when_it_acts():
    """Half a second on the way to the autopilot, three quarters of a second in the thruster: assumed, to tell apart."""
    told = setup().pilot
    vessel = replace(told.vessel, propulsion=replace(told.vessel.propulsion, dead_time_s=0.75))
    mind = pilot_of(vessel=vessel, control=replace(told.control, latency_s=0.5))
    state, t_ns = under_way()
    shell, filter_ = replaced(mind, state, t_ns), Estimator(vessel, told.site)
    shell.feed(m.Tick(t_ns=t_ns, index=1000))
    (request,) = [o for o in shell.outputs if isinstance(o, m.SolveRequest)]
    ahead, sooner = (filter_.belief(shell.state.estimator, t_ns + ms * MS) for ms in (1250, 1249))
    assert request.x0 == (*ahead.x[:6], *ahead.f_n) != (*sooner.x[:6], *sooner.f_n)
    before = shell.state.estimator
    shell.feed(plan(1000, t_ns))
    want = filter_.command(before, t_ns + 500 * MS, (1.0,) * 4).commands
    assert timeline(shell.state.estimator.commands) == timeline(want), "and the filter hears when it acts"
    assert want[-1].acts_ns == t_ns + 1250 * MS


def timeline(commands):
    return [(command.acts_ns, *command.f_n) for command in commands]


def replaced(mind, state, t_ns):
    """A shell around another mind."""
    shell = Shell(state, t_ns, index=1000)

    def feed(*inputs):
        shell.state, outputs = mind.step(shell.state, inputs, shell.t_ns)
        shell.outputs += outputs
        return outputs

    shell.feed = feed
    return shell


@pytest.mark.long
def test_the_reference_begins_at_the_state_that_the_plan_begins_at(monkeypatch):
    monkeypatch.setattr(thrust_command, "guidance", spy := Spy(thrust_command.guidance, "horizon"))
    boat = Boat("auto")
    boat.tick()
    request = [o for o in boat.outputs if isinstance(o, m.SolveRequest)][-1]
    (_, _, eta, nu, times_s), _ = spy.given[-1]
    assert (*eta, *nu) == pytest.approx(request.x0[:6]) and (len(eta), len(nu)) == (3, 3)
    assert times_s[0] == 0.0 and len(times_s) == len(request.reference)
    assert boat.state.row == request.reference[0], "the fallback law steers by its first row"


def test_a_heading_is_turned_into_the_axes_of_the_site():
    told = setup().pilot
    mind = pilot_of(site=replace(told.site, rotation_deg=30.0))
    attitude = m.Attitude(t_ns=S, t_rx_ns=S, phi_rad=0.0, theta_rad=0.0, psi_rad=1.0, p_rad_s=0.0, q_rad_s=0.0,
                          r_rad_s=0.0)  # fmt: skip
    state, _ = mind.step(mind.initial(0), [attitude], S)
    assert state.estimator.start.heading.psi_rad == pytest.approx(1.0 - np.deg2rad(30.0))


def test_at_switch_on_no_force_is_remembered():
    assert pilot_of().initial(0).f_command_n == (0.0,) * 4


# --- plans ----------------------------------------------------------------------------------------------


def test_the_newest_question_s_plan_counts_whenever_it_comes():
    boat = Boat("auto")
    boat.tick()
    first = boat.index
    assert boat.state.plan is not None, "the first plan of all is taken"
    boat.tick()
    newest = boat.state.plan
    boat.feed(plan(first, boat.t_ns))
    assert boat.state.plan is newest, "an older one that comes late is not"
    again = plan(boat.index, boat.t_ns)
    boat.feed(again)
    assert boat.state.plan is again, "of the same question the last word counts"


@pytest.mark.parametrize("rows", [((5.0,) * 4, (5.0,) * 3), ((5.0,) * 3, (5.0,) * 4), ((5.0,) * 5,) * 2])
def test_one_row_of_another_length_spoils_a_plan(rows):
    boat = Boat("auto")
    boat.tick()
    before = boat.state.plan
    boat.t_ns += 100 * MS
    boat.feed(replace(boat.state.monitor(AutopilotState).heartbeat, t_ns=boat.t_ns), m.Tick(t_ns=boat.t_ns, index=7000))
    boat.feed(plan(7000, boat.t_ns, f_n=rows))
    assert boat.state.plan is before and boat.leases[-1].source == "shifted_plan"


def test_twenty_questions_are_remembered():
    boat = Boat("auto")
    for _ in range(25):
        boat.tick()
    assert [index for index, _ in boat.state.asked] == list(range(boat.index - 19, boat.index + 1))


# --- missions -------------------------------------------------------------------------------------------


def mission(north_m):
    points = tuple(m.MissionPoint(north_m=north_m, east_m=e) for e in (9.0, 12.0))
    return m.NewMission(t_ns=0, name="other", waypoints=points)


@pytest.mark.parametrize(("mode", "wanted", "taken"), [
    ("auto", "auto", False), ("starting", "auto", False), ("starting", "hold", True), ("idle", "auto", True),
    ("hold", "auto", True), ("safe", "auto", True),
])  # fmt: skip
def test_a_mission_is_taken_unless_one_is_driven(mode, wanted, taken):
    boat = Boat(mode)
    boat.state = replace(boat.state, helm=ModeState(mode, wanted, "because"), passed=("something",))
    boat.feed(mission(10.0))
    alert = [o for o in boat.outputs if isinstance(o, m.Alert)][-1]
    assert (boat.state.mission is not None) == taken == ("loaded: start begins it" in alert.text)
    assert boat.state.passed == (() if taken else ("something",))


def test_a_mission_goes_on_where_it_was_left_and_begins_anew_once_all_is_passed(monkeypatch):
    monkeypatch.setattr(thrust_command, "guidance", spy := Spy(thrust_command.guidance, "start"))
    for passed, expected in ((1, 1), (2, 2), (3, 0)):
        boat = Boat("auto")
        assert len(boat.mind.settings.mission.path.waypoints) == 3
        boat.state = replace(boat.state, passed=passages(passed))
        boat.tick()
        assert len(spy.given[-1][1]["passed"]) == expected


def passages(count):
    """Passages as guidance made them, one more for each leg."""
    one = SimpleNamespace(waypoint=0, t_ns=0, distance_m=0.1)
    return tuple(one for _ in range(count))


@pytest.mark.parametrize(("mode", "kept"), [("auto", False), ("hold", True)])
def test_only_the_mission_passes_waypoints(mode, kept, monkeypatch):
    boat = Boat(mode)
    boat.tick()
    boat.state = replace(boat.state, passed=passages(1))
    boat.tick()
    assert (boat.state.passed == passages(1)) == kept, "station keeping leaves them as they are"
    if mode == "auto":
        assert boat.state.passed == boat.state.guidance.passed


# --- excitation -----------------------------------------------------------------------------------------


def test_an_excitation_keeps_two_sigmas_of_its_position_from_the_fence(monkeypatch):
    texts = {**setup().files, "excitation.toml": excitation_toml(PLAN)}
    mind = Pilot(setup_of(texts, {name: name for name in texts}).pilot)
    boat = Boat("excitation")
    boat.mind, given, step = mind, [], Flight.step
    monkeypatch.setattr(Flight, "step", lambda *args, **words: given.append(words) or step(*args, **words))
    boat.tick()
    at = [o for o in boat.outputs if isinstance(o, m.StateEstimate)][-1].covariance
    assert given[-1]["spread_m"] == pytest.approx(2.0 * np.sqrt(at[0] + at[7])) and at[0] > 0.0 < at[7]


@pytest.mark.parametrize(("phase", "level"), [("failed", "warning"), ("done", "info")])
def test_the_end_of_an_excitation_is_told_and_nothing_is_in_between(phase, level, monkeypatch):
    texts = {
        **setup().files,
        "excitation.toml": excitation_toml(of(Steps(name="ahead", X=0.15, levels=(1.0,), hold_s=9.0))),
    }
    mind = Pilot(setup_of(texts, {name: name for name in texts}).pilot)
    boat = Boat("excitation")
    boat.mind = mind
    boat.tick()
    assert "" not in [o.text for o in boat.outputs if isinstance(o, m.Alert)], "one that goes on says nothing"
    over = FlightState(phase=phase, t_ns=boat.t_ns)
    monkeypatch.setattr(Flight, "step", lambda *args, **words: (over, (0.0,) * 4, "this is the end"))
    boat.tick()
    told = [(o.level, o.text) for o in boat.outputs if isinstance(o, m.Alert)]
    assert (level, "this is the end") in told and boat.mode == "idle" and not boat.moves


# --- from mode to mode ----------------------------------------------------------------------------------

MODES_OF_A_CONTROLLER = [mode for mode, turns in THRUSTERS.items() if turns == "controller"]


@pytest.mark.parametrize("after", THRUSTERS)
@pytest.mark.parametrize("before", THRUSTERS)
def test_a_plan_is_kept_between_two_modes_of_the_controller_only(before, after):
    state, t_ns = under_way()
    kept = plan(1, t_ns)
    state = replace(state, helm=ModeState(before), plan=kept, asked=((1, t_ns),))
    state = state.with_monitors(ControllerTime(since_ns=5))
    then = transitions.apply_mode_state(state, ModeState(after), t_ns + S)
    if before == after or {before, after} <= set(MODES_OF_A_CONTROLLER):
        assert then.plan is kept and then.asked and then.monitor(ControllerTime).since_ns == 5
    else:
        since_ns = t_ns + S if after in MODES_OF_A_CONTROLLER else None
        assert then.plan is None and not then.asked and then.monitor(ControllerTime).since_ns == since_ns
    assert (then.guidance.phase == "idle") == (before != after)


def test_the_controller_s_time_without_a_plan_counts_from_its_own_beginning():
    """By hand for a minute, then hold: the solver gets its five seconds, and no second less."""
    boat = Boat("manual", held=0.0)
    for _ in range(60):
        boat.tick()
    boat.feed(operator("hold", boat.t_ns))
    for _ in range(40):
        boat.t_ns += 100 * MS
        boat.index += 1
        boat.feed(
            replace(boat.state.monitor(AutopilotState).heartbeat, t_ns=boat.t_ns),
            m.Tick(t_ns=boat.t_ns, index=boat.index),
        )
        boat.feed(m.PlanDeadline(t_ns=boat.t_ns, index=boat.index))
    assert not [o for o in boat.outputs if isinstance(o, m.Alert) and "no usable plan" in o.text]
