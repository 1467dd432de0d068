"""Every number that the true boat and its surroundings may have. Defaults of effects: off.

SI, NED, body axes x forward, y starboard, z down; angles in degrees where the name says so, clockwise from north.
Times of the world count on the common clock, from the first row of train1.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, field

STEPS_HZ = 120  # steps of the integrator in a second: divides by 10 Hz commands, 20, 30, 40 Hz IMU, 1, 5, 10 Hz UWB
STEP_S = 1.0 / STEPS_HZ
BASIN_M = 30.0
MIDDLE_M = BASIN_M / 2
G = 9.80665
PWM_LIMITS = (1100.0, 1900.0)


@dataclass
class Hull:
    """Rigid body, added mass, damping with SNAME signs, and what the base leaves out."""

    length: float
    beam: float
    draft: float
    frontal: float
    lateral: float
    m: float
    I_z: float
    x_g: float
    y_g: float
    X_udot: float
    Y_vdot: float
    Y_rdot: float
    N_rdot: float
    X_u: float
    Y_v: float
    Y_r: float
    N_v: float
    N_r: float
    X_uu: float
    Y_vv: float
    N_rr: float
    cross_flow: float = 0.0  # C_d of extra strips
    cross_flow_aft: float = 1.0  # variant: the after half has this share of it
    munk: float = 0.0  # kg
    munk_fade: float = 0.0  # variant: over (1 + fade U)
    extra: tuple[float, float] = (0.0, 0.0)  # variant: share of damping more, exponent of speed


@dataclass
class Curve:
    """Speed of rotation over command: n = (V / V_ref)^(a0 + a1 e) (c1 e^q + c2 e^2)."""

    k: float
    a0: float
    a1: float
    q: float
    c1: float
    c2: float


@dataclass
class Thruster:
    """One thruster; `gain_small` is the variant's gain near zero command."""

    name: str
    x: float
    y: float
    azimuth_deg: float
    channel: int
    gain: float = 1.0
    trim_us: float = 0.0
    gain_small: float | None = None


@dataclass
class Fouling:
    """A loss that begins at `t_on` on the common clock and grows over `ramp` seconds; then comes and goes by `beat`."""

    index: int
    gain: float
    t_on: float
    ramp: float = 0.0
    beat: float = 0.0


@dataclass
class Drive:
    """Thrusters, ESCs, battery."""

    thrusters: list[Thruster]
    ahead: Curve
    astern: Curve
    V_ref: float
    V_nominal: float
    dead_band_us: float
    dead_time: float
    lag: float
    wire: list[int]
    common: float = 1.0
    astern_gain: float = 1.0
    astern_bend: float = 0.0  # variant: loss grows with command
    voltage_exponent: float = 0.0
    soft_us: float = 0.0  # variant: rounded dead band
    bend: tuple[float, float] = (0.0, 0.0)  # foreign: share more of a small command, ahead and astern
    quantum_us: float = 0.0  # foreign: steps in which the ESC reads a pulse
    lag_2: float = 0.0  # variant: a second lag
    jitter: float = 0.0  # variant: dead time of each command varies by this share of `dead_time`
    rate: float = math.inf
    rate_pwm: float = math.inf  # variant: slew of the command, us/s
    advance: float = 0.0
    advance_square: float = 0.0
    wash: float = 0.0
    wash_root: float = 0.0
    fouling: Fouling | None = None
    open_V: float = 16.2
    drop_V_Ah: float = 0.25
    R_ohm: float = 0.04
    watts_N15: float = 0.95
    hotel_A: float = 1.6


