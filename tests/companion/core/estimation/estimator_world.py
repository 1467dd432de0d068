"""A small world for the estimator: plant, disturbances and sensors in numpy, seeded.

It shares the model equations (companion.core.model.integrate) but none of the filter's code. The boat is steered on
truth along a square, a figure of eight or a circle, so that the estimator is judged, not a control loop.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np

from companion.core.configuration.imu_filters import PROVISIONED_HZ, low_pass_delay_s
from companion.core.configuration.site_file import Site, load_site
from companion.core.configuration.vessel_file import VesselFile
from companion.core.estimation.estimator import Estimator, EstimatorState
from companion.core.messages import AnchorRange, Attitude, ImuSample, Message, StateEstimate, UwbRanges
from companion.core.model.integrate import BufferedStep, DelayLine, step_function
from companion.core.model.manoeuvring import StructuredModel, coefficients
from sim.world.sitl.board import GYRO_DRIFT_RAD_S2
from tests.support.vessel_fixtures import boat

H_S = 0.01
G = 9.80665
SITE = Path(__file__).resolve().parents[4] / "deploy" / "sites" / "basin.toml"
LATE_S = low_pass_delay_s(PROVISIONED_HZ)
PATHS = ("square", "eight", "circle")


@cache
def basin() -> Site:
    return load_site(SITE.read_text(), name=SITE.name)


def plant_model(vessel: VesselFile, rng: np.random.Generator | None) -> StructuredModel:
    """Exact model, or one off by up to 10 % with a current of 0.1 m/s and 3 m/s of wind."""
    if rng is None:
        return StructuredModel.of(vessel)
    c = {k: v * rng.uniform(0.9, 1.1) for k, v in coefficients(vessel).items()}
    beta_c, beta_w = rng.uniform(-180, 180, 2)
    terms = {
        "current": {"V_c_m_s": 0.1, "beta_c_deg": beta_c},
        "wind": {"V_w_m_s": 3.0, "beta_w_deg": beta_w, "c_x": 0.7, "c_y": 0.9, "c_n": 0.1},
    }
    return StructuredModel(vessel, c, terms)


@dataclass
class Run:
    """Messages in order of arrival, commands, and the truth every 10 ms."""

    messages: list[Message]
    commands: list[tuple[int, tuple[float, ...]]]
    t_s: np.ndarray
    eta: np.ndarray
    nu: np.ndarray

    def truth(self, t_s: float) -> np.ndarray:
        i = min(round(t_s / H_S), len(self.t_s) - 1)
        return np.concatenate([self.eta[i], self.nu[i]])


def reference(path: str, t: float) -> tuple[float, float]:
    """Point to follow (north, east) [m], about 0.5 m/s within the basin."""
    if path == "circle":
        a = 0.5 / 6.0 * t
        return 15 + 6 * math.cos(a), 15 + 6 * math.sin(a)
    if path == "eight":
        a = 0.5 / 8.0 * t
        return 15 + 8 * math.sin(a), 15 + 5 * math.sin(2 * a)
    s = (0.5 * t) % 48
    side, along = int(s // 12), s % 12
    return [(9 + along, 9), (21, 9 + along), (21 - along, 21), (9, 21 - along)][side]


def steer(path: str, t: float, x: np.ndarray, B_pinv: np.ndarray) -> np.ndarray:
    """Force commands [N] that chase the reference point; heading towards it."""
    n, e = reference(path, t + 2.0)
    dn, de = n - x[0], e - x[1]
    psi_err = (math.atan2(de, dn) - x[2] + math.pi) % (2 * math.pi) - math.pi
    u_ref = min(0.7, 0.5 * math.hypot(dn, de)) * max(math.cos(psi_err), 0.0)
    tau = np.array([30 * (u_ref - x[3]) + 8 * u_ref, -15 * x[4], 12 * psi_err - 12 * x[5]])
    return np.clip(B_pinv @ tau, -20, 20)


def simulate(
    seed: int, *, disturbed: bool, seconds: float = 150.0, uwb_rate_Hz: float = 1.0, vessel: VesselFile | None = None
) -> Run:
    """One run of the world. `vessel`: the true boat, aritra where none is given; its calibration is not applied."""
    rng = np.random.default_rng(seed)
    vessel, path = vessel or boat("aritra"), PATHS[seed % 3]
    imu, uwb = vessel.sensors.imu, vessel.sensors.uwb
    model = plant_model(vessel, rng if disturbed else None)
    plant = BufferedStep(step_function(model, H_S))
    s, forces = ca.SX.sym("s", 6), ca.SX.sym("f", len(vessel.thrusters))
    tau = model.thrust(s[:3], s[3:], forces)
    nu_dot = BufferedStep(ca.Function("a", [s, forces], [model.nu_dot(s[:3], s[3:], tau)]))
    B_pinv, n = np.linalg.pinv(model.B), len(vessel.thrusters)
    x = np.zeros(6 + n)
    x[:3] = *reference(path, 0.0), rng.uniform(-math.pi, math.pi)
    delay = DelayLine(round(vessel.propulsion.dead_time_s * 1e9), (0.0,) * n)
    b_a, b_g = rng.normal(0, imu.accel_bias_sigma_m_s2, 2), np.array([0, 0, rng.normal(0, imu.gyro_bias_sigma_rad_s)])
    drift = GYRO_DRIFT_RAD_S2 * np.random.default_rng(seed).uniform(-1, 1, 3)
    wander = rng.normal(0, imu.heading_wander_sigma_rad)
    keep = math.exp(-H_S * 2 / imu.heading_wander_time_s)
    b_r = rng.normal(0, uwb.range_bias_sigma_m, len(basin().anchors))
    anchors = np.array([(a.north_m, a.east_m, a.down_m) for a in basin().anchors])
    phase = rng.uniform(0, 6, 2)
    timed: list[tuple[int, Message]] = []
    commands: list[tuple[int, tuple[float, ...]]] = []
    count = round(seconds / H_S)
    etas, nus = np.zeros((count, 3)), np.zeros((count, 3))
    uwb_every = round(1 / uwb_rate_Hz / H_S)
    for k in range(count):
        t_ns = k * round(H_S * 1e9)
        etas[k], nus[k] = x[:3], x[3:6]
        tilt, tilt_rate = 0.02 * np.sin(2.0 * k * H_S + phase), 0.04 * np.cos(2.0 * k * H_S + phase)
        if k % 10 == 0:
            f = tuple(steer(path, k * H_S, x, B_pinv).tolist())
            delay.push(t_ns, f)
            commands.append((t_ns, f))
        if k % 2 == 0:
            a = nu_dot(x[:6], x[6:])
            u, v, r = x[3:6]
            level = np.array([a[0] - v * r - imu.x_m * r**2, a[1] + u * r + imu.x_m * a[2]])
            wander = keep * wander + imu.heading_wander_sigma_rad * math.sqrt(1 - keep**2) * rng.normal()
            b_a = b_a + rng.normal(0, imu.accel_bias_walk_m_s2_sqrt_s * math.sqrt(0.02), 2)
            b_g[2] += rng.normal(0, imu.gyro_bias_walk_rad_s_sqrt_s * math.sqrt(0.02))
            b_g += drift * 0.02
            timed += _autopilot(rng, t_ns, level, r, x[2] + wander, (tilt, tilt_rate), b_a, b_g)
        if k % uwb_every == 0:
            c, sn = math.cos(x[2]), math.sin(x[2])
            tag = [x[0] + c * uwb.x_m - sn * uwb.y_m, x[1] + sn * uwb.x_m + c * uwb.y_m, uwb.z_m]
            d = np.sqrt(((np.array(tag) - anchors) ** 2).sum(axis=1)) + b_r
            d += rng.normal(0, uwb.range_sigma_m, len(d))
            timed.append(_cycle(t_ns + round(uwb.latency_s * 1e9), d))
        x = plant(x, delay.at(t_ns), np.zeros(3))
    timed.sort(key=lambda item: item[0])
    return Run([m for _, m in timed], commands, np.arange(count) * H_S, etas, nus)


def _autopilot(rng, t_ns, level, r, psi, tilt, b_a, b_g) -> list[tuple[int, Message]]:
    """IMU sample and attitude; the IMU feels gravity through roll and pitch. Both are stamped as late as an autopilot's
    filters make all but heading.
    """
    imu = boat("aritra").sensors.imu
    (phi, theta), (phi_dot, theta_dot) = tilt
    cp, sp, ct, st = math.cos(phi), math.sin(phi), math.cos(theta), math.sin(theta)
    up = np.array([[ct, sp * st, cp * st], [0, cp, -sp], [-st, sp * ct, cp * ct]])  # body -> level
    force = up.T @ np.array([level[0], level[1], -G])
    force[:2] += b_a
    force += rng.normal(0, imu.accel_sigma_m_s2, 3)
    gyro = r * ct * cp - theta_dot * sp + b_g[2] + rng.normal(0, imu.gyro_sigma_rad_s)
    p, q = np.array([phi_dot - r * st, theta_dot * cp + r * ct * sp]) + b_g[:2] + rng.normal(0, imu.gyro_sigma_rad_s, 2)
    heading = (psi + r * LATE_S + rng.normal(0, imu.heading_sigma_rad) + math.pi) % (2 * math.pi) - math.pi
    roll, pitch = tilt[0] + rng.normal(0, 0.002, 2)
    t_ns += round(LATE_S * 1e9)
    rx = t_ns + 5_000_000
    return [
        (rx, ImuSample(t_ns=t_ns, t_rx_ns=rx, ax_m_s2=force[0], ay_m_s2=force[1], az_m_s2=force[2],
                       p_rad_s=p, q_rad_s=q, r_rad_s=gyro, source="test")),
        (rx, Attitude(t_ns=t_ns, t_rx_ns=rx, phi_rad=roll, theta_rad=pitch, psi_rad=heading, p_rad_s=p,
                      q_rad_s=q, r_rad_s=gyro)),
    ]  # fmt: skip


def _cycle(rx_ns: int, d: np.ndarray) -> tuple[int, Message]:
    ids = [a.id for a in basin().anchors]
    ranges = tuple(AnchorRange(anchor=i, range_m=float(z)) for i, z in zip(ids, d, strict=True))
    return rx_ns, UwbRanges(t_ns=rx_ns, t_rx_ns=rx_ns, tag="test", ranges=ranges)


@dataclass
class Score:
    """Errors every 0.1 s after the settling time, shape (k, 6), and their NEES, shape (k,)."""

    t_s: np.ndarray
    error: np.ndarray
    nees: np.ndarray
    state: EstimatorState
    estimates: list[StateEstimate]

    def rms(self) -> dict[str, float]:
        e = np.sqrt((self.error**2).mean(axis=0))
        return {
            "position_m": float(np.hypot(e[0], e[1])), "u_m_s": float(e[3]), "v_m_s": float(e[4]),
            "heading_deg": float(np.rad2deg(e[2])), "nees": float(self.nees.mean()),
        }  # fmt: skip


def estimate(run: Run, estimator: Estimator, settle_s: float = 20.0) -> Score:
    """Feed a run in order of arrival; compare at 10 Hz."""
    state, waiting, t, errors, nees, estimates = estimator.initial(), list(run.messages), [], [], [], []
    first = 0
    for t_ns, f in run.commands:
        while first < len(waiting) and waiting[first].t_rx_ns <= t_ns:
            state, _ = estimator.step(state, waiting[first])
            first += 1
        e = estimator.estimate(state, t_ns)
        estimates.append(e)
        state = estimator.command(state, t_ns, f)
        if t_ns * 1e-9 < settle_s:
            continue
        x = np.array([e.north_m, e.east_m, e.psi_rad, e.u_m_s, e.v_m_s, e.r_rad_s])
        error = x - run.truth(t_ns * 1e-9)
        error[2] = (error[2] + math.pi) % (2 * math.pi) - math.pi
        t.append(t_ns * 1e-9)
        errors.append(error)
        nees.append(error @ np.linalg.solve(np.reshape(e.covariance, (6, 6)), error))
    return Score(np.array(t), np.array(errors), np.array(nees), state, estimates)


def step_all(run: Run, estimator: Estimator, until_s: float, hear) -> EstimatorState:
    """Messages and commands in order up to a time; `hear(state, message)` gives the state after it."""
    state, commands = estimator.initial(), list(run.commands)
    for m in run.messages:
        if m.t_rx_ns > until_s * 1e9:
            break
        while commands and commands[0][0] <= m.t_rx_ns:
            state = estimator.command(state, *commands.pop(0))
        state = hear(state, m)
    return state


def without(run: Run, drop) -> Run:
    """The run with the messages left out for which `drop` says so."""
    return replace(run, messages=[m for m in run.messages if not drop(m)])
