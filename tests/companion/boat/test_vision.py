"""Our position for the autopilot: rotation, lever arm, covariance, jumps, the origin; read back by pymavlink."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace
from pymavlink.dialects.v20 import ardupilotmega as wire

from companion.core.messages import StateEstimate
from drivers.mavlink.codec import MavlinkCodec
from drivers.mavlink.session import MavlinkSession
from drivers.mavlink.vision import OriginFeed, VisionFeed, jumped
from tests.companion.boat.app_fixture import Bench, S

PERIOD_NS = S // 10


def estimate(t_ns=S, x=0.0, y=0.0, psi=0.0, nu=(0.0, 0.0, 0.0), P=None, health="healthy"):
    P = np.diag([0.01, 0.01, 1e-4, 1e-3, 1e-3, 1e-4]) if P is None else P
    return StateEstimate(
        t_ns=t_ns, north_m=x, east_m=y, psi_rad=psi, u_m_s=nu[0], v_m_s=nu[1], r_rad_s=nu[2],
        covariance=tuple(np.asarray(P).ravel().tolist()), accel_bias_m_s2=(0.0, 0.0), gyro_bias_rad_s=0.0,
        anchor_bias_m={}, disturbance_n=(0.0, 0.0, 0.0), health=health, reason="",
    )  # fmt: skip


def spread():
    """A covariance with everything in it (seed 5)."""
    A = np.random.default_rng(5).normal(size=(6, 6)) * 0.1
    return A @ A.T + 1e-4 * np.eye(6)


def full(triangle):
    """The 6 x 6 matrix of which these are the rows of the upper triangle, written out by the message's text."""
    P, values = np.zeros((6, 6)), iter(triangle)
    for row in range(6):
        for column in range(row, 6):
            P[row, column] = P[column, row] = next(values)
    return P


def read(fix):
    frame = MavlinkCodec(1, 191, 1).encoder.vision_position(fix)
    (m,) = wire.MAVLink(None).parse_buffer(frame)
    return m


angles = st.floats(-math.pi, math.pi)


@settings(max_examples=60, deadline=None)
@given(angles, angles, st.floats(-50, 50), st.floats(-50, 50), st.floats(-1, 1), st.floats(-1, 1))
def test_the_pose_is_that_of_the_imu_in_true_north(rotation, psi, x, y, forward, starboard):
    """Held against rotation matrices of scipy; covariance against draws pushed through the same map."""
    from scipy.spatial.transform import Rotation

    fix = VisionFeed(10.0, rotation, (forward, starboard)).step(estimate(x=x, y=y, psi=psi), 0)
    m = read(fix)
    site = Rotation.from_euler("z", rotation)
    body = Rotation.from_euler("z", psi)
    place = site.apply(np.array([x, y, 0.0]) + body.apply([forward, starboard, 0.0]))
    assert (m.x, m.y) == pytest.approx(tuple(place[:2]), abs=1e-4) and (m.z, m.roll, m.pitch) == (0, 0, 0)
    assert math.cos(m.yaw - psi - rotation) == pytest.approx(1.0, abs=1e-6) and abs(m.yaw) <= math.pi + 1e-6
    assert m.usec == S // 1000


def test_the_covariance_turns_with_the_pose():
    """Against the numerical derivative of the whole map."""
    rotation, psi, arm, P = 0.7, -1.2, (0.4, -0.2), spread()

    def place(x, y, heading):
        f = VisionFeed(10.0, rotation, arm).step(estimate(x=x, y=y, psi=heading), 0)
        return np.array([f.north_m, f.east_m, f.yaw_rad])

    at = np.array([3.0, 2.0, psi])
    J = np.column_stack([(place(*(at + d)) - place(*(at - d))) / 2e-6 for d in 1e-6 * np.eye(3)])
    m = read(VisionFeed(10.0, rotation, arm).step(estimate(x=3.0, y=2.0, psi=psi, P=P), 0))
    told = full(m.covariance)
    kept = [0, 1, 5]
    assert told[np.ix_(kept, kept)] == pytest.approx(J @ P[:3, :3] @ J.T, abs=1e-6)
    assert np.all(np.linalg.eigvalsh(told) > 0) and np.isfinite(m.covariance).all()
    assert told[2, 2] > 0 and told[3, 3] > 0 and told[4, 4] > 0, "the autopilot adds the height's up, too"


