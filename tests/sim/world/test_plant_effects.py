"""Each effect that an extended vessel file can hold, in the plant, against equations written here in numpy."""

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.integrate import solve_ivp

from companion.core.configuration.vessel_file import Wash
from companion.core.model.manoeuvring import mass_matrix
from companion.core.model.thrusters import force_from_pwm
from sim.world.environment import Moment
from sim.world.plant import Motion, Plant
from sim.world.sensors import ImuSensor, UwbFaults, UwbSensor
from sim.world.world import STEP_NS, World, WorldSetup
from tests.support.drive_fixture import setup
from tests.support.vessel_fixtures import boat

BASE = boat("aritra")
BASE = replace(BASE, hull=replace(BASE.hull, frontal_area_m2=0.0, lateral_area_m2=0.0))  # no air
SITE = setup().pilot.site
STILL = Moment(0.0, 0.0, 0.0, 0.0, np.zeros(3), 0.0, 0.0)
X0 = (1.0, 2.0, 0.5, 0.4, -0.1, 0.2)
PWM = (1640.0, 1600.0, 1420.0, 1630.0)
WASH = {"behind": "rear_starboard", "ahead": "front_starboard", "share": 0.5}


class Stiff(Plant):
    """A boat on a pack without inner resistance."""

    @property
    def current_a(self):
        return 0.0


def propelled(**keys):
    return replace(BASE, propulsion=replace(BASE.propulsion, **keys))


def having(**terms):
    return replace(BASE, terms={name: {**p, "source": "test"} for name, p in terms.items()})


def geared(*gains):
    return replace(BASE, thrusters=tuple(replace(t, gain=g) for t, g in zip(BASE.thrusters, gains, strict=True)))


def by_hand(seconds, *, gains=(1, 1, 1, 1), k_munk=0.0, tether=None, zone=None, advance=0.0, wash=0.0, slew=np.inf):
    """State after some seconds of PWM at 15.6 V."""
    i, d = BASE.inertia, BASE.damping
    M = mass_matrix(BASE)
    asked = np.array([g * force_from_pwm(t, BASE.force_maps["t200"], pwm, 15.6)
                      for g, t, pwm in zip(gains, BASE.thrusters, PWM, strict=True)])  # fmt: skip
    a = np.deg2rad([t.azimuth_deg for t in BASE.thrusters])
    px, py = np.array([t.x_m for t in BASE.thrusters]), np.array([t.y_m for t in BASE.thrusters])

    def rate(_t, x):
        (n, e, psi, u, v, r), f = x[:6], x[6:]
        g = f - advance * np.sqrt(np.abs(f)) * ((u - r * py) * np.cos(a) + (v + r * px) * np.sin(a))
        g[3] *= 1 - wash * max(f[1], 0.0) / 38.0
        tau = np.array([g @ np.cos(a), g @ np.sin(a), g @ (px * np.sin(a) - py * np.cos(a))])
        tau[2] += k_munk * u * v
        c, s = np.cos(psi), np.sin(psi)
        if tether:
            away = np.array([tether[0] - n, tether[1] - e])
            stretch = max(np.hypot(*away) - tether[2], 0.0)
            pull = tether[3] * stretch * away / np.hypot(*away)
            tau[:2] += c * pull[0] + s * pull[1], c * pull[1] - s * pull[0]
        p = M @ [u, v, r]
        drag = np.array([d.X_u_N_s_m * u + d.X_uu_N_s2_m2 * abs(u) * u,
                         d.Y_v_N_s_m * v + d.Y_r_N_s * r + d.Y_vv_N_s2_m2 * abs(v) * v,
                         d.N_v_N_s * v + d.N_r_N_m_s * r + d.N_rr_N_m_s2 * abs(r) * r])  # fmt: skip
        if zone:
            far = np.hypot(n - zone[0], e - zone[1])
            drag *= 1 + zone[3] / (1 + np.exp((far - zone[2]) / 0.5))
        nu_dot = np.linalg.solve(M, tau + drag - [-p[1] * r, p[0] * r, p[1] * u - p[0] * v])
        f_dot = np.clip((asked - f) / BASE.propulsion.lag_s, -slew, slew)
        return np.concatenate([[c * u - s * v, s * u + c * v, r], nu_dot, f_dot])

    assert i.mass_kg == 45.0
    start = np.concatenate([X0, np.zeros(4)])
    return solve_ivp(rate, (0, seconds), start, rtol=1e-8, atol=1e-9, max_step=0.02).y[:, -1]


