"""The run file and what it names: read together, checked together, every error with its file and key."""

import re
from dataclasses import replace

import pytest

from companion.boat.load_run import EXAMPLES, load_setup, setup_of, warnings
from companion.core.configuration.tables import ConfigError
from companion.core.model.load_vessel import load_vessel
from tests.support.drive_fixture import mission_text

RUN, VESSEL, SITE, MISSION = "aritra.toml", "boats/aritra.toml", "sites/basin.toml", "missions/square.toml"


@pytest.fixture
def folder(tmp_path):
    for name in (RUN, VESSEL, SITE, MISSION):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text((EXAMPLES / name).read_text())
    return tmp_path


def change(folder, name, old, new):
    text = (folder / name).read_text()
    assert re.search(old, text)
    (folder / name).write_text(re.sub(old, new, text, count=1))


def test_the_example_is_whole(folder):
    setup = load_setup(folder / RUN)
    assert setup.pilot.vessel.name == "aritra" and len(setup.pilot.mission.path.waypoints) == 5
    assert set(setup.files) == {"run.toml", "vessel.toml", "site.toml", "mission.toml"}
    assert setup.digest == load_setup(EXAMPLES / RUN).digest


@pytest.mark.parametrize("name", [RUN, VESSEL, SITE, MISSION])
def test_the_digest_names_every_file(folder, name):
    before = load_setup(folder / RUN).digest
    (folder / name).write_text((folder / name).read_text() + "\n# changed\n")
    assert load_setup(folder / RUN).digest != before


@pytest.mark.parametrize(
    ("name", "old", "new", "key"),
    [
        (RUN, r"period_s = 0.1", "periods = 0.1", "control.periods: unknown key"),
        (RUN, r"period_s = 0.1", "period_s = -1", "control.period_s"),
        (RUN, r"period_s = 0.1", "period_s = 0.5", "control.period_s: expected 0.05 to 0.4, found 0.5"),
        (RUN, r"period_s = 0.1", 'period_s = "fast"', "control.period_s"),
        (RUN, r'url = "udpin[^"]*"', "", "mavlink.url: missing key"),
        (RUN, r"system_id = 1", "system_id = 256", "mavlink.system_id"),
        (RUN, r"system_id = 1", "system_id = 1\nautopilot_system_id = 0", "mavlink.autopilot_system_id"),
        (RUN, r"\[control\]", "[control]\nneutral_channels = [1, 9]", "control.neutral_channels: channel 9 drives"),
        (RUN, r"\[control\]", "[control]\nneutral_channels = [1, 1]", "control.neutral_channels: a channel is there"),
        (RUN, r"plan_deadline_s = 0.05", "plan_deadline_s = 0.1", "control.plan_deadline_s: expected less"),
        (RUN, r"lease_s = 0.3", "lease_s = 0.1", "control.lease_s: expected more"),
        (RUN, r"= ", "== ", "not valid TOML"),
        (VESSEL, r"mass_kg", "mass_kgs", "inertia.mass_kgs: unknown key"),
        (VESSEL, r"mass_kg = 45.0", "mass_kg = -45.0", "inertia.mass_kg"),
        (VESSEL, r"channel = 10", "channel = 9", "thrusters[1].channel: channel 9 is there twice"),
        (VESSEL, r"channel = 9", "channel = 9\npwm_max_us = 1950", "thrusters[0].pwm_max_us: "),
        (VESSEL, r"channel = 9", "channel = 9\npwm_min_us = 1000", "thrusters[0].pwm_min_us: "),
        (VESSEL, r"dwm1001-lec", "dwm9999", "sensors.uwb (wire_format, rate_Hz): unknown UWB wire format 'dwm9999'"),
        (SITE, r"north_m = 0.0", 'north_m = "x"', "anchors[0].north_m"),
        (MISSION, r"north_m = 9.0", "north_m = nan", "waypoints[0]"),
        (MISSION, r"acceptance_m", "acceptance", "acceptance"),
    ],
)
def test_what_is_wrong_is_named_by_file_and_key(folder, name, old, new, key):
    change(folder, name, old, new)
    with pytest.raises(ConfigError) as told:
        load_setup(folder / RUN)
    assert str(folder / name) in str(told.value) and key in str(told.value)


@pytest.mark.parametrize("name", [RUN, VESSEL, SITE, MISSION])
def test_a_file_that_is_not_there_is_named(folder, name):
    (folder / name).unlink()
    with pytest.raises(ConfigError, match=re.escape(f"{folder / name}: No such file")):
        load_setup(folder / RUN)


@pytest.mark.parametrize("name", [RUN, VESSEL, SITE, MISSION])
def test_a_byte_order_mark_as_windows_writes_it_is_none_of_the_text(folder, name):
    whole = load_setup(folder / RUN).digest
    (folder / name).write_bytes(b"\xef\xbb\xbf" + (folder / name).read_bytes().replace(b"\n", b"\r\n"))
    assert load_setup(folder / RUN).digest == whole