def drive(feed, count, *, step_m=0.05, t0=S, change=None):
    """Fixes of a boat going north at 0.5 m/s, ten estimates a second; `change`: index -> estimate to another."""
    fixes = []
    for i in range(count):
        e = estimate(t_ns=t0 + i * PERIOD_NS, x=i * step_m, nu=(0.5, 0.0, 0.0))
        fixes.append(feed.step(change(i, e) if change else e, 0))
    return fixes


def resets(fixes):
    return [f.reset_counter for f in fixes if f]


def test_driving_is_no_jump_and_a_jump_is_counted_once():
    assert set(resets(drive(VisionFeed(10.0, 0.3, (0.2, 0.0)), 50))) == {0}
    moved = drive(VisionFeed(10.0, 0.3, (0.2, 0.0)), 50, change=lambda i, e: replace(e, east_m=3.0 if i >= 20 else 0.0))
    assert resets(moved) == [0] * 20 + [1] * 30
    turned = drive(VisionFeed(10.0, 0.0, (0.0, 0.0)), 50, change=lambda i, e: replace(e, psi_rad=1.0 if i >= 20 else 0))
    assert resets(turned) == [0] * 20 + [1] * 30


def test_a_jump_between_two_sent_positions_is_counted_too():
    fixes = drive(VisionFeed(2.0, 0.0, (0.0, 0.0)), 50, change=lambda i, e: replace(e, east_m=3.0 if i >= 21 else 0.0))
    assert len(resets(fixes)) == 10 and resets(fixes) == [0] * 5 + [1] * 5


def test_a_turning_boat_does_not_jump():
    """A circle of 1 m at 1 rad/s: 10 estimates a second see the pose where the velocity says."""
    poses = [estimate(t_ns=S + k * PERIOD_NS, x=math.sin(k / 10), y=1 - math.cos(k / 10), psi=k / 10 % math.tau,
                      nu=(1.0, 0.0, 1.0)) for k in range(100)]  # fmt: skip
    assert not any(jumped(a, b) for a, b in itertools.pairwise(poses))


def test_a_position_found_again_after_dead_reckoning_is_a_jump():
    vague = np.diag([0.5, 0.5, 1e-4, 1e-3, 1e-3, 1e-4])
    feed = VisionFeed(10.0, 0.0, (0.0, 0.0))
    assert feed.step(estimate(S, P=vague, health="degraded"), 0).reset_counter == 0
    assert feed.step(estimate(S + PERIOD_NS, x=0.9, P=vague, health="degraded"), 0).reset_counter == 0
    assert feed.step(estimate(S + 2 * PERIOD_NS, x=-0.1), 0).reset_counter == 1


def test_a_restart_of_the_estimator_and_a_gap_are_jumps():
    feed = VisionFeed(10.0, 0.0, (0.0, 0.0))
    assert feed.step(estimate(S), 0).reset_counter == 0
    assert feed.step(estimate(S + PERIOD_NS), 1).reset_counter == 1
    for health in ("initialising", "lost"):
        assert feed.step(estimate(2 * S, health=health), 1) is None
    assert feed.step(estimate(3 * S), 1).reset_counter == 2
    assert feed.step(estimate(3 * S + PERIOD_NS, health="degraded"), 1).reset_counter == 2


def test_the_counter_wraps_as_a_byte():
    feed = VisionFeed(10.0, 0.0, (0.0, 0.0))
    counters = [read(feed.step(estimate(S + k * S), k)).reset_counter for k in range(300)]
    assert counters[255:258] == [255, 0, 1]


@pytest.mark.parametrize(("rate_hz", "count"), [(10.0, 100), (5.0, 50), (1.0, 10), (50.0, 100)])
def test_the_rate_is_at_most_what_was_asked_for(rate_hz, count):
    assert abs(len([f for f in drive(VisionFeed(rate_hz, 0.0, (0.0, 0.0)), 100) if f]) - count) <= 1


