"""`aritra log export --rosbag2`: read by the rosbags library, and turned back into what was logged."""

import math
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

pytest.importorskip("rosbags", reason="the extra `analysis` is not installed")

from rosbags.highlevel import AnyReader

from companion.core import messages as m
from companion.core.configuration.tables import ConfigError
from companion.core.geometry.frames import Origin, site_from_geodetic
from companion.core.model.thrusters import configuration_matrix
from companion.logs.configuration import setup_in
from companion.logs.export import rosbag2
from companion.logs.log_file import LogFile
from tests.companion.command_line import exit_code
from tests.companion.logs.export.test_geojson import SITE, record
from tests.companion.logs.page.page_logs import page_log
from tests.companion.logs.readers.run_logs import record as record_run
from tests.companion.logs.readers.run_logs import simulated

OFFSET_NS = 1_790_000_000_000_000_000
ENU_FROM_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FLU = np.diag([1.0, -1.0, -1.0])
XYN = [0, 1, 5]
REAL = st.floats(-1e4, 1e4)
ANGLE = st.floats(-math.pi, math.pi)


def bag(folder: Path) -> dict[str, list]:
    """Topic -> (time of the bag [ns], message)."""
    found = defaultdict(list)
    with AnyReader([folder]) as reader:
        for connection, t_ns, raw in reader.messages():
            found[connection.topic].append((t_ns, reader.deserialize(raw, connection.msgtype)))
    return dict(found)


def vector(xyz) -> np.ndarray:
    return np.array([xyz.x, xyz.y, xyz.z])


def attitude(q) -> tuple[float, ...]:
    """Roll, pitch, true heading of FRD in NED from a ROS orientation, by scipy."""
    ned_from_frd = ENU_FROM_NED.T @ Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix() @ FLU
    psi, theta, phi = Rotation.from_matrix(ned_from_frd).as_euler("ZYX")
    return phi, theta, psi


def stamp_ns(header) -> int:
    return header.stamp.sec * 1_000_000_000 + header.stamp.nanosec


def same_angle(a: float, b: float) -> bool:
    return math.cos(a - b) == pytest.approx(1.0, abs=1e-9)


@st.composite
def covariances(draw):
    root = np.array(draw(st.lists(st.floats(-2, 2), min_size=36, max_size=36))).reshape(6, 6)
    return root @ root.T