@dataclass
class Water:
    """Current, waves, wind, tether, bottom."""

    V_c: float = 0.0
    beta_c_deg: float = 0.0
    turn_deg_s: float = 0.0
    swing: tuple[float, float] = (0.0, 1.0)  # variant: amplitude [deg], period [s]
    shear: float = 0.0  # variant: share more per metre north of the middle
    V_w: float = 0.0
    beta_w_deg: float = 0.0
    c_wind: tuple[float, float, float] = (0.7, 0.9, 0.1)
    gustiness: float = 0.0
    gust_time: float = 10.0
    gust_square: float = 0.0  # variant: gusts switch on and off with this mean time
    ambient_V_c: tuple[float, float] = (0.0, 0.0)
    ambient_V_w: tuple[float, float] = (0.0, 0.0)
    ambient_N: tuple[float, float, float] = (0.0, 0.0, 0.0)
    wave_N: float = 0.0
    wave_T: float = 2.0
    wave_from_deg: float = 0.0
    wave_band: float = 0.08
    wave_second: float = 0.0  # variant: share of a second peak at 0.6 T
    tether_N_m: float = 0.0
    tether_at: tuple[float, float, float] = (0.0, 0.0, 0.0)  # north, east of the shore end; x of the boat's end
    tether_form: tuple[float, float] = (0.0, 0.0)  # variant: constant tension [N], slack [m]
    shallow: float = 0.0
    shallow_at: tuple[float, float, float] = (0.0, 0.0, 1.0)  # north, east, radius
    shallow_strip: bool = False  # variant: all that is south of `north`


@dataclass
class Sense:
    """IMU, attitude, UWB."""

    imu_x: float
    imu_y: float
    uwb_x: float
    uwb_y: float
    uwb_z: float
    latency: float
    imu_hz: float
    uwb_hz: float
    accel_sigma: float
    gyro_sigma: float
    heading_sigma: float
    wander: float
    wander_time: float
    uwb_sigma: float
    accel_bias: tuple[float, float] = (0.0, 0.0)
    accel_drift: float = 0.0  # variant: the bias changes by this share over 600 s
    accel_scale: tuple[float, float] = (1.0, 1.0)
    gyro_bias: float = 0.0
    gyro_drift: float = 0.0
    gyro_scale: float = 0.0
    heading_deg: float = 0.0
    iron_deg: float = 0.0
    iron_at_deg: float = 0.0
    soft_iron_deg: float = 0.0
    misalign_deg: float = 0.0
    scale: float = 0.0
    scale_north: float = 1.0  # variant: share of the scale that north sees
    warp_m: float = 0.0
    nlos: float = 0.0
    nlos_m: float = 0.8
    nlos_anchor: int = 0
    nlos_zone: bool = False  # variant: only in the anchor's quarter, four times as often
    drift: float = 0.0
    drift_late: bool = False  # variant: with the square of time
    odd_fixes: float = 0.0
    lost_fixes: float = 0.0
    tilt_sigma: float = 0.0007
    tilt_told: bool = True  # foreign: False where logs have no roll and pitch
    ahrs_s: float = 0.0  # foreign: time constant with which roll and pitch follow the specific force
    slow_fix_m: float = 0.0  # foreign: part of a fix's error that lasts `slow_fix_s`
    slow_fix_s: float = 1.0
    outage: tuple[float, float] = (0.0, 0.0)  # foreign: chance that one begins at a fix, mean length [s]


@dataclass
class Afloat:
    """Foreign: what a hull needs beside `Hull` to heave, roll and pitch. z down from the waterline."""

    z_g: float
    GM_T: float
    GM_L: float
    k_x: float  # radius of gyration in roll, added inertia in it
    k_y: float
    heave_N_m: float
    zeta: float  # damping over critical damping, of all three
    thrust_z: float
    drag_z: float
    sensor_z: tuple[float, float]  # IMU, tag


@dataclass
class Odd:
    """Effects outside the catalogue. Wall: [N]; interaction: [1]; swing of thrust: share, period; see outside.py."""

    wall: float = 0.0
    interaction: tuple[int, int, float] = (0, 0, 0.0)
    oscillation: tuple[float, float] = (0.0, 1.0)
    heading_drag: tuple[float, float] = (0.0, 0.0)
    backlash_us: float = 0.0
    magnet: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)  # deg, north, east, radius
    lift: float = 0.0
    gyre: float = 0.0
    throttle: tuple[float, float] = (0.0, 1e9)  # share lost per 100 N above, threshold [N]


@dataclass
class World:
    """One boat in its surroundings, as believed or as it is."""

    hull: Hull
    drive: Drive
    sense: Sense
    water: Water = field(default_factory=Water)
    odd: Odd = field(default_factory=Odd)
    afloat: Afloat | None = None  # None: motion in the horizontal plane

    def copy(self) -> World:
        """An independent copy."""
        return copy.deepcopy(self)

    @property
    def thruster_names(self) -> list[str]:
        """Names in order."""
        return [t.name for t in self.drive.thrusters]
