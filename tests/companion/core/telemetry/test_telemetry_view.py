"""What is published of a run, and how often: on messages made by hand and on those of a whole simulated voyage."""

import json
import math
from collections import Counter
from functools import cache

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.core import messages as m
from companion.core.preflight.rows import Row
from companion.core.telemetry import structs as shore
from companion.core.telemetry.rounding import TEXT_CHARS
from companion.core.telemetry.status import LinkNow, Spread
from companion.core.telemetry.view import TelemetryView, Who, wants
from tests.support.drive_fixture import setup, under_way, voyage

S = 1_000_000_000
WHO = Who("abc123", "digest", "aritra 0", 5 * S, commands=True)


def view(rate_hz=10.0):
    return TelemetryView(setup().pilot, WHO, rate_hz)


A = np.random.default_rng(3).normal(size=(6, 6))
COVARIANCE = tuple((A @ A.T).ravel().tolist())


def estimate(t_ns, north_m=1.0, reason=""):
    return m.StateEstimate(
        t_ns=t_ns, north_m=north_m, east_m=2.0, psi_rad=0.5, u_m_s=0.1, v_m_s=0.0, r_rad_s=0.0,
        covariance=COVARIANCE, accel_bias_m_s2=(0.0, 0.0), gyro_bias_rad_s=0.0,
        anchor_bias_m={}, disturbance_n=(0.1, 0.2, 0.3), health="healthy", reason=reason,
    )  # fmt: skip


def tick(seen, t_ns, late_ms=1.0):
    """One tick of a run as `watch` tells it; what came out of it."""
    lease = m.OverrideLease(
        t_ns=t_ns + 9_000_000, index=0, channels=(9, 10, 11, 12, 1), pwm_us=(1510, 1520, 1530, 1540, 1500),
        valid_for_s=0.3, source="plan", reason="", f_command_n=(1.0, 2.0, 3.0, 4.0),
    )  # fmt: skip
    timing = m.LoopTiming(t_ns=lease.t_ns, index=0, lateness_ms=late_ms, imu_to_override_ms=9.0)
    return [told for message in (estimate(t_ns), lease, timing) for told in seen.see(message)]


@cache
def told_of_a_voyage():
    """Everything published in a simulated voyage (seed 11), and the messages it was made from."""
    run, seen, told, watched = voyage(11), view(), [], []
    run.run(lambda r: r.world.t_ns > 20 * S, 21.0)
    for message in run.messages:
        watched.append(message)
        told += seen.see(message)
        if isinstance(message, m.OverrideLease):  # the stepped run has no shell, which says how the tick went
            timing = m.LoopTiming(t_ns=message.t_ns, index=message.index, lateness_ms=0.1, imu_to_override_ms=5.0)
            told += seen.see(timing)
    return watched, told


@pytest.mark.long
def test_a_voyage_is_told_at_the_stated_rates():
    watched, told = told_of_a_voyage()
    counts = Counter(shore.topic_of(t) for t in told)
    ticks = sum(isinstance(x, m.Tick) for x in watched)
    assert abs(counts["state"] - ticks) <= 2 and abs(counts["thrusters"] - ticks) <= 2
    seconds = ticks / 10
    assert abs(counts["timing"] - seconds) <= 2 and abs(counts["battery"] - seconds) <= 3
    asked = sum(isinstance(x, m.GuidanceReference) for x in watched)
    assert asked > 50 and abs(counts["reference"] - asked / 2) <= 2 and abs(counts["horizon"] - asked / 2) <= 3
    assert counts["alert"] == sum(isinstance(x, m.Alert) for x in watched)
    assert counts["mode"] == sum(isinstance(x, m.ModeStatus) for x in watched)


def test_what_is_told_survives_the_wire_and_agrees_with_its_source():
    watched, told = told_of_a_voyage()
    states = {x.t_ns: x for x in watched if isinstance(x, m.StateEstimate)}
    plans = {x.index: x for x in watched if isinstance(x, m.PlanResult)}
    asked = {x.t_ns: x for x in watched if isinstance(x, m.SolveRequest)}
    for each in told:
        topic, data = shore.topic_of(each), shore.encode(each)
        assert shore.decode(topic, data) == each
        assert json.loads(data)["v"] == 1 and each.run == "abc123"
        if isinstance(each, shore.StateNow):
            source = states[each.t_ns]
            assert math.dist((each.north_m, each.east_m), (source.north_m, source.east_m)) < 1e-3
            P = np.array(shore.square(each.covariance))
            np.testing.assert_allclose(P, np.reshape(source.covariance, (6, 6)), rtol=1e-3, atol=1e-12)
        elif isinstance(each, shore.HorizonNow):
            request = asked[each.t_ns]
            plan = plans[request.index]
            np.testing.assert_allclose(each.poses, [x[:3] for x in plan.x], atol=0.0051)
            np.testing.assert_allclose(each.reference, [row[:2] for row in request.reference], atol=0.0051)
            assert len(each.poses) == len(each.reference) == 21