@settings(max_examples=25, deadline=None)  # each writes a log and a bag
@given(
    site=st.tuples(st.floats(-60, 60), st.floats(-180, 180), st.floats(-180, 180)), covariance=covariances(),
    place=st.tuples(st.floats(-300, 300), st.floats(-300, 300)), psi=ANGLE, nu=st.tuples(REAL, REAL, REAL),
    push=st.tuples(REAL, REAL, REAL), tilt=st.tuples(st.floats(-1.4, 1.4), st.floats(-1.4, 1.4)),
    imu=st.lists(REAL, min_size=6, max_size=6), pwm=st.lists(st.integers(0, 65535), max_size=8),
    battery=st.tuples(st.floats(0, 60), st.none() | st.floats(-50, 50), st.none() | st.integers(0, 100)),
    delay_ns=st.integers(0, 10**9), text=st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"])),
)  # fmt: skip
@pytest.mark.long
def test_what_was_logged_comes_back(
    tmp_path_factory, site, covariance, place, psi, nu, push, tilt, imu, pwm, battery, delay_ns, text
):
    folder, t_ns = tmp_path_factory.mktemp("bag"), 5_000_000_000
    measured = {"t_ns": t_ns, "t_rx_ns": t_ns + delay_ns}
    log = record(
        folder / "t.mcap",
        m.StateEstimate(
            t_ns=t_ns, north_m=place[0], east_m=place[1], psi_rad=psi, u_m_s=nu[0], v_m_s=nu[1], r_rad_s=nu[2],
            covariance=tuple(covariance.ravel()), accel_bias_m_s2=(0.0, 0.0), gyro_bias_rad_s=0.0, anchor_bias_m={},
            disturbance_n=push, health="healthy", reason="",
        ),
        m.ImuSample(**measured, **dict(zip(IMU, imu, strict=True)), source="imu"),
        m.Attitude(**measured, phi_rad=tilt[0], theta_rad=tilt[1], psi_rad=psi, **dict(zip(IMU[3:], nu, strict=True))),
        m.ServoOutput(t_ns=t_ns, pwm_us=tuple(pwm)),
        m.Battery(t_ns=t_ns, voltage_v=battery[0], current_a=battery[1], remaining_percent=battery[2]),
        m.Alert(t_ns=t_ns, level="error", text=text),
        m.UwbPosition(**measured, tag="T", x_m=place[1], y_m=place[0], z_m=1.5),
        site=SITE.format(lat=site[0], lon=site[1], turn=site[2]),
    )  # fmt: skip
    assert rosbag2.write(log, folder / "bag") == (9, 0, "")
    found = bag(folder / "bag")
    ((at_ns, odometry),), ((imu_ns, sample),) = found["/odometry"], found["/imu/data_raw"]
    assert (at_ns, stamp_ns(odometry.header)) == (t_ns + OFFSET_NS, t_ns + OFFSET_NS)
    assert (imu_ns, stamp_ns(sample.header)) == (t_ns + delay_ns + OFFSET_NS, t_ns + OFFSET_NS)

    turn = math.radians(site[2])
    back = _site_place(vector(odometry.pose.pose.position), turn)
    assert back == pytest.approx(place, abs=1e-8)
    assert same_angle(attitude(odometry.pose.pose.orientation)[2] - turn, psi)
    twist = odometry.twist.twist
    assert (twist.linear.x, -twist.linear.y, -twist.angular.z) == nu
    jacobian = np.zeros((3, 3))  # of [x y yaw] by [north east psi], from the conversion of three places itself
    jacobian[:2, :2] = np.linalg.inv([_site_place(np.array(p), turn) for p in ((1.0, 0, 0), (0, 1.0, 0))]).T
    jacobian[2, 2] = -1.0
    pose, rates = (x.covariance.reshape(6, 6) for x in (odometry.pose, odometry.twist))
    assert pose[np.ix_(XYN, XYN)] == pytest.approx(jacobian @ covariance[:3, :3] @ jacobian.T, abs=1e-8)
    assert rates[np.ix_(XYN, XYN)] == pytest.approx(FLU @ covariance[3:, 3:] @ FLU, abs=1e-12)
    assert np.count_nonzero(np.delete(pose, XYN, axis=0)) == 0

    ((_, fix),) = found["/fix"]
    origin = Origin(site[0], site[1], turn)
    assert site_from_geodetic(origin, fix.latitude, fix.longitude) == pytest.approx(place, abs=1e-6)
    assert fix.position_covariance.reshape(3, 3)[:2, :2] == pytest.approx(pose[:2, :2])

    forces, turns = FLU @ vector(sample.linear_acceleration), FLU @ vector(sample.angular_velocity)
    assert [*forces, *turns] == imu
    assert sample.orientation_covariance[0] == -1.0
    ((_, att),) = found["/attitude"]
    phi, theta, heading = attitude(att.orientation)
    assert (phi, theta) == pytest.approx(tilt, abs=1e-7)
    assert same_angle(heading, psi), "the autopilot tells it from true north"
    assert att.linear_acceleration_covariance[0] == -1.0

    ((_, wrench),) = found["/disturbance"]
    assert (wrench.wrench.force.x, -wrench.wrench.force.y, -wrench.wrench.torque.z) == push
    ((_, pulses),), ((_, cell),) = found["/servo_output"], found["/battery"]
    assert pulses.data.tolist() == pwm
    assert cell.voltage == pytest.approx(battery[0], rel=1e-6)
    for told, logged, factor in ((cell.current, battery[1], -1.0), (cell.percentage, battery[2], 0.01)):
        assert math.isnan(told) if logged is None else told == pytest.approx(logged * factor, rel=1e-6, abs=1e-30)
    ((_, line),), ((_, tag),) = found["/rosout"], found["/uwb/position"]
    assert (line.level, line.msg) == (line.ERROR, text)
    assert _site_place(vector(tag.point), turn) == pytest.approx(place, abs=1e-8)
    assert tag.point.z == 1.5


IMU = ("ax_m_s2", "ay_m_s2", "az_m_s2", "p_rad_s", "q_rad_s", "r_rad_s")


def _site_place(enu: np.ndarray, turn: float) -> tuple[float, float]:
    """(north, east) in site axes of a place on the map: first to NED, then back by the site's turn about down."""
    north, east, _ = Rotation.from_euler("z", turn).inv().apply(ENU_FROM_NED.T @ enu)
    return north, east


@pytest.fixture(scope="module")
def log(tmp_path_factory) -> Path:
    return page_log(tmp_path_factory.mktemp("ros"))


def run(*argv: object) -> int:
    return exit_code("log", "export", *argv)


