"""A boat that makes no way says so, once, and goes on."""

import pytest
from msgspec.structs import replace

from companion.boat.load_run import setup_of
from companion.core.control.nmpc import Actuation, Nmpc
from companion.core.messages import Alert
from companion.core.model.manoeuvring import StructuredModel
from companion.core.pilot.monitors.monitor import LegAhead
from companion.core.pilot.pilot import Pilot
from companion.core.pilot.trust.progress_check import PATIENCE_NS, ProgressMonitor
from companion.jit import compile_loops
from sim.world.stepped import SteppedRun
from sim.world.world import World, WorldSetup
from tests.companion.core.pilot.monitors.monitor_fixture import view
from tests.support.drive_fixture import START, mission_text, setup

S = 1_000_000_000


def alerts_of(leg, seconds=120):
    """(time [s], level) of the alerts; `leg`: time [s] -> waypoint, along, ahead, or None."""
    monitor, alerts = ProgressMonitor(), []
    state = monitor.initial
    for k in range(10 * seconds):
        state, report = monitor.on_tick(state, replace(view(k * S // 10), leg=leg(k / 10) and LegAhead(*leg(k / 10))))
        alerts += [(alert.t_ns / S, alert.level) for alert in report.alerts]
        assert not report.events
    return alerts


def test_way_is_a_leg_a_stretch_of_the_course_or_coming_nearer():
    assert alerts_of(lambda t: (1, 0.03 * t, 9.0)) == alerts_of(lambda t: (1, 0.0, 9.0 - 0.03 * t)) == []
    assert alerts_of(lambda t: (1 + t // 30, 0.0, 9.0)) == []


def test_standing_is_told_once_and_so_is_way_that_is_made_again():
    patience_s = PATIENCE_NS / S
    assert alerts_of(lambda t: (1, 0.0, 9.0 + 0.2 * (t % 2))) == [(patience_s, "warning")]
    assert alerts_of(lambda t: (1, 0.0, 9.0 - max(0.0, t - 60.0))) == [(patience_s, "warning"), (60.5, "info")]


def test_between_missions_there_is_no_way_to_make():
    assert alerts_of(lambda t: None if t % 30 > 20 else (1, 0.0, 9.0)) == []


@pytest.mark.long
def test_a_boat_before_a_pier_says_that_it_makes_no_way():
    """The course leads through it, the fence keeps the boat out; 60 s, seed 1."""
    pier = "[[fences]]\ninclusion = false\npolygon = [[11.0, 5.0], [13.0, 5.0], [13.0, 13.0], [11.0, 13.0]]\n"
    texts = {**setup(None).files, "mission.toml": mission_text(((9.0, 9.0), (16.0, 9.0))) + pier}
    known = setup_of(texts, {name: name for name in texts}).pilot
    model, actuation = StructuredModel.of(known.vessel), Actuation.of(known.vessel)
    nmpc = Nmpc(model, actuation, known.nmpc, lambda: 0.0, known.fence, compile_loops)
    run = SteppedRun(World(WorldSetup(known.vessel, known.site, start=START), 1), Pilot(known), nmpc.solve)
    run.run(lambda _: False, 60.0)
    (text,) = [a.text for a in run.of(Alert) if a.level == "warning" and "no way" in a.text]
    assert "waypoint 2" in text and run.state.helm.mode == "auto"