@pytest.mark.parametrize(
    ("name", "old", "new", "says"),
    [
        (RUN, r'vessel = "[^"]*"', r'vessel = "a\\u0000b"', "aritra.toml: vessel: .*null byte"),
        (VESSEL, r"mass_kg = 45.0", "mass_kg = " + "9" * 5000, "aritra.toml: a number in it has thousands of digits"),
        (MISSION, r"north_m = 9.0", "north_m = " + "9" * 5000, "(file): a number in it has thousands of digits"),
        (SITE, r"\A", "x = " + "[" * 3000 + "]" * 3000 + "\n", "basin.toml: tables or lists in it are nested too deep"),
    ],
)
def test_what_the_readers_of_text_do_not_bear_is_named_like_all_else(folder, name, old, new, says):
    change(folder, name, old, new)
    with pytest.raises(ConfigError, match=re.escape(says).replace(r"\.\*", ".*")):
        load_setup(folder / RUN)


def test_a_file_that_is_no_text_is_named(folder):
    (folder / VESSEL).write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match=r"aritra.toml: is not UTF-8 text"):
        load_setup(folder / RUN)


@pytest.mark.parametrize("suffix", ["plan", "waypoints", "geojson", "toml"])
def test_another_mission_may_be_named_in_any_format(folder, suffix):
    square = EXAMPLES / "missions" / f"square.{suffix}"
    setup = load_setup(folder / RUN, mission=square)
    assert f"mission.{suffix}" in setup.files
    points = load_setup(folder / RUN).pilot.mission.path.points
    assert [tuple(p) for p in setup.pilot.mission.path.points] == [pytest.approx(p, abs=0.01) for p in points]


def test_a_mission_of_no_known_kind_is_named(folder):
    (folder / "way.txt").write_text("go there")
    with pytest.raises(ConfigError, match=r"way.txt: .*expected one of .toml"):
        load_setup(folder / RUN, mission=folder / "way.txt")


def test_the_texts_alone_make_the_same_setup(folder):
    setup = load_setup(folder / RUN)
    again = setup_of(setup.files, {name: f"log: {name}" for name in setup.files})
    assert again.digest == setup.digest and again.pilot.vessel == setup.pilot.vessel
    broken = {**setup.files, "mission.toml": mission_text(((1.0, float("nan")),))}
    with pytest.raises(ConfigError, match=r"log: mission\.toml"):
        setup_of(broken, {name: f"log: {name}" for name in broken})


def test_what_a_person_should_know_of_fence_and_battery_before_the_boat_moves(folder):
    assert warnings(load_setup(folder / RUN)) == []
    (folder / MISSION).write_text(mission_text(((15.0, 15.0), (29.2, 15.0))))
    change(folder, RUN, r"\[battery\]\nlow_V = 14.0\ncritical_V = 13.2\n", "")
    near, battery = warnings(load_setup(folder / RUN))
    assert "waypoint 2 at north 29.2, east 15 m lies 0.3 m from the fence" in near
    assert "no [battery] limits" in battery


def test_a_battery_that_is_low_but_never_critical_is_told_of(folder):
    change(folder, RUN, "critical_V = 13.2\n", "")
    (battery,) = warnings(load_setup(folder / RUN))
    assert battery.startswith("no critical_V or critical_percent in [battery]: an empty battery will not stop")
    change(folder, RUN, "low_V = 14.0\n", "low_V = 14.0\ncritical_percent = 15\n")
    assert warnings(load_setup(folder / RUN)) == []


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (r"force_max_N = 38.0", "force_max_N = 380.0", "force_max_N = 380, but its pulses reach"),
        (r"force_min_N = -30.0", "force_min_N = -300.0", "force_min_N = -300, but its pulses reach 37.6 N"),
        (r"channel = 9", "channel = 9\npwm_max_us = 1510", "force_max_N = 38, but its pulses reach 0 N"),
        (r'channel = 9\nforce_map = "\w+"', 'channel = 9\ntrim_us = 200\nforce_map = "straight"',
         "trim_us = 200: 1500 us, which every stop puts out, pushes -20 N"),
    ],
)  # fmt: skip
def test_a_thruster_that_cannot_be_meant_so_is_told_of(folder, old, new, says):
    straight = '[force_maps.straight]\nkind = "linear"\nahead_N = 40.0\nastern_N = 40.0\nsource = "assumed"\n'
    change(folder, VESSEL, old, new)
    change(folder, VESSEL, r"(?m)^\[\[thrusters\]\]$", f"{straight}\n[[thrusters]]")
    (text,) = warnings(load_setup(folder / RUN))
    assert text.startswith("thrusters[0] (") and says in text


def test_the_example_boats_thrusters_are_as_they_can_be(folder):
    for boat in sorted((EXAMPLES / "boats").glob("*.toml")):
        setup = load_setup(folder / RUN)
        vessel = load_vessel(boat.read_text(encoding="utf-8"), name=boat.name)
        told = warnings(replace(setup, pilot=replace(setup.pilot, vessel=vessel)))
        assert not [text for text in told if text.startswith("thrusters[")], boat.name


