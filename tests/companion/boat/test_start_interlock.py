"""`aritra run` does not let the boat loose on an autopilot whose wiring is not known to stop it."""

import pytest

from companion.boat.start_interlock import SWITCH_ON_S, WAITS_S, StartInterlock
from companion.core.messages import Alert, OperatorCommand, ParamValue
from companion.core.pilot.monitors.override_monitor import OverrideState
from companion.core.pilot.monitors.sent_pulses import outputs_of
from drivers.mavlink.codec import MavlinkCodec
from drivers.mavlink.framing import Framer
from tests.companion.boat.guarded_fixture import PLAIN, Guarded, silently_written, strange, told, written
from tests.companion.core.preflight.observations_fixture import BEAT, COMPANION
from tests.companion.core.preflight.observations_fixture import told as parameters_of

REFUSED = "refused: the boat might not stop"


@pytest.fixture
def path(tmp_path):
    return tmp_path / "run.mcap"


@pytest.mark.parametrize("firmware", ["4.6", "4.7"])
def test_a_start_waits_for_the_check_and_then_drives(firmware, path):
    bench = Guarded(path, firmware=firmware)

    async def story(bench):
        bench.order("start")
        assert bench.mode == "idle"
        assert await bench.run(20.0, until=lambda: bench.mode == "auto"), bench.alerts()
        assert bench.guard.clear

    assert bench.scene(story) is None
    assert told(bench, "start waits for the check") == 1
    questions = [m for _, m in bench.sent if m.get_type() == "PARAM_REQUEST_READ"]
    assert 100 < len(questions) < 400


ELSEWHERE = {f"SERVO{n}_FUNCTION": 0.0 for n in range(1, 5)} | {f"SERVO{n}_FUNCTION": 102.0 - n for n in range(5, 9)}
"""Thruster 4 on output 5, ..., thruster 1 on output 8."""


def test_thrusters_on_other_outputs_are_watched_where_they_are(path):
    """Nothing turns in this world, whose thrusters hang on outputs 1 to 4; the echo is that of the autopilot."""
    bench = Guarded(path, changes=ELSEWHERE)

    async def story(bench):
        await bench.drive_off()
        assert outputs_of(bench.app.state.monitor(OverrideState), 4) == [8, 7, 6, 5]
        await bench.run(1.0)  # soon the boat notices that nothing moves it
        assert bench.mode == "auto" and not told(bench, "SERVOn_FUNCTION")
        bench.world.rover.vehicle.parameters.set("SERVO6_FUNCTION", 0.0)
        await bench.run(3.0)
        assert told(bench, "output 6 at 0 us, which was not sent") == 1, bench.alerts()

    assert bench.scene(story) is None


@pytest.mark.parametrize("command", ["start", "hold", "manual"])
def test_plain_pass_through_never_drives(command, path):
    bench = Guarded(path, "unsafe_plain")

    async def story(bench):
        bench.order(command)
        await bench.run(6.0)
        bench.order("start")
        await bench.run(1.0)
        assert bench.mode == "idle" and bench.guard.refused

    assert bench.scene(story) is None
    assert told(bench, f"{command} {REFUSED}") and told(bench, "LAST PULSE STAYS ON THE THRUSTERS FOR EVER")
    assert not any(m.get_type() == "COMMAND_LONG" and (m.command, m.param1) == (400, 1) for _, m in bench.sent)
    assert all(set(channels[8:12]) <= {1500, 65534} for _, channels in bench.overrides), "neutral, and the release"


def test_stop_never_waits_and_takes_a_waiting_start_back(path):
    bench = Guarded(path)

    async def story(bench):
        bench.order("start")
        bench.order("stop")
        await bench.run(6.0)
        assert bench.guard.clear and bench.mode == "idle"

    assert bench.scene(story) is None


PLUGGED_IN_S = 25.0