def test_a_log_of_the_simulator_with_its_truth(log, tmp_path, capsys):
    truth = record_run(tmp_path / "truth.mcap", [x for x in simulated() if isinstance(x, m.GroundTruth)])
    out = tmp_path / "bag"
    assert run(log, "--rosbag2", "--out", out, "--truth", truth) == 0
    found, logged, vessel = bag(out), LogFile(log), setup_in(LogFile(log)).pilot.vessel
    total = sum(map(len, found.values()))
    assert f"wrote {out}: {total} messages" in capsys.readouterr().out.replace("\n", "")
    leases = [x for x in logged.messages(m.OverrideLease) if isinstance(x, m.OverrideLease)]
    assert [p.data.tolist() for _, p in found["/pwm"]] == [list(x.pwm_us) for x in leases]
    wrenches = np.array([(w.wrench.force.x, w.wrench.force.y, w.wrench.torque.z) for _, w in found["/thrust"]])
    asked = np.array([x.f_command_n for x in leases]) @ configuration_matrix(vessel).T
    np.testing.assert_allclose(wrenches, asked @ FLU, atol=1e-12)
    assert np.abs(wrenches).max() > 1.0
    ranges = [r.range_m for x in logged.messages(m.UwbRanges) for r in x.ranges if r.anchor == "0CA8"]
    assert [x.data for _, x in found["/uwb/range_0CA8"]] == ranges
    assert len(found["/ground_truth"]) == sum(isinstance(x, m.GroundTruth) for x in simulated())
    assert [x.data for _, x in found["/mode"]] == [x.mode for x in logged.messages(m.ModeStatus)]
    ((_, path),) = found["/path"]
    corners = setup_in(logged).pilot.mission.path.waypoints
    assert [(p.pose.position.y, p.pose.position.x) for p in path.poses] == [(w.north_m, w.east_m) for w in corners]
    known = sum(x.health in ("healthy", "degraded") for x in logged.messages(m.StateEstimate))
    assert len(found["/odometry"]) == len(found["/fix"]) == known > 0


def test_links_are_diagnostics_and_words_of_the_autopilot_are_log_lines(tmp_path):
    log = record(
        tmp_path / "t.mcap",
        m.LinkStatus(t_ns=1, link="uwb", state="lost", reason="no bytes for 3 s"),
        m.StatusText(t_ns=2, severity=4, text="EKF failsafe"),
        m.NewMission(t_ns=3, name="x", waypoints=(m.MissionPoint(north_m=1.0, east_m=2.0),)),
        site=None,
    )
    rosbag2.write(log, tmp_path / "bag")
    found = bag(tmp_path / "bag")
    (status,) = found["/diagnostics"][0][1].status
    assert (status.level, status.name, status.message) == (status.ERROR, "link uwb", "no bytes for 3 s")
    line = found["/rosout"][0][1]
    assert (line.level, line.name, line.msg) == (line.WARN, "autopilot", "EKF failsafe")
    (pose,) = found["/path"][0][1].poses
    assert (pose.pose.position.x, pose.pose.position.y) == (2.0, 1.0)


def test_without_a_site_there_is_no_fix_and_a_lost_boat_has_no_odometry(tmp_path):
    estimate = next(x for x in simulated() if isinstance(x, m.StateEstimate) and x.health == "healthy")
    lost = next(x for x in simulated() if isinstance(x, m.StateEstimate) and x.health == "initialising")
    log = record(tmp_path / "t.mcap", lost, estimate, site=None)
    rosbag2.write(log, tmp_path / "bag")
    found = bag(tmp_path / "bag")
    assert len(found["/odometry"]) == 1
    assert "/fix" not in found


def test_a_site_that_this_version_refuses_turns_nothing_silently(tmp_path):
    log = record(tmp_path / "t.mcap", m.Tick(t_ns=0, index=0), site="schema = 99")
    with pytest.raises(ConfigError, match=r"t\.mcap: site\.toml"):
        rosbag2.write(log, tmp_path / "bag")
    assert not (tmp_path / "bag").exists()


def test_a_vessel_file_that_this_version_refuses_leaves_out_the_path_and_says_so(tmp_path, capsys):
    newer = record_run(tmp_path / "newer.mcap", simulated()[:50], vessel=lambda text: "schema = 99\n" + text)
    assert run(newer, "--rosbag2", "--out", tmp_path / "bag") == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "no path and no forces" in told and "vessel.toml" in told
    assert "/path" not in bag(tmp_path / "bag")


def test_a_number_beyond_what_ros_holds_is_left_out_and_told(tmp_path, capsys):
    log = record(
        tmp_path / "t.mcap", m.Battery(t_ns=1, voltage_v=1e300), m.ServoOutput(t_ns=2, pwm_us=(-5, 70_000, 2**62))
    )
    assert run(log.path, "--rosbag2", "--out", tmp_path / "bag") == 0
    assert "1 left out" in capsys.readouterr().out
    found = bag(tmp_path / "bag")
    assert set(found) == {"/servo_output"}
    assert found["/servo_output"][0][1].data.tolist() == [0, 65535, 65535]


def test_a_folder_that_is_there_stays_as_it_is(log, tmp_path, capsys):
    out = tmp_path / "mine"
    out.mkdir()
    assert run(log, "--rosbag2", "--out", out) == 2
    assert "mine: exists already" in capsys.readouterr().err
    assert list(out.iterdir()) == []
