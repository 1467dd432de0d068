"""Outputs that somebody takes away and gives back: nothing turns until the operator starts again. Simulated autopilot.

On a real firmware: tests/sim/world/sitl/test_firmware_stops.py.
"""

import pytest

from companion.core.messages import Alert, ManualInput, OperatorCommand, OverrideLease
from sim.world.autopilot.parameter_table import BOAT_PARAMETERS
from tests.support.autopilots.ground_station import SAFETY_OFF, SAFETY_ON, SCRIPTS_RESTART, SCRIPTS_STOP, GroundStation
from tests.support.drive_fixture import driving, voyage

SEED = 7
LOST_S = 0.7
"""Neutral after so long, as after every other stop (docs/autopilot.md)."""


def turning(run):
    return any(abs(pulse - 1500) > 25 for pulse in run.world.rover.outputs_us[:4] if pulse)


class Scene:
    """A run in a mode, a ground station beside it, and when [s] a thruster last turned."""

    def __init__(self, mode, **world):
        self.run, self.sticks = voyage(SEED, **world), mode == "manual"
        self.station, self.turned_s = GroundStation(self.run.world), -1.0
        assert self.run.run(driving, 20.0), self.run.state.helm
        self.go(2.0)
        if mode != "auto":
            self.command(mode)
            self.go(1.0)
        assert self.mode == mode

    @property
    def mode(self):
        return self.run.state.helm.mode

    @property
    def now_s(self):
        return self.run.world.t_ns * 1e-9

    def command(self, name):
        self.run.feed([OperatorCommand(t_ns=self.run.world.t_ns, command=name)])

    def go(self, seconds):
        for step in range(round(seconds * 100)):
            self.run.step()
            if self.sticks and step % 5 == 0:
                surge = 0.5 if self.mode == "manual" else 0.0
                self.run.feed([ManualInput(t_ns=self.run.world.t_ns, surge=surge, sway=0.0, yaw=0.0, source="pad")])
            self.turned_s = self.now_s if turning(self.run) else self.turned_s


SWITCH = SAFETY_ON, SAFETY_OFF, "safety switch"
GATE_SCRIPT = SCRIPTS_STOP, SCRIPTS_RESTART, "scripts stopped"


@pytest.mark.parametrize(
    ("mode", "take", "give", "why"),
    [
        pytest.param("auto", *SWITCH, id="switch in auto"),
        pytest.param("auto", *GATE_SCRIPT, id="script in auto"),
        pytest.param("hold", *SWITCH, id="switch in hold", marks=pytest.mark.long),
        pytest.param("manual", *GATE_SCRIPT, id="script in manual", marks=pytest.mark.long),
    ],
)
def test_nothing_turns_when_the_outputs_are_back(mode, take, give, why):
    scene = Scene(mode)
    taken_s = scene.now_s
    scene.station.command(*take)
    scene.go(1.0)
    assert scene.mode == "safe" and why in scene.run.state.helm.why
    scene.station.command(*give)
    scene.go(4.0)
    assert scene.mode == "safe" and scene.turned_s - taken_s <= LOST_S
    scene.sticks = False
    scene.command("start")
    scene.go(3.0)
    assert scene.mode == "auto" and scene.turned_s > scene.now_s - 1.0, "the operator's new start drives"


def test_scripts_that_are_stopped_and_started_in_one_go_end_in_safe():
    scene = Scene("auto")
    scene.station.command(*SCRIPTS_RESTART)
    taken_s = scene.now_s
    scene.go(4.0)
    assert scene.mode == "safe" and scene.turned_s - taken_s <= LOST_S


def test_a_boat_in_neutral_notices_the_switch_and_a_start_does_not_wait_for_its_release():
    scene = Scene("auto")
    scene.command("stop")
    scene.go(1.0)
    scene.station.command(*SAFETY_ON)
    scene.go(0.7)
    assert scene.mode == "idle" and "safety switch" in scene.run.of(Alert)[-1].text
    stopped_s = scene.now_s
    scene.command("start")
    scene.go(0.5)
    assert scene.mode == "safe" and "safety switch" in scene.run.state.helm.why
    scene.station.command(*SAFETY_OFF)
    scene.go(4.0)
    assert scene.mode == "safe" and scene.turned_s < stopped_s


def test_a_ground_station_that_disarms_and_arms_between_two_heartbeats_stops_the_boat():
    scene = Scene("auto")
    scene.station.command(400, 0)
    taken_s = scene.now_s
    scene.go(0.2)
    scene.station.command(400, 1)
    scene.go(3.0)
    assert scene.mode == "safe" and "disarmed" in scene.run.state.helm.why and scene.turned_s - taken_s <= LOST_S


OMNI = {"FRAME_TYPE": 2.0, **{f"SERVO{n}_FUNCTION": 32.0 + n for n in range(1, 5)}}


@pytest.mark.parametrize(
    ("parameters", "within_s", "why"),
    [
        ({"SCR_ENABLE": 0.0}, 5.0, "gate.lua"),
        (OMNI, 1.5, "33 to 36"),
        ({"BRD_SAFETY_DEFLT": 1.0}, 0.0, "safety switch"),
    ],
    ids=["gate without its script", "omni", "safety switch on from the start"],
)
def test_where_nothing_can_move_a_start_ends_in_safe_with_the_reason(parameters, within_s, why):
    run = voyage(SEED, parameters={**BOAT_PARAMETERS, **parameters})
    assert run.run(lambda r: r.state.helm.mode == "safe", 15.0), run.state.helm
    assert why in run.state.helm.why
    driven = [lease for lease in run.of(OverrideLease) if lease.source != "neutral"]
    assert len(driven) <= within_s * 10 and not turning(run)
    run.run(lambda r: False, 3.0)
    assert run.state.helm.mode == "safe"