def test_a_late_estimate_does_not_make_up_for_lost_ones():
    feed = VisionFeed(10.0, 0.0, (0.0, 0.0))
    assert feed.step(estimate(S), 0) and feed.step(estimate(5 * S), 0)
    assert feed.step(estimate(5 * S + PERIOD_NS // 10), 0) is None


# --- the origin -----------------------------------------------------------------------------------------


def test_the_origin_is_asked_for_until_it_is_told_and_again_after_a_reboot():
    told = [0]
    feed = OriginFeed(lambda: told[0])
    times = [t for t in range(0, 60) if feed.due(1, t * S)]
    assert times == [0, 2, 6, 14, 30]
    told[0] = 1
    assert not any(feed.due(1, t * S) for t in range(60, 200))
    assert feed.due(2, 200 * S) and not feed.due(2, 201 * S) and feed.due(2, 202 * S)


def test_the_conversation_begins_again_after_silence_and_after_a_reboot():
    mav = wire.MAVLink(None, 1, 1)
    beat = wire.MAVLink_heartbeat_message(11, 3, 65, 0, 4, 3).pack(mav)
    codec = MavlinkCodec()
    session = MavlinkSession(codec)

    def hear(data, t_ns):
        session.step(codec.feed(bytes(data), t_ns), t_ns)
        return session.begins

    assert hear(b"", S) == 0 and hear(beat, 2 * S) == 1 and hear(beat, 3 * S) == 1
    assert hear(beat, 9 * S) == 2, "after 6 s of silence it may be another"
    assert hear(wire.MAVLink_attitude_message(90_000, 0, 0, 0, 0, 0, 0).pack(mav), 10 * S) == 2
    assert hear(wire.MAVLink_attitude_message(1_000, 0, 0, 0, 0, 0, 0).pack(mav), 11 * S) == 3, "its clock began anew"


def test_the_origin_on_the_wire():
    frame = MavlinkCodec(1, 191, 7).encoder.global_origin(-36.8485, 174.7633)
    (m,) = wire.MAVLink(None).parse_buffer(frame)
    assert (m.get_type(), m.target_system) == ("SET_GPS_GLOBAL_ORIGIN", 7)
    assert (m.latitude, m.longitude, m.altitude) == (-368485000, 1747633000, 0)


def test_a_run_sends_both(tmp_path):
    """In the closed loop: the origin at once, ten positions a second, each where the boat's IMU was then."""
    bench = Bench(tmp_path / "run.mcap", vision_hz=10.0)
    truth = []

    async def story(bench):
        await bench.drive()
        for _ in range(200):
            await bench.run(0.01)
            truth.append(bench.world.truth())

    assert bench.scene(story) is None
    sent = [m for _, m in bench.sent if m.get_type() == "VISION_POSITION_ESTIMATE"]
    origins = [m for _, m in bench.sent if m.get_type() == "SET_GPS_GLOBAL_ORIGIN"]
    told = bench.mind.settings
    assert origins and origins[0].latitude == round(told.site.lat_deg * 1e7) and told.site.rotation_deg == 0
    assert len(sent) == pytest.approx((sent[-1].usec - sent[0].usec) * 1e-5, abs=2)
    arm = told.vessel.sensors.imu
    errors = []
    for m in sent:
        at = min(truth, key=lambda t: abs(t.t_ns - m.usec * 1000))
        if abs(at.t_ns - m.usec * 1000) < 2e7:
            c, s = math.cos(at.psi_rad), math.sin(at.psi_rad)
            north, east = at.north_m + c * arm.x_m - s * arm.y_m, at.east_m + s * arm.x_m + c * arm.y_m
            errors.append(math.hypot(m.x - north, m.y - east))
    assert len(errors) >= 18 and max(errors) < 0.4
    assert {m.reset_counter for m in sent} == {0}


def test_a_run_without_sends_neither(tmp_path):
    bench = Bench(tmp_path / "run.mcap")

    async def story(bench):
        await bench.run(3.0)

    assert bench.scene(story) is None
    assert not {m.get_type() for _, m in bench.sent} & {"VISION_POSITION_ESTIMATE", "SET_GPS_GLOBAL_ORIGIN"}
