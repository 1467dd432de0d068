"""Our messages -> the standard messages of ROS 2, in its frames (`geometry.rep103`). rosbags: extra `analysis`.

    /imu/data_raw  sensor_msgs/Imu           specific force and rates at the IMU; no orientation
    /attitude      sensor_msgs/Imu           the autopilot's orientation and rates; no acceleration
    /odometry      nav_msgs/Odometry         the estimate, `map` to `base_link`, while the boat knows its place
    /fix           sensor_msgs/NavSatFix     the same on the earth, altitude 0
    /ground_truth  nav_msgs/Odometry         the simulator's, with --truth
    /reference     geometry_msgs/PoseStamped what guidance asks for;  /path  nav_msgs/Path  the mission
    /thrust        geometry_msgs/WrenchStamped  of the thruster forces that were commanded
    /disturbance   geometry_msgs/WrenchStamped  as estimated
    /pwm, /servo_output, /rc_channels        std_msgs/UInt16MultiArray [us]
    /battery       sensor_msgs/BatteryState
    /uwb/range_ID  std_msgs/Float64 [m];  /uwb/position  geometry_msgs/PointStamped;  /gnss/fix  sensor_msgs/NavSatFix
    /mode          std_msgs/String;  /rosout  rcl_interfaces/Log;  /diagnostics  diagnostic_msgs/DiagnosticArray: links

A covariance of zeros says "unknown", one that begins with -1 "not measured", as the messages' definitions have it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from rosbags.typesys.stores import ros2_humble as ros

from companion.core.geometry.frames import Origin, geodetic_from_site
from companion.core.geometry.rep103 import FLU_FROM_FRD, flu, map_from_site, orientation
from companion.core.guidance.path import Waypoint
from companion.core.messages import (
    Alert,
    Attitude,
    Battery,
    GroundTruth,
    GuidanceReference,
    ImuSample,
    LinkStatus,
    Message,
    MissionPoint,
    ModeStatus,
    NewMission,
    OverrideLease,
    RcChannels,
    ServoOutput,
    StateEstimate,
    StatusText,
    UwbPosition,
    UwbRanges,
)
from companion.core.messages.sensors import GnssFix
from companion.logs.series import KNOWN

MAP, BODY, IMU = "map", "base_link", "imu"
PLANAR = np.ix_((0, 1, 5), (0, 1, 5))
"""Where x, y and yaw stand in a covariance of [x y z roll pitch yaw]."""
UNKNOWN = np.zeros(9)
NOT_MEASURED = np.array([-1.0] + [0.0] * 8)
ALERT_LEVELS = {"info": 20, "warning": 30, "error": 40}  # rcl_interfaces/Log
STATUS_LEVELS = (50, 50, 50, 40, 30, 20, 20, 10)  # by MAV_SEVERITY
LINK_LEVELS = {"online": 0, "searching": 1, "lost": 2, "stale": 3}  # diagnostic_msgs/DiagnosticStatus
Told = Iterable[tuple[str, Any]]


@dataclass(frozen=True)
class RosMessages:
    """What the messages of one log become. `origin`: None: there is no /fix, and the site's axes are taken as true;
    `B`: forces -> [X Y N], shape (3, n); None: there is no /thrust.
    """

    wall_offset_ns: int
    origin: Origin | None = None
    B: np.ndarray | None = None

    def see(self, message: Message) -> Told:
        """(topic, ROS message) for each that a message of ours becomes."""
        told = _SEE.get(type(message))
        return told(self, message) if told else ()

    def path(self, waypoints: Sequence[MissionPoint | Waypoint], t_ns: int) -> Told:
        """The mission; its poses point along the site's first axis: nothing is asked for."""
        poses = [self._pose_stamped(t_ns, w.north_m, w.east_m, 0.0) for w in waypoints]
        yield "/path", ros.nav_msgs__msg__Path(self._header(t_ns, MAP), poses)

    # --- frames ------------------------------------------------------------------------------------

    @property
    def _turn(self) -> float:
        return self.origin.rotation_rad if self.origin else 0.0

    def _time(self, t_ns: int) -> Any:
        return ros.builtin_interfaces__msg__Time(*divmod(t_ns + self.wall_offset_ns, 1_000_000_000))

    def _header(self, t_ns: int, frame: str) -> Any:
        return ros.std_msgs__msg__Header(self._time(t_ns), frame)

    def _point(self, north_m: float, east_m: float, up_m: float = 0.0) -> Any:
        x, y, _ = map_from_site(self._turn) @ (north_m, east_m, 0.0)
        return ros.geometry_msgs__msg__Point(float(x), float(y), up_m)

    def _pose(self, north_m: float, east_m: float, psi_rad: float) -> Any:
        turned = ros.geometry_msgs__msg__Quaternion(*orientation(0.0, 0.0, psi_rad + self._turn))
        return ros.geometry_msgs__msg__Pose(self._point(north_m, east_m), turned)

    def _pose_stamped(self, t_ns: int, north_m: float, east_m: float, psi_rad: float) -> Any:
        return ros.geometry_msgs__msg__PoseStamped(self._header(t_ns, MAP), self._pose(north_m, east_m, psi_rad))

    def _wrench(self, t_ns: int, xyn: Sequence[float] | np.ndarray) -> Any:
        x, y, n = (float(v) for v in FLU_FROM_FRD @ xyn)
        wrench = ros.geometry_msgs__msg__Wrench(_vector((x, y, 0.0)), _vector((0.0, 0.0, n)))
        return ros.geometry_msgs__msg__WrenchStamped(self._header(t_ns, BODY), wrench)

    # --- what comes in -----------------------------------------------------------------------------

    def _imu(self, m: ImuSample) -> Told:
        rates, force = flu((m.p_rad_s, m.q_rad_s, m.r_rad_s)), flu((m.ax_m_s2, m.ay_m_s2, m.az_m_s2))
        nowhere = ros.geometry_msgs__msg__Quaternion(0.0, 0.0, 0.0, 1.0)
        head = self._header(m.t_ns, IMU)
        yield "/imu/data_raw", _imu(head, nowhere, NOT_MEASURED, rates, force, UNKNOWN)

    def _attitude(self, m: Attitude) -> Told:
        """The autopilot's heading is from true north already, not from the site's first axis."""
        if not math.isfinite(m.psi_rad):
            return
        turned = ros.geometry_msgs__msg__Quaternion(*orientation(m.phi_rad, m.theta_rad, m.psi_rad))
        rates = flu((m.p_rad_s, m.q_rad_s, m.r_rad_s))
        yield "/attitude", _imu(self._header(m.t_ns, BODY), turned, UNKNOWN, rates, (0.0,) * 3, NOT_MEASURED)

    def _estimate(self, m: StateEstimate) -> Told:
        if m.health in KNOWN and len(m.covariance) == 36:
            covariance = np.reshape(m.covariance, (6, 6))
            yield "/odometry", self._odometry(m, covariance)
            if self.origin:
                yield "/fix", self._fix(m, covariance)
        if len(m.disturbance_n) == 3:
            yield "/disturbance", self._wrench(m.t_ns, m.disturbance_n)

    def _truth(self, m: GroundTruth) -> Told:
        yield "/ground_truth", self._odometry(m, np.zeros((6, 6)))

    def _odometry(self, m: StateEstimate | GroundTruth, covariance: np.ndarray) -> Any:
        pose, twist, site = np.zeros((6, 6)), np.zeros((6, 6)), map_from_site(self._turn)
        pose[PLANAR] = site @ covariance[:3, :3] @ site.T
        twist[PLANAR] = FLU_FROM_FRD @ covariance[3:, 3:] @ FLU_FROM_FRD
        u, v, r = m.u_m_s, -m.v_m_s, -m.r_rad_s
        return ros.nav_msgs__msg__Odometry(
            self._header(m.t_ns, MAP),
            BODY,
            ros.geometry_msgs__msg__PoseWithCovariance(self._pose(m.north_m, m.east_m, m.psi_rad), pose.ravel()),
            ros.geometry_msgs__msg__TwistWithCovariance(
                ros.geometry_msgs__msg__Twist(_vector((u, v, 0.0)), _vector((0.0, 0.0, r))), twist.ravel()
            ),
        )

    def _fix(self, m: StateEstimate, covariance: np.ndarray) -> Any:
        assert self.origin
        site, full = map_from_site(self._turn)[:2, :2], np.zeros((3, 3))
        full[:2, :2] = site @ covariance[:2, :2] @ site.T
        kind = ros.sensor_msgs__msg__NavSatFix
        fixed = ros.sensor_msgs__msg__NavSatStatus(ros.sensor_msgs__msg__NavSatStatus.STATUS_FIX, 0)
        latitude, longitude = geodetic_from_site(self.origin, m.north_m, m.east_m)
        head, how = self._header(m.t_ns, BODY), kind.COVARIANCE_TYPE_APPROXIMATED
        return kind(head, fixed, latitude, longitude, 0.0, full.ravel(), how)

    def _reference(self, m: GuidanceReference) -> Told:
        yield "/reference", self._pose_stamped(m.t_ns, m.north_ref_m, m.east_ref_m, m.psi_ref_rad)

    def _mission(self, m: NewMission) -> Told:
        return self.path(m.waypoints, m.t_ns)

    def _lease(self, m: OverrideLease) -> Told:
        yield "/pwm", _pulses(m.pwm_us)
        if self.B is not None and len(m.f_command_n) == self.B.shape[1]:
            yield "/thrust", self._wrench(m.t_ns, self.B @ m.f_command_n)

    def _servos(self, m: ServoOutput) -> Told:
        yield "/servo_output", _pulses(m.pwm_us)

    def _channels(self, m: RcChannels) -> Told:
        yield "/rc_channels", _pulses(m.pwm_us)

    def _battery(self, m: Battery) -> Told:
        current = math.nan if m.current_a is None else -m.current_a  # ROS: negative while it is drawn from
        share = math.nan if m.remaining_percent is None else m.remaining_percent / 100
        kind, nan = ros.sensor_msgs__msg__BatteryState, math.nan
        none, head = np.zeros(0, np.float32), self._header(m.t_ns, BODY)
        kept = (nan, current, nan, nan, nan, share)
        yield "/battery", kind(head, m.voltage_v, *kept, 0, 0, 0, True, none, none, "", "")

    def _ranges(self, m: UwbRanges) -> Told:
        for one in m.ranges:
            yield (
                "/uwb/range_" + re.sub(r"\W", "_", one.anchor, flags=re.ASCII),
                ros.std_msgs__msg__Float64(one.range_m),
            )

    def _position(self, m: UwbPosition) -> Told:
        point = self._point(m.y_m, m.x_m, m.z_m)  # the tag's own axes: x east, y north of the site
        yield "/uwb/position", ros.geometry_msgs__msg__PointStamped(self._header(m.t_ns, MAP), point)

    def _gnss(self, m: GnssFix) -> Told:
        fixed = m.fix_type >= 3  # status 2: with ground-based corrections; service 1: GPS, at least
        status = ros.sensor_msgs__msg__NavSatStatus((2 if m.fix_type >= 4 else 0) if fixed else -1, 1)
        variance, kind = (m.h_acc_m or 0.0) ** 2, 1 if m.h_acc_m else 0  # approximated, or unknown
        covariance = np.diag([variance, variance, 0.0]).ravel()
        head = self._header(m.t_ns, BODY)
        yield (
            "/gnss/fix",
            ros.sensor_msgs__msg__NavSatFix(head, status, m.lat_deg, m.lon_deg, math.nan, covariance, kind),
        )

    def _mode(self, m: ModeStatus) -> Told:
        yield "/mode", ros.std_msgs__msg__String(m.mode)

    def _alert(self, m: Alert) -> Told:
        yield (
            "/rosout",
            ros.rcl_interfaces__msg__Log(self._time(m.t_ns), ALERT_LEVELS[m.level], "aritra", m.text, "", "", 0),
        )

    def _status_text(self, m: StatusText) -> Told:
        level = STATUS_LEVELS[min(max(m.severity, 0), 7)]
        yield "/rosout", ros.rcl_interfaces__msg__Log(self._time(m.t_ns), level, "autopilot", m.text, "", "", 0)

    def _link(self, m: LinkStatus) -> Told:
        level, name = LINK_LEVELS[m.state], f"link {m.link}"
        status = ros.diagnostic_msgs__msg__DiagnosticStatus(level, name, m.reason or m.state, "aritra", [])
        yield "/diagnostics", ros.diagnostic_msgs__msg__DiagnosticArray(self._header(m.t_ns, ""), [status])