def test_ranges_come_with_what_the_filter_made_of_them():
    watched, told = told_of_a_voyage()
    told = {t.t_ns: t for t in told if isinstance(t, shore.RangesNow)}
    judged, made = 0, {}
    for x in reversed(watched):
        if isinstance(x, m.Innovation) and x.sensor.startswith("range "):
            made[x.sensor] = x
        elif isinstance(x, m.UwbRanges):
            if each := told.get(x.t_ns):
                assert [r.anchor for r in each.ranges] == [r.anchor for r in x.ranges]
                for r in each.ranges:
                    if innovation := made.get(f"range {r.anchor}"):
                        assert abs(r.residual_m - innovation.innovation[0]) < 1e-3
                        assert r.accepted == innovation.accepted
                        judged += 1
            made.clear()
    spoken = [r for t in told.values() for r in t.ranges if r.residual_m is not None]
    assert len(spoken) == judged > 50, "none but the first cycle, which the filter begins with, is without"


def test_a_voyage_at_full_rate_is_less_than_15_kB_a_second():
    watched, told = told_of_a_voyage()
    seconds = sum(isinstance(x, m.Tick) for x in watched) / 10
    rate = sum(len(shore.encode(t)) for t in told) / seconds
    print(f"{rate:.0f} B/s")
    assert rate < 15_000


@settings(max_examples=30, deadline=None)
@given(
    rate_hz=st.sampled_from([1.0, 2.0, 5.0, 10.0]),
    jitter=st.lists(st.integers(-4_000_000, 12_000_000), min_size=60, max_size=60),
)
def test_rates_hold_whatever_the_ticks_do(rate_hz, jitter):
    seen, told, t_ns = view(rate_hz), [], S
    for late_ns in jitter:
        told += tick(seen, t_ns + late_ns)
        t_ns += S // 10
    states = [x for x in told if isinstance(x, shore.StateNow)]
    assert abs(len(states) - 6 * rate_hz) <= 1
    gaps = np.diff([x.t_ns for x in states]) * 1e-9
    assert gaps.min() > 0.6 / rate_hz and gaps.max() < 1.4 / rate_hz + 0.1