@pytest.mark.parametrize("command", ["start", *(pytest.param(c, marks=pytest.mark.long) for c in ("hold", "manual"))])
@pytest.mark.parametrize("cleared", [False, pytest.param(True, marks=pytest.mark.long)])
def test_an_order_without_an_autopilot_expires(command, cleared, path):
    """It waited for ever: obeyed an hour later, in the moment in which an autopilot was plugged in."""
    bench = Guarded(path)

    async def story(bench):
        if cleared:  # it was there, was found good, and went
            assert await bench.run(8.0, until=lambda: bench.guard.clear)
        bench.deaf = True
        await bench.run(4.0)
        bench.order(command)
        await bench.run(WAITS_S + 1.0)
        assert told(bench, f"{command} expired: it waited for an autopilot; give it again") == 1, bench.alerts()
        bench.deaf = False
        await bench.run(PLUGGED_IN_S)
        assert bench.guard.clear and bench.mode == "idle"
        bench.order(command)
        assert await bench.run(5.0, until=lambda: bench.mode in ("auto", "hold", "locked"))

    assert bench.scene(story) is None


def test_a_run_that_begins_by_itself_has_patience_until_the_autopilot_has_booted(path):
    bench = Guarded(path)

    async def story(bench):
        bench.deaf = True
        bench.app.command(OperatorCommand(t_ns=bench.clock.now_ns(), command="start"), SWITCH_ON_S)
        await bench.run(SWITCH_ON_S / 2)
        bench.deaf = False
        assert await bench.run(20.0, until=lambda: bench.mode == "auto"), bench.alerts()

    assert bench.scene(story) is None


def test_parameters_are_read_anew_after_a_reboot(path):
    bench = Guarded(path)

    async def story(bench):
        assert await bench.run(6.0, until=lambda: bench.guard.clear)
        rover = bench.world.rover
        rover.vehicle.parameters.set("SERVO1_FUNCTION", 59)
        rover.vehicle.reboot_asked = True
        assert await bench.run(15.0, until=lambda: bench.guard.refused), bench.alerts()
        bench.order("start")
        await bench.run(1.0)
        assert bench.mode == "idle"

    assert bench.scene(story) is None
    assert told(bench, f"start {REFUSED}") == 1


@pytest.mark.parametrize(("write", "within_s"), [(written, 0.5), (silently_written, 9.0)])
def test_a_wiring_that_is_changed_under_way_ends_in_safe(write, within_s, path):
    bench = Guarded(path)

    async def story(bench):
        await bench.drive_off()
        await bench.run(1.0)
        write(bench, PLAIN)
        assert await bench.run(within_s, until=lambda: bench.mode == "safe"), bench.alerts()
        await bench.run(2.0)
        assert bench.overrides[-1][1][8:12] == (1500,) * 4
        bench.order("start")
        await bench.run(1.0)
        assert bench.mode == "safe" and bench.app.refusal

    assert bench.scene(story) is None
    (stop,) = (m for m in bench.of(Alert) if m.text.startswith("stopped: "))
    assert stop.level == "error" and "SERVO" in stop.text and "_FUNCTION is " in stop.text and "(it was 9" in stop.text
    assert "FOR EVER" in stop.text and "aritra provision" in stop.text, "what it is, and what to do"
    assert told(bench, f"start {REFUSED}") == 1


@pytest.mark.long
def test_a_parameter_other_than_the_outputs_is_found_without_a_broadcast_too(path):
    bench = Guarded(path)

    async def story(bench):
        await bench.drive_off()
        silently_written(bench, {"SERVO3_TRIM": 1700.0})
        assert await bench.run(72.0, until=lambda: bench.mode == "safe"), bench.alerts()

    assert bench.scene(story) is None
    assert told(bench, "SERVO3_TRIM is 1700 now (it was 1500)")


def test_what_is_set_right_again_may_start_again_and_never_by_itself(path):
    bench = Guarded(path)

    async def story(bench):
        await bench.drive_off()
        written(bench, {"SERVO1_FUNCTION": 59.0})
        assert await bench.run(0.5, until=lambda: bench.mode == "safe")
        written(bench, {"SERVO1_FUNCTION": 94.0})
        await bench.run(3.0)
        assert bench.mode == "safe" and bench.guard.clear
        bench.order("start")
        assert await bench.run(5.0, until=lambda: bench.mode == "auto"), bench.alerts()

    assert bench.scene(story) is None
    assert told(bench, "SERVO1_FUNCTION is 94 now (it was 59): no parameter refuses a start any more") == 1