def test_a_wide_boat_keeps_its_side_inside_the_fence(folder):
    assert load_setup(folder / RUN).pilot.nmpc.fence_margin_m == 0.5
    change(folder, VESSEL, r"(?m)^beam_m = .*$", "beam_m = 4.0")
    wide = load_setup(folder / RUN)
    assert wide.pilot.nmpc.fence_margin_m == 2.125
    (folder / MISSION).write_text(mission_text(((1.5, 15.0),)))
    assert "lies 1.0 m from the fence: the boat keeps 2.125 m off it" in warnings(load_setup(folder / RUN))[0]


def test_a_leg_through_a_pier_is_told_of(folder):
    pier = "[[fences]]\ninclusion = false\npolygon = [[14.0, 10.0], [16.0, 10.0], [16.0, 20.0], [14.0, 20.0]]\n"
    (folder / MISSION).write_text(mission_text(((10.0, 15.0), (20.0, 15.0), (20.0, 8.0))) + pier)
    (leg,) = warnings(load_setup(folder / RUN))
    assert leg.startswith("the leg from waypoint 1 to 2 leaves the fence: the boat may stand before it")


def test_a_waypoint_that_counts_as_passed_before_its_leg_is_told_of(folder):
    wide = "[[waypoints]]\nnorth_m = 18.0\neast_m = 15.0\nacceptance_m = 8.0\n"
    (folder / MISSION).write_text(mission_text(((10.0, 15.0),)) + wide)
    (radius,) = warnings(load_setup(folder / RUN))
    assert radius.startswith(
        "waypoint 2: its acceptance radius of 8 m reaches back to the waypoint before it, 8.0 m away"
    )


def test_a_boat_that_needs_way_is_told_what_it_cannot_do(folder):
    (folder / VESSEL).write_text((EXAMPLES / "boats" / "rudder.toml").read_text())
    setup = load_setup(folder / RUN)
    drifts, unjudged = warnings(setup)
    assert (
        "rudder is steered only while it makes way: it cannot keep station" in drifts
        and setup.pilot.guidance.end == "drift"
    )
    assert "whether thrusters and servos do as they are told is not judged" in unjudged
    assert "heading at the end" not in drifts
    (folder / MISSION).write_text("end_heading_deg = 0\n" + mission_text())
    assert "the heading at the end of the mission is not kept" in warnings(load_setup(folder / RUN))[0]
    (folder / MISSION).write_text(mission_text(((9.0, 9.0), (15.0, 9.0), (15.0, 10.5))))
    with pytest.raises(
        ConfigError,
        match=r"square\.toml: waypoint 2 .*cannot be rounded: the turn of 90 deg .* turn on the spot",
    ):
        load_setup(folder / RUN)
    change(folder, VESSEL, "channel = 10", "channel = 3")
    with pytest.raises(ConfigError, match="channel 3 drives servo rudder of"):
        load_setup(folder / RUN)


def test_waypoints_beyond_the_fence_are_refused_by_file_and_number_whatever_their_format(folder):
    (folder / MISSION).write_text(mission_text(((15.0, 15.0), (31.0, 15.0))))
    where = rf"{re.escape(str(folder / MISSION))}: waypoint 2 at north 31, east 15 m lies 1\.5 m beyond the fence"
    with pytest.raises(ConfigError, match=where):
        load_setup(folder / RUN)
    change(folder, SITE, r"fence = .*", "fence = [[0.5, 0.5], [9.5, 0.5], [9.5, 9.5], [0.5, 9.5]]")
    square = EXAMPLES / "missions" / "square.plan"
    with pytest.raises(ConfigError, match=r"square\.plan: waypoint \d at .* beyond the fence"):
        load_setup(folder / RUN, mission=square)


def test_a_log_of_a_mission_beyond_the_fence_can_still_be_read(folder):
    setup = load_setup(folder / RUN)
    texts = {**setup.files, "mission.toml": mission_text(((15.0, 15.0), (31.0, 15.0)))}
    assert setup_of(texts, {name: name for name in texts}).pilot.fence.clearance(31.0, 15.0) == -1.5


def test_a_fence_of_the_mission_counts_like_the_sites_own(folder):
    keep_out = "[[fences]]\ninclusion = false\npolygon = [[14.0, 14.0], [16.0, 14.0], [16.0, 16.0], [14.0, 16.0]]\n"
    (folder / MISSION).write_text(mission_text(((9.0, 9.0), (15.0, 15.0))) + keep_out)
    with pytest.raises(ConfigError, match=r"waypoint 2 .* 1\.0 m beyond the fence"):
        load_setup(folder / RUN)
    (folder / MISSION).write_text(mission_text(((9.0, 9.0), (12.0, 15.0))) + keep_out)
    setup = load_setup(folder / RUN)
    assert setup.pilot.fence.clearance(15.0, 15.0) == -1.0 and setup.pilot.fence.clearance(12.0, 15.0) == 2.0