CASES = {
    "dead": (geared(0, 1, 1, 1), {"gains": (0, 1, 1, 1)}),
    "reversed": (geared(1, 1, -1, 1), {"gains": (1, 1, -1, 1)}),
    "munk": (having(munk_moment={"k_kg": 30.0}), {"k_munk": 30.0}),
    "tether": (having(tether={"north_m": 0.0, "east_m": 0.0, "slack_m": 2.0, "stiffness_N_m": 5.0}),
               {"tether": (0.0, 0.0, 2.0, 5.0)}),
    "zone": (having(shallow_zone={"north_m": 1.5, "east_m": 2.0, "radius_m": 1.0, "share": 2.0}),
             {"zone": (1.5, 2.0, 1.0, 2.0)}),
    "advance": (propelled(advance_loss_sqrt_N_s_m=0.8), {"advance": 0.8}),
    "wash": (propelled(wash=(Wash(**WASH),)), {"wash": 0.5}),
    "slew": (propelled(slew_N_s=6.0), {"slew": 6.0}),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_the_plant_moves_as_the_equations_say(case):
    """6 s from a moving start, dead time over; and by more than a rounding differently from the plain boat."""
    vessel, told = CASES[case]
    p = Stiff(vessel, np.array(X0), step_ns=STEP_NS, voltage_v=15.6)
    p.command(-(10**9), PWM)
    for _ in range(600):
        p.step(STILL)
    assert p.motion.x == pytest.approx(by_hand(6.0, **told), abs=2e-4)
    assert np.abs(p.motion.x - by_hand(6.0))[:6].max() > 0.02


def test_the_plain_boat_costs_no_more():
    """Instructions of the plant's function: none is there for effects that the file does not have."""
    sizes = {case: Plant(v, np.array(X0), step_ns=STEP_NS, voltage_v=15.6).function.n_instructions()
             for case, (v, _) in CASES.items()}  # fmt: skip
    plain = Plant(BASE, np.array(X0), step_ns=STEP_NS, voltage_v=15.6).function.n_instructions()
    assert sizes["dead"] == plain < min(sizes[case] for case in ("munk", "tether", "zone", "advance", "wash", "slew"))


EXACT = {
    "accel_sigma_m_s2": 1e-12, "accel_bias_sigma_m_s2": 0.0, "accel_bias_walk_m_s2_sqrt_s": 0.0,
    "gyro_sigma_rad_s": 1e-12, "gyro_bias_sigma_rad_s": 0.0, "gyro_bias_walk_rad_s_sqrt_s": 0.0,
    "heading_sigma_rad": 1e-12, "heading_wander_sigma_rad": 0.0, "x_m": 0.0,
}  # fmt: skip


def test_the_simulated_imu_errs_as_the_file_says():
    """At psi = 0.7, r = 0.5, nu_dot = (0.2, -0.1, 0): its axes turned by 0.1, and the rest."""
    errors = {"misalignment_rad": 0.1, "accel_bias_x_m_s2": 0.05, "accel_bias_y_m_s2": -0.02, "gyro_scale": 0.04,
              "gyro_bias_rad_s": 0.01, "heading_offset_rad": 0.06, "hard_iron_cos_rad": 0.02,
              "hard_iron_sin_rad": -0.03}  # fmt: skip
    sensor = ImuSensor(replace(BASE.sensors.imu, **EXACT, **errors), np.random.default_rng(0))
    reading = sensor.measure(Motion(0, np.array([0, 0, 0.7, 0, 0, 0.5, 0, 0, 0, 0]), np.array([0.2, -0.1, 0.0])), STILL)
    c, s = np.cos(0.1), np.sin(0.1)
    assert reading.accel_m_s2[:2] == pytest.approx((c * 0.2 - s * 0.1 + 0.05, -s * 0.2 - c * 0.1 - 0.02))
    assert reading.gyro_rad_s == pytest.approx((0, 0, 1.04 * 0.5 + 0.01), abs=1e-9)
    assert reading.psi_rad == pytest.approx(0.76 + 0.02 * np.cos(0.7) - 0.03 * np.sin(0.7))


def test_the_simulated_tag_appears_where_the_file_says_and_its_bytes_come_later_and_later():
    uwb = replace(BASE.sensors.uwb, scale=0.02, clock_drift_s_s=0.001, x_m=0.0, range_sigma_m=1e-9,
                  range_bias_sigma_m=0.0)  # fmt: skip
    sensor = UwbSensor(uwb, SITE.anchors, UwbFaults(), np.random.default_rng(0))
    ranges = sensor.measure(Motion(0, np.array([12.0, 8.0, 0.3, 0, 0, 0, 0, 0, 0, 0]), np.zeros(3)))
    fix = sensor.fix(ranges)
    assert fix is not None and fix[:2] == pytest.approx((8.16, 12.24), abs=1e-5)
    assert [sensor.arrival_ns(7 + s * 10**9) - s * 10**9 - 7 for s in (0, 10, 100)] == [80e6, 90e6, 180e6]


def test_the_worlds_tag_drifts():
    vessel = replace(BASE, sensors=replace(BASE.sensors, uwb=replace(BASE.sensors.uwb, clock_drift_s_s=0.01)))
    world = World(WorldSetup(vessel, SITE, boot_ns=5 * 10**9), seed=1)
    sent = []
    for _ in range(2050):
        before = len(world.in_flight)  # what waits to arrive
        world.step()
        if len(world.in_flight) > before:
            sent.append((world.in_flight[-1][0] - world.t_ns) * 1e-9)
    assert np.diff(sent) == pytest.approx(0.01, abs=2e-4) and sent[0] == pytest.approx(0.08)
