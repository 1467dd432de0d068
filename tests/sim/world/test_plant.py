"""The plant against physics: energy, drift, an integration written by hand, and the thrusters' timing."""

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.integrate import solve_ivp

from companion.core.model.manoeuvring import mass_matrix
from companion.core.model.thrusters import force_from_pwm
from sim.world.environment import Environment, Moment, Weather
from sim.world.plant import HOTEL_A, R_BATTERY_OHM, Plant, perturbed
from sim.world.world import STEP_NS
from tests.support.vessel_fixtures import boat

STILL = Moment(0.0, 0.0, 0.0, 0.0, np.zeros(3), 0.0, 0.0)
DT = STEP_NS * 1e-9
NEUTRAL = (1500.0,) * 4


def plant(x0=(0,) * 6, name="aritra", voltage_v=15.6):
    return Plant(boat(name), np.array(x0, dtype=float), step_ns=STEP_NS, voltage_v=voltage_v)


def flow(current_m_s=0.0, towards_deg=0.0, wind_m_s=0.0, from_deg=0.0, wave_n=(0, 0, 0)):
    return Moment(current_m_s, towards_deg, wind_m_s, from_deg, np.array(wave_n, dtype=float), 0.0, 0.0)


def energy(vessel, x):
    return 0.5 * x[3:6] @ mass_matrix(vessel) @ x[3:6]


@pytest.mark.parametrize("name", ["aritra", "twin", "cse1"])
@pytest.mark.parametrize("nu", [(1.5, 0, 0), (0, 0.8, 0), (0, 0, 2.0), (1.0, -0.6, 1.5), (-0.7, 0.5, -1.0)])
def test_without_thrust_in_still_water_energy_only_falls(name, nu):
    boat_, p = boat(name), plant((0, 0, 0.4, *nu), name)
    before = energy(boat_, p.motion.x)
    start = before
    for _ in range(1500):
        p.step(STILL)
        now = energy(boat_, p.motion.x)
        assert now <= before * (1 + 1e-12)
        before = now
    assert before < 0.1 * start


@pytest.mark.parametrize("name", ["aritra", "twin"])
@pytest.mark.parametrize(("speed", "towards_deg"), [(0.1, 0.0), (0.3, 130.0), (0.5, -90.0)])
@pytest.mark.long
def test_a_free_boat_drifts_with_the_current(name, speed, towards_deg):
    p = plant((0, 0, 1.0, 0, 0, 0), name)
    for _ in range(12_000):
        p.step(flow(speed, towards_deg))
    x = p.motion.x
    c, s = np.cos(x[2]), np.sin(x[2])
    over_ground = np.array([c * x[3] - s * x[4], s * x[3] + c * x[4]])
    beta = np.deg2rad(towards_deg)
    assert over_ground == pytest.approx(speed * np.array([np.cos(beta), np.sin(beta)]), abs=0.02 * speed)
    assert abs(x[5]) < 1e-3


class Stiff(Plant):
    """A boat on a pack without inner resistance."""

    @property
    def current_a(self):
        return 0.0


def by_hand(vessel, pwm_us, moment, voltage_v):
    """dx/dt of the same equations in numpy, component by component; dead time over."""
    i, d, h = vessel.inertia, vessel.damping, vessel.hull
    m, xg, yg = i.mass_kg, i.x_g_m, i.y_g_m
    m11, m22 = m - i.X_udot_kg, m - i.Y_vdot_kg
    m13, m23 = -m * yg, m * xg - i.Y_rdot_kg_m
    m33 = i.I_z_kg_m2 + m * (xg**2 + yg**2) - i.N_rdot_kg_m2
    M = np.array([[m11, 0, m13], [0, m22, m23], [m13, m23, m33]])
    f_cmd = np.array([force_from_pwm(t, vessel.force_maps[t.force_map], pwm, voltage_v)
                      for t, pwm in zip(vessel.thrusters, pwm_us, strict=True)])  # fmt: skip

    def rate(_t, x):
        psi, u, v, r, f = x[2], x[3], x[4], x[5], x[6:]
        c, s = np.cos(psi), np.sin(psi)
        beta_c = np.deg2rad(moment.beta_c_deg)
        vn, ve = moment.V_c_m_s * np.cos(beta_c), moment.V_c_m_s * np.sin(beta_c)
        uc, vc = c * vn + s * ve, -s * vn + c * ve
        ur, vr = u - uc, v - vc
        tau = np.zeros(3)
        for k, t in enumerate(vessel.thrusters):
            a = np.deg2rad(t.azimuth_deg)
            tau += f[k] * np.array([np.cos(a), np.sin(a), t.x_m * np.sin(a) - t.y_m * np.cos(a)])
        beta_w = np.deg2rad(moment.beta_w_deg)
        wn, we = -moment.V_w_m_s * np.cos(beta_w), -moment.V_w_m_s * np.sin(beta_w)
        urw, vrw = u - (c * wn + s * we), v - (-s * wn + c * we)
        q, gamma = 0.5 * 1.225 * (urw**2 + vrw**2), -np.arctan2(vrw, urw)
        tau += q * np.array([-0.7 * np.cos(gamma) * h.frontal_area_m2, 0.9 * np.sin(gamma) * h.lateral_area_m2,
                             0.1 * np.sin(2 * gamma) * h.lateral_area_m2 * h.length_m])  # fmt: skip
        c13 = -(m22 * vr + m23 * r)
        c23 = m11 * ur + m13 * r
        coriolis = np.array([c13 * r, c23 * r, -c13 * ur - c23 * vr])
        damping = np.array([
            -d.X_u_N_s_m * ur - d.X_uu_N_s2_m2 * abs(ur) * ur,
            -d.Y_v_N_s_m * vr - d.Y_r_N_s * r - d.Y_vv_N_s2_m2 * abs(vr) * vr,
            -d.N_v_N_s * vr - d.N_r_N_m_s * r - d.N_rr_N_m_s2 * abs(r) * r,
        ])  # fmt: skip
        nu_dot = np.linalg.solve(M, tau + moment.wave_n - coriolis - damping) + np.array([r * vc, -r * uc, 0.0])
        return np.concatenate([[c * u - s * v, s * u + c * v, r], nu_dot, (f_cmd - f) / vessel.propulsion.lag_s])

    return rate