@pytest.mark.long
def test_a_change_that_refuses_nothing_does_not_stop_the_boat(path):
    bench = Guarded(path)

    async def story(bench):
        await bench.drive_off()
        written(bench, {"SERVO9_TRIM": 1400.0, "CRUISE_SPEED": 3.0, "SCHED_LOOP_RATE": 50.0})
        await bench.run(12.0)
        assert bench.mode == "auto"

    assert bench.scene(story) is None
    assert told(bench, "SCHED_LOOP_RATE = 50") == 1, "a warning is said"


# --- several autopilots ------------------------------------------------------------------------------


def test_with_a_second_autopilot_nothing_begins_until_ours_is_named(path):
    bench = Guarded(path)

    async def story(bench):
        assert await bench.run(6.0, until=lambda: bench.guard.clear)
        strange(bench)
        await bench.run(0.5)
        bench.order("start")
        await bench.run(3.0)
        assert bench.mode == "idle" and bench.guard.turns_away

    assert bench.scene(story) is None
    assert told(bench, "autopilots of systems 1 and 7 are heard: this run keeps to 1, which spoke first") == 1
    assert told(bench, "start refused: several autopilots are heard") == 1


def test_one_that_passes_by_under_way_is_told_and_stops_nothing(path):
    bench = Guarded(path)

    async def story(bench):
        await bench.drive_off()
        strange(bench)
        await bench.run(2.0)
        assert bench.mode == "auto"
        bench.order("stop")
        bench.order("start")
        assert await bench.run(5.0, until=lambda: bench.mode == "auto"), "it is known by now which is ours"

    assert bench.scene(story) is None
    assert told(bench, "autopilots of systems 1 and 7 are heard") == 1


def test_a_stranger_that_speaks_first_is_not_spoken_to_where_ours_is_named(path):
    bench = Guarded(path, codec=MavlinkCodec(target_system=1))
    bench.answering = bench.deaf = True

    async def story(bench):
        bench.answering = False
        await bench.run(0.1)
        for _ in range(5):
            strange(bench)
            await bench.run(1.0)
        assert {m.target_system for _, m in bench.sent if hasattr(m, "target_system")} == {1}
        bench.answering, bench.deaf = True, False
        bench.order("start")
        assert await bench.run(25.0, until=lambda: bench.mode == "auto"), bench.alerts()
        strange(bench)
        await bench.run(1.0)

    assert bench.scene(story) is None
    assert told(bench, "an autopilot of system 7 is heard, which is not ours (mavlink.autopilot_system_id = 1)") == 1


def test_an_autopilot_that_tells_nothing_is_never_started(path):
    bench = Guarded(path)
    bench.world.rover.vehicle.parameters.find = lambda name: None  # it does not know any name

    async def story(bench):
        bench.order("start")
        await bench.run(25.0)
        assert bench.mode == "idle" and not bench.guard.clear

    assert bench.scene(story) is None
    assert told(bench, "start expired: it waited for the autopilot's parameters") == 1


def test_a_function_that_is_not_told_is_asked_for_until_it_is_and_so_long_nothing_starts():
    """On a lossy link: output 9 may pass a thruster's channel plainly."""
    guard, framer = StartInterlock(MavlinkCodec(target_system=1), COMPANION), Framer()
    values, lost, messages, asked = parameters_of("gate").values, {"SERVO9_FUNCTION"}, [BEAT], []
    assert not guard.passes(OperatorCommand(t_ns=0, command="start"), SWITCH_ON_S)
    for k in range(400):
        messages = [
            BEAT,
            *(ParamValue(t_ns=0, name=n, value=values[n], index=0, count=1) for n in asked if n not in lost),
        ]
        asked = [m.param_id for m in framer.feed(b"".join(guard.step(messages, k * 10**8)), 0) if m.param_id in values]
        if k > 300 and "SERVO9_FUNCTION" in asked and lost:
            assert not guard.clear and not guard.refused
            assert sum("SERVO9_FUNCTION" in alert.text for alert in guard.take_alerts()) == 1
            lost = set()
    assert not lost and guard.clear and guard.passes(OperatorCommand(t_ns=0, command="start"))