def test_nothing_old_is_told_anew():
    seen = view()
    tick(seen, S)
    silent = [told for k in range(5) for told in seen.see(
        m.LoopTiming(t_ns=2 * S + k * S // 10, index=k, lateness_ms=0.0, imu_to_override_ms=None))]  # fmt: skip
    assert {type(x) for x in silent} <= {shore.TimingNow, shore.LinksNow}


def test_timing_speaks_of_its_own_second():
    seen = view()
    for k in range(11):
        tick(seen, S + k * S // 10, late_ms=50.0 if k == 3 else 1.0)
    told = [x for k in range(11, 25) for x in tick(seen, S + k * S // 10) if isinstance(x, shore.TimingNow)]
    assert [x.lateness.max_ms for x in told] == [1.0]
    assert told[0].leases == {"plan": 10} and told[0].solve == Spread(median_ms=None, max_ms=None)


def test_ages_and_links():
    seen = view()
    imu = m.ImuSample(t_ns=S, t_rx_ns=S, ax_m_s2=0, ay_m_s2=0, az_m_s2=-9.8, p_rad_s=0, q_rad_s=0, r_rad_s=0, source="")
    seen.see(imu)
    seen.see(m.LinkStatus(t_ns=S, link="uwb", state="lost", reason="silent for 20 s"))
    (links,) = [x for x in tick(seen, 3 * S) if isinstance(x, shore.LinksNow)]
    assert links.ages_s == {"heartbeat": None, "imu": 2.01, "attitude": None, "uwb": None}
    assert links.links == (LinkNow(link="uwb", state="lost", reason="silent for 20 s"),)


def test_alerts_are_told_at_once_and_not_more_than_ten_a_second():
    seen = view()
    told = [seen.see(m.Alert(t_ns=S + k, level="error", text=f"fault {k}")) for k in range(30)]
    assert sum(map(len, told)) == 10 and seen.dropped == 20
    assert seen.see(m.Alert(t_ns=3 * S, level="error", text="x" * 5000))[0].text == "x" * (TEXT_CHARS - 3) + "..."


def test_another_mission_is_told_and_remembered():
    seen = view()
    about, path = seen.begin(S)
    assert path.origin == "run file" and len(path.waypoints) == 3 and about.commands
    assert len(about.thrusters) == 4 and about.within[0] == setup().pilot.site.fence
    new = m.NewMission(t_ns=2 * S, name="pier", waypoints=(m.MissionPoint(north_m=3.0, east_m=4.0),))
    assert seen.see(new) == []
    (told,) = [x for x in tick(seen, 2 * S) if isinstance(x, shore.PathNow)]
    assert told == seen.begin(told.t_ns)[1] and told.origin == "shore" and told.waypoints == new.waypoints
    assert not [x for x in tick(seen, 3 * S) if isinstance(x, shore.PathNow)]


def test_checks_are_told_with_the_gravest_level():
    row = Row(area="autopilot", name="FS_ACTION", level="refuse", found="0", needed="2", why="w", fix="f")
    told = view().checks([row], S)
    assert told.level == "refuse" and shore.decode("checks", shore.encode(told)) == told


def test_every_topic_has_its_key_and_newer_ones_are_refused_in_words():
    assert shore.telemetry_key("b", "state") == "aritra/b/telemetry/state"
    with pytest.raises(ValueError, match="unknown telemetry topic"):
        shore.decode("weather", b"{}")
    with pytest.raises(ValueError, match=r"mode: .*missing required field"):
        shore.decode("mode", b"{}")
    newer = shore.encode(shore.AlertTold(v=2, run="r", t_ns=1, level="info", text="")).replace(b"}", b',"new":1}')
    with pytest.raises(ValueError, match="version 2, this program knows 1"):
        shore.decode("alert", newer)
    assert shore.decode("alert", newer.replace(b'"v":2', b'"v":1')).text == ""


@settings(max_examples=50, deadline=None)
@given(st.binary(max_size=200))
def test_strange_bytes_are_a_value_error(data):
    for topic in shore.TOPICS:
        with pytest.raises(ValueError):
            shore.decode(topic, data)


def test_attitude_goes_out_twice_a_second_and_a_heading_that_was_left_out_is_null():
    seen, told = view(), []
    for k in range(40):
        t_ns = 10 * S + k * S // 10
        attitude = {
            "phi_rad": 0.1,
            "theta_rad": -0.02,
            "psi_rad": math.nan,
            "p_rad_s": 0.0,
            "q_rad_s": 0.0,
            "r_rad_s": 0.0,
        }
        if k < 20:
            seen.see(m.Attitude(t_ns=t_ns, t_rx_ns=t_ns, **attitude))
        told += [each for each in tick(seen, t_ns) if isinstance(each, shore.AttitudeNow)]
    assert len(told) == 5, "and no more once there is none"
    assert (told[0].roll_rad, told[0].pitch_rad, told[0].heading_rad) == (0.1, -0.02, None)
    assert b'"heading_rad":null' in shore.encode(told[0])


def test_the_last_word_says_that_the_program_has_ended():
    seen = view()
    assert seen.end(S) == [], "nothing was said of a mode that could end"
    seen.see(m.ModeStatus(t_ns=2 * S, mode="hold", why="told so", driving=True))
    for t_ns in (S, 3 * S):
        (last,) = seen.end(t_ns)
        assert isinstance(last, shore.ModeNow) and last.ended and not last.driving and last.mode == "hold"
        assert last.t_ns > 2 * S, "newer than what was told before"
    assert not shore.decode(
        "mode", b'{"run":"r","t_ns":1,"mode":"hold","why":"","driving":true,"armed":null,"autopilot_mode":null}'
    ).ended


def test_what_the_view_does_not_want_changes_nothing():
    seen = view()
    for message in (m.Tick(t_ns=S, index=0), m.StepMark(t_ns=S, inputs=1), m.CommandAck(t_ns=S, command=1, result=0)):
        assert not wants(message) and seen.see(message) == []


# --- another mission, in the pilot ------------------------------------------------------------------


def test_the_pilot_takes_another_mission_only_while_none_is_driven():
    from tests.support.drive_fixture import pilot

    mind, (state, t_ns) = pilot(), under_way()
    new = m.NewMission(t_ns=t_ns, name="pier", waypoints=(m.MissionPoint(north_m=12.0, east_m=12.0),))
    same, told = mind.step(state, [new], t_ns)
    assert same.mission is None and [x.level for x in told if isinstance(x, m.Alert)] == ["warning"]
    stopped, _ = mind.step(state, [m.OperatorCommand(t_ns=t_ns, command="stop")], t_ns)
    loaded, told = mind.step(stopped, [new], t_ns)
    assert loaded.mission.path.points == ((12.0, 12.0),) and loaded.passed == ()
    assert any("pier" in x.text for x in told if isinstance(x, m.Alert))


def test_a_loaded_mission_is_driven_and_replays_from_its_log():
    """Waypoints of the new mission are the ones that guidance passes (seed 11); JSON and back gives the same."""
    point = m.MissionPoint(north_m=10.0, east_m=8.0, speed_m_s=0.4)
    run = voyage(11)
    run.run(lambda r: r.world.t_ns > 8 * S, 9.0)
    new = m.NewMission(t_ns=run.world.t_ns, name="near", waypoints=(point,))
    assert msgspec.json.decode(msgspec.json.encode(new), type=m.NewMission) == new
    for order in (m.OperatorCommand(t_ns=run.world.t_ns, command="stop"), new,
                  m.OperatorCommand(t_ns=run.world.t_ns, command="start")):  # fmt: skip
        run.feed([order])
    assert run.run(lambda r: len(r.state.passed) == 1, 20.0)
    assert math.dist(run.state.guidance.route.points[-1], (10.0, 8.0)) < 1e-9