@pytest.mark.parametrize(
    ("name", "pwm_us", "moment"),
    [
        ("aritra", (1600.0, 1570.0, 1450.0, 1640.0), STILL),
        ("aritra", (1400.0, 1600.0, 1600.0, 1400.0), flow(0.3, 200.0, 6.0, 75.0, (2.0, -3.0, 0.5))),
        ("twin", (1620.0, 1560.0), flow(0.2, -40.0, 4.0, 10.0)),
    ],
)
def test_the_plant_is_what_an_independent_integration_gives(name, pwm_us, moment):
    """10 s, dead time over at the start, on a pack that does not sag."""
    vessel, x0 = boat(name), (1.0, 2.0, 0.5, 0.4, -0.1, 0.2)
    p = Stiff(vessel, np.array(x0), step_ns=STEP_NS, voltage_v=15.6)
    p.command(-(10**9), pwm_us)
    for _ in range(1000):
        p.step(moment)
    start = np.concatenate([x0, np.zeros(len(pwm_us))])
    told = solve_ivp(by_hand(vessel, pwm_us, moment, 15.6), (0, 10), start, rtol=1e-9, atol=1e-10).y[:, -1]
    assert p.motion.x == pytest.approx(told, abs=2e-5)


@pytest.mark.parametrize("pwm_us", [1650.0, 1380.0])
def test_dead_time_and_lag_show_in_the_step_response(pwm_us):
    vessel, p = boat("aritra"), plant()
    forces = []
    for k in range(120):
        p.command(k * STEP_NS, NEUTRAL if k < 20 else (pwm_us,) * 4)
        forces.append(p.step(STILL).x[6])
    forces = np.abs(np.array(forces))
    first = int(np.flatnonzero(forces > 1e-9)[0])
    assert (first - 20) * DT == pytest.approx(vessel.propulsion.dead_time_s, abs=DT)
    shares = forces[first:] / forces[-1]
    at_63 = np.interp(1 - np.exp(-1), shares, (np.arange(len(shares)) + 1) * DT)
    assert at_63 == pytest.approx(vessel.propulsion.lag_s, abs=0.005)
    asked = force_from_pwm(vessel.thrusters[0], vessel.force_maps["t200"], pwm_us, p.voltage_v)
    assert forces[-1] == pytest.approx(abs(asked), rel=0.01)


@pytest.mark.parametrize("dead_time_s", [0.1, 0.1037, 0.0562, 0.0])
def test_a_dead_time_need_not_be_a_whole_number_of_steps(dead_time_s):
    """The force is that of its differential equation from the very instant at which the command acts."""
    vessel = boat("aritra")
    vessel = replace(vessel, propulsion=replace(vessel.propulsion, dead_time_s=dead_time_s))
    p = Stiff(vessel, np.zeros(6), step_ns=STEP_NS, voltage_v=15.6)
    p.command(0, NEUTRAL)
    p.command(2 * STEP_NS, (1650.0,) * 4)
    while p.motion.t_ns < 20 * STEP_NS:
        p.step(STILL)
    asked = force_from_pwm(vessel.thrusters[0], vessel.force_maps["t200"], 1650.0, 15.6)
    since_s = -vessel.propulsion.lag_s * np.log(1 - p.motion.x[6] / asked)
    assert p.motion.t_ns * 1e-9 - since_s - 0.02 == pytest.approx(dead_time_s, abs=1e-6)
    assert p.motion.t_ns == 20 * STEP_NS


def test_the_battery_sags_under_load():
    p = plant()
    p.command(0, (1900.0,) * 4)
    for _ in range(300):
        p.step(STILL)
    assert p.current_a > 30.0
    assert p.voltage_v == pytest.approx(15.6 - R_BATTERY_OHM * p.current_a, abs=1e-9)
    p.command(3 * 10**9, NEUTRAL)
    for _ in range(300):
        p.step(STILL)
    assert p.current_a == pytest.approx(HOTEL_A, abs=0.01)


def test_a_perturbed_boat_is_off_by_up_to_its_share_and_still_sound():
    vessel = boat("aritra")
    shares = []
    for seed in range(40):
        other = perturbed(vessel, np.random.default_rng(seed), 0.1)
        assert np.linalg.eigvalsh(mass_matrix(other)).min() > 0
        shares += [other.inertia.mass_kg / 45.0 - 1, other.damping.X_u_N_s_m / -3.5 - 1, other.thrusters[2].gain - 1]
    assert 0.08 < np.max(np.abs(shares)) <= 0.1 and abs(np.mean(shares)) < 0.02
    again = perturbed(vessel, np.random.default_rng(3), 0.1)
    assert again == perturbed(vessel, np.random.default_rng(3), 0.1) != vessel


def test_waves_push_to_and_fro_but_not_away():
    environment = Environment(Weather(H_s_m=0.1), np.random.default_rng(2))
    p = plant()
    for k in range(6000):
        p.step(environment.step(k * DT, DT))
    assert 0.001 < np.hypot(*p.motion.x[:2]) < 0.5
