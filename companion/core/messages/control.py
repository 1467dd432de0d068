"""Messages that the program itself makes: ticks, orders, plans, estimates, leases, alerts. Conventions: `messages`."""

from __future__ import annotations

from typing import Literal

import msgspec

from companion.core.messages.sensors import Message, Vec

# --- inputs: the shell -----------------------------------------------------------------------------


class Tick(Message, frozen=True, kw_only=True):
    """The control period begins. `index` counts from 0; `lateness_ns` is how late the timer fired."""

    index: int
    lateness_ns: int = 0


class PlanDeadline(Message, frozen=True, kw_only=True):
    """Time is up for the plan of tick `index`: the lease must be written now."""

    index: int


class OperatorCommand(Message, frozen=True, kw_only=True):
    """What the operator wants. `start`: drive the mission; `excite`: fly the excitation; `hold`: keep station
    here; `manual`: drive by ManualInput; `stop`: neutral.
    """

    command: Literal["start", "excite", "hold", "manual", "stop"]


class ManualInput(Message, frozen=True, kw_only=True):
    """Sticks: shares of what the thrusters can give ahead, to starboard and clockwise, -1 to 1 each.

    `t_ns`: when they stood so, on the companion's clock; `source`: whose they are, in words.
    """

    surge: float
    sway: float
    yaw: float
    source: str


class MissionPoint(msgspec.Struct, frozen=True, kw_only=True):
    """A waypoint [m], site axes; speed of the leg that leads to it and its radius; None: the default."""

    north_m: float
    east_m: float
    speed_m_s: float | None = None
    acceptance_m: float | None = None


class NewMission(Message, frozen=True, kw_only=True):
    """A sound mission to drive instead of the one before. `end_heading_rad`: None: that of the last leg."""

    name: str
    waypoints: tuple[MissionPoint, ...]
    end_heading_rad: float | None = None


class PlanResult(Message, frozen=True, kw_only=True):
    """What the solver made of a SolveRequest. A result with a status, never an exception.

    `status`: ok | not_converged | failed. `f_n`: planned commands, N rows of n channels: thrusts [N], then angles of
    servos [rad]; `x`: planned states, N + 1 rows. Empty where the status is failed.
    """

    index: int
    status: Literal["ok", "not_converged", "failed"]
    reason: str
    solve_time_s: float
    iterations: int
    cost: float | None
    f_n: tuple[Vec, ...]
    x: tuple[Vec, ...]


# --- outputs ---------------------------------------------------------------------------------------

Health = Literal["initialising", "healthy", "degraded", "lost"]


class StateEstimate(Message, frozen=True, kw_only=True):
    """Pose of the body origin in NED, body velocities over ground, biases and disturbance.

    `covariance`: row-major 6 x 6 of [x y psi u v r]. `disturbance_n`: [X N, Y N, N N m] in body axes, in surge and sway
    their mean over 8 s, in yaw over some seconds where waves are.
    """

    north_m: float
    east_m: float
    psi_rad: float
    u_m_s: float
    v_m_s: float
    r_rad_s: float
    covariance: Vec
    accel_bias_m_s2: Vec
    gyro_bias_rad_s: float
    anchor_bias_m: dict[str, float]
    disturbance_n: Vec
    health: Health
    reason: str


class Innovation(Message, frozen=True, kw_only=True):
    """z - h(x) of one scalar or vector measurement, its covariance S (row-major), d2, and the verdict."""

    sensor: str
    innovation: Vec
    S: Vec
    d2: float
    accepted: bool


class GuidanceReference(Message, frozen=True, kw_only=True):
    """What guidance asks for now: leg, errors to it, references for heading and body velocities."""

    phase: Literal["idle", "leg", "station", "done"]
    leg: int
    waypoints_passed: int
    x_e_m: float
    y_e_m: float
    path_angle_rad: float
    psi_ref_rad: float
    u_ref_m_s: float
    north_ref_m: float
    east_ref_m: float


class ExcitationStatus(Message, frozen=True, kw_only=True):
    """How far the excitation is: on its way to the middle (`home`), in segment `segment` (from 0) of `segments`
    called `name` since `elapsed_s` (`fly`), or over: `done`, or `failed` where the middle was not reached.
    """

    phase: Literal["home", "fly", "done", "failed"]
    segment: int
    segments: int
    name: str
    elapsed_s: float


class SolveRequest(Message, frozen=True, kw_only=True):
    """One optimal control problem. `x0`: [x y psi u v r f_1..f_n]; `reference`: N + 1 rows.

    `disturbance_n`: constant body force [X N, Y N, N N m] over the horizon; `f_prev_n`: last command.
    """

    index: int
    x0: Vec
    reference: tuple[Vec, ...]
    disturbance_n: Vec
    f_prev_n: Vec


class OverrideLease(Message, frozen=True, kw_only=True):
    """PWM for a stated time, then neutral. Exactly one ends every tick.

    `pwm_us`: pulse widths of the thrusters in the vessel file's order, of the servos, then of channels that are held at
    neutral; `channels`: the RC channel (1-based) of each. `f_command_n`: thrusts [N], then angles of servos [rad].
    `source`: which step of the fallback ladder made it: plan | shifted_plan | pd | neutral; or the excitation,
    or the sticks (manual).
    """

    index: int
    channels: tuple[int, ...]
    pwm_us: tuple[int, ...]
    valid_for_s: float
    source: Literal["plan", "shifted_plan", "pd", "neutral", "excitation", "manual"]
    reason: str
    f_command_n: Vec


Mode = Literal["idle", "starting", "auto", "hold", "excitation", "paused", "locked", "manual", "safe"]
"""See companion.core.pilot.modes."""


class ModeStatus(Message, frozen=True, kw_only=True):
    """Mode of the boat, why it is in it or what it waits for, and whether the thrusters may turn.

    One at every change and one a second.
    """

    mode: Mode
    why: str
    driving: bool


class InterlockTrip(Message, frozen=True, kw_only=True):
    """The autopilot's parameters are such that nothing may start, and were not before; see `start_interlock`."""

    why: str


class Alert(Message, frozen=True, kw_only=True):
    """Something a person should know, and what to do next."""

    level: Literal["info", "warning", "error"]
    text: str


class VehicleRequest(Message, frozen=True, kw_only=True):
    """What the pilot asks of the autopilot. `custom_mode` goes with set_mode."""

    action: Literal["set_mode", "arm", "disarm"]
    custom_mode: int | None = None


# --- the shell's own notes --------------------------------------------------------------------------


class StepMark(Message, frozen=True, kw_only=True):
    """The `inputs` messages logged just before this one were one call of `pilot.step` at `t_ns`."""

    inputs: int


class LoopTiming(Message, frozen=True, kw_only=True):
    """How tick `index` went: lateness of its timer, and from the IMU bytes it planned from to its lease.

    `sent`: the lease went to an open port (whether anybody listens is in LinkStatus).
    """

    index: int
    lateness_ms: float
    imu_to_override_ms: float | None
    sent: bool = True


class ProcessStats(Message, frozen=True, kw_only=True):
    """Processor share since the last one [% of one core] and resident memory [MB = 1e6 bytes]."""

    cpu_percent: float
    rss_mb: float


# --- ground truth (written by the simulator only, never read by the boat) ---------------------------


class GroundTruth(Message, frozen=True, kw_only=True):
    """The simulated world's own state: NED pose, body velocities over ground, thruster forces [N], then
    angles of servos [rad].
    """

    north_m: float
    east_m: float
    psi_rad: float
    u_m_s: float
    v_m_s: float
    r_rad_s: float
    f_n: Vec