_SEE: dict[type[Message], Callable[[RosMessages, Any], Told]] = {
    ImuSample: RosMessages._imu,
    Attitude: RosMessages._attitude,
    StateEstimate: RosMessages._estimate,
    GroundTruth: RosMessages._truth,
    GuidanceReference: RosMessages._reference,
    NewMission: RosMessages._mission,
    OverrideLease: RosMessages._lease,
    ServoOutput: RosMessages._servos,
    RcChannels: RosMessages._channels,
    Battery: RosMessages._battery,
    UwbRanges: RosMessages._ranges,
    UwbPosition: RosMessages._position,
    GnssFix: RosMessages._gnss,
    ModeStatus: RosMessages._mode,
    Alert: RosMessages._alert,
    StatusText: RosMessages._status_text,
    LinkStatus: RosMessages._link,
}


def _vector(xyz: Sequence[float]) -> Any:
    return ros.geometry_msgs__msg__Vector3(*xyz)


def _imu(head: Any, turned: Any, how: np.ndarray, rates: Sequence[float], force: Sequence[float], known: np.ndarray):
    return ros.sensor_msgs__msg__Imu(head, turned, how, _vector(rates), UNKNOWN, _vector(force), known)


def _pulses(pwm_us: Sequence[int]) -> Any:
    layout = ros.std_msgs__msg__MultiArrayLayout([], 0)
    return ros.std_msgs__msg__UInt16MultiArray(layout, np.clip(pwm_us, 0, 65535).astype(np.uint16))
