"""Logs as a pilot at a keyboard makes them: the plant in the basin, random held commands, the boat's sensors.

The pilot holds one command (surge, sway, yaw; ahead, astern, none) for a few seconds, then takes another: that gives
straight runs, strafes, spins, reversals and stops. Near the walls he drives towards the middle. Commands are shared
among the thrusters by `allocation` with gains of one: the pilot does not know what each thruster really gives.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import polars as pl
from msgspec.structs import replace

from companion.core.configuration.site_file import Anchor
from companion.core.configuration.vessel_file import VesselFile
from companion.core.constants import NEUTRAL_US
from companion.core.control.allocation import allocate, pulse_widths
from companion.core.geometry.frames import unrotate, wrapped
from companion.logs.runs.run import Run, RunMeta
from sim.world.environment import Environment, Moment, Weather, with_terms_of
from sim.world.plant import Motion, Plant
from sim.world.sensors import ImuSensor, UwbFaults, UwbSensor

STEP_NS = 10_000_000
PILOT_NS = 100_000_000  # pulse widths leave at 10 Hz
BASIN_M = 30.0  # side of the paper's basin
MARGIN_M = 6.0  # the pilot turns back this far from a wall; assumed
VOLTAGE_V = 15.6  # open circuit, as the simulated world has it
NANO = 1e-9
HOME_N = 22.0  # force towards the middle when a wall is near; assumed
ALONE = 0.6  # share of its limit at which a thruster is tried alone; assumed
TRUTH = "true_"


@dataclass(frozen=True)
class Habits:
    """What the pilot does. Forces are drawn uniformly between a third of `most` and `most`; assumed."""

    most: tuple[float, float, float] = (24.0, 34.0, 9.0)  # X [N], Y [N], N [N m]: about 0.9 m/s, 0.4 m/s, 0.8 rad/s
    use: tuple[float, float, float] = (0.7, 0.45, 0.6)  # share of commands in which an axis is not zero
    hold_s: tuple[float, float] = (1.0, 6.0)
    home_n: float = HOME_N


class HomingPilot(ABC):
    """Drives as a subclass wants, near a wall towards the middle; `tau` is asked at 10 Hz with where the boat is."""

    def __init__(self, home_n: float = HOME_N):
        self._home_n, self._homing = home_n, False

    @abstractmethod
    def wanted(self, t_s: float, x: np.ndarray, anew: bool) -> np.ndarray:
        """Wanted body force [N, N, N m] where no wall is near, shape (3,); `anew`: the boat has just come near one."""

    def tau(self, t_s: float, x: np.ndarray) -> np.ndarray:
        """Wanted body force [N, N, N m] at `t_s`, shape (3,); x = [x y psi u v r ...]."""
        away = x[:2] - BASIN_M / 2
        reach = np.abs(away).max()
        inner = BASIN_M / 2 - MARGIN_M
        tau = self.wanted(t_s, x, anew=bool(reach > inner and not self._homing))
        self._homing = reach > inner or (self._homing and reach > 0.6 * inner)
        if not self._homing:
            return tau
        north, east = -away / np.linalg.norm(away) * self._home_n
        return np.array([*unrotate(x[2], north, east), tau[2]])


class KeyboardPilot(HomingPilot):
    """Held random commands [N, N, N m]."""

    def __init__(self, rng: np.random.Generator, habits: Habits | None = None):
        habits = habits or Habits()
        super().__init__(habits.home_n)
        self._rng, self._habits = rng, habits
        self._until_s, self._tau = 0.0, np.zeros(3)

    def wanted(self, t_s: float, x: np.ndarray, anew: bool) -> np.ndarray:
        """The command that is held; another after a while, and near a wall."""
        if t_s >= self._until_s or anew:
            self._draw(t_s)
        return self._tau

    def _draw(self, t_s: float) -> None:
        rng, habits = self._rng, self._habits
        size = np.array(habits.most) * rng.uniform(1 / 3, 1.0, 3)
        self._tau = size * rng.choice([-1.0, 1.0], 3) * (rng.uniform(size=3) < habits.use)
        self._until_s = t_s + rng.uniform(*habits.hold_s)


@dataclass
class _Log:
    """Rows as they come: stamp -> values by column."""

    rows: dict[int, dict[str, float]] = field(default_factory=dict)

    def at(self, t_ns: int, **values: float) -> None:
        self.rows.setdefault(t_ns, {}).update(values)

    def table(self, held: list[str], end_ns: int) -> pl.DataFrame:
        """Rows up to `end_ns` in order of time, held columns filled forward."""
        stamps = [t for t in sorted(self.rows) if t <= end_ns]
        names = list(dict.fromkeys(k for t in stamps for k in self.rows[t]))
        data = {"t_s": [t * NANO for t in stamps]} | {k: [self.rows[t].get(k) for t in stamps] for k in names}
        order = ["t_s", *held, *(k for k in names if k not in held)]
        table = pl.DataFrame(data, schema=dict.fromkeys(data, pl.Float64)).select(order)
        return table.with_columns(pl.col(held).forward_fill())


def corner_anchors(down_m: float = -2.5) -> tuple[Anchor, ...]:
    """Four anchors at the corners of the basin, as in deploy/sites/basin.toml."""
    places = [(0.0, 0.0), (BASIN_M, 0.0), (BASIN_M, BASIN_M), (0.0, BASIN_M)]
    return tuple(
        Anchor(id=str(i), north_m=n, east_m=e, down_m=down_m, source="assumed") for i, (n, e) in enumerate(places)
    )


def teleop_run(
    vessel: VesselFile,
    seed: int,
    duration_s: float,
    *,
    imu_hz: float = 30.0,
    uwb_hz: float = 1.0,
    sigma_m: float = 0.10,
    weather: Weather | None = None,
    pilot: Callable[[np.random.Generator], HomingPilot] = KeyboardPilot,
    believed: VesselFile | None = None,
    alone_s: float = 0.0,
) -> Run:
    """One log of `vessel` (the true boat) with truth in its true_* columns; the same seed gives the same log.

    The position is the tag's own fix from four ranges with `sigma_m` each, stamped when its bytes arrive: it is
    older by meta.latency_s, and the tag sits at meta.tag_arm_m. battery_v comes at 2 Hz like SYS_STATUS, to 10 mV.
    `believed`: what the pilot's allocation and the log's meta go by, where that is not the true boat.
    `pilot`: who drives, given what he draws from.
    `alone_s`: the pilot first lets each thruster push alone, ahead and astern, so long each, with rests as long.
    """
    believed = believed or vessel
    draws = [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(4)]
    imu_file = replace(vessel.sensors.imu, rate_Hz=imu_hz)
    uwb_file = replace(vessel.sensors.tag, rate_Hz=uwb_hz, range_sigma_m=sigma_m)
    driver = pilot(draws[0])
    imu = ImuSensor(imu_file, draws[1])
    uwb = UwbSensor(uwb_file, corner_anchors(), UwbFaults(), draws[2])
    environment = Environment(weather or Weather(), draws[3])
    plain = replace(believed, thrusters=tuple(replace(t, gain=1.0, trim_us=0) for t in believed.thrusters))
    middle = BASIN_M / 2
    plant = Plant(vessel, np.array([middle, middle, 0.0, 0, 0, 0]), step_ns=STEP_NS, voltage_v=VOLTAGE_V)
    names = [f"pwm_{t.name}" for t in vessel.thrusters]
    log, due = _Log(), {"imu": 0, "uwb": 0, "battery": 0}
    wanted, pwm = np.full(len(names), np.nan), (float(NEUTRAL_US),) * len(names)
    for k in range(round(duration_s * 1e9) // STEP_NS):
        t_ns = k * STEP_NS
        if t_ns % PILOT_NS == 0:
            alone = _alone(plain, t_ns * NANO, alone_s)
            force = allocate(driver.tau(t_ns * NANO, plant.motion.x), plain) if alone is None else alone
            if not np.array_equal(force, wanted):
                wanted, pwm = force, pulse_widths(force, plain, plain.propulsion.nominal_voltage_V)
                plant.command(t_ns, tuple(map(float, pwm)))
            log.at(t_ns, **dict(zip(names, map(float, pwm), strict=True)))
        moment = environment.step(t_ns * NANO, STEP_NS * NANO)
        _sense(log, due, plant, (imu, uwb, round(1e9 / uwb_hz)), moment)
        plant.step(moment)
    meta = RunMeta(
        vessel=vessel.name,
        source=f"teleop_run seed {seed}",
        clock="simulated",
        site="basin",
        anchors_m={a.id: (a.north_m, a.east_m, a.down_m) for a in corner_anchors()},
        latency_s=believed.sensors.tag.latency_s,
        tag_arm_m=(believed.sensors.tag.x_m, believed.sensors.tag.y_m),
        pwm_limits_us={t.name: (float(t.pwm_min_us), float(t.pwm_max_us)) for t in vessel.thrusters},
    )
    return Run(log.table([*names, "battery_v"], round(duration_s * 1e9)), meta)


def _alone(vessel: VesselFile, t_s: float, on_s: float) -> np.ndarray | None:
    """Forces (n,) [N] at `t_s`: one thruster after the other, ahead and astern, `on_s` each; None: that is over."""
    if t_s >= 4 * len(vessel.thrusters) * on_s:
        return None
    turn, resting = divmod(int(t_s / on_s), 2)
    thruster, astern = divmod(turn, 2)
    force = np.zeros(len(vessel.thrusters))
    if not resting:
        one = vessel.thrusters[thruster]
        force[thruster] = ALONE * (one.force_min_N if astern else one.force_max_N)
    return force


def _sense(
    log: _Log, due: dict[str, int], plant: Plant, sensors: tuple[ImuSensor, UwbSensor, int], moment: Moment
) -> None:
    """Write what is due now: battery, IMU with the truth beside it, UWB fix at its arrival."""
    t_ns = plant.motion.t_ns
    imu, uwb, uwb_period_ns = sensors
    if t_ns >= due["battery"]:
        due["battery"] += 500_000_000
        log.at(t_ns, battery_v=round(plant.voltage_v, 2))
    if t_ns >= due["imu"]:
        due["imu"] += imu.period_ns
        reading = imu.measure(plant.motion, moment)
        log.at(
            t_ns,
            psi_rad=reading.psi_rad,
            r_rad_s=reading.gyro_rad_s[2],
            ax_m_s2=reading.accel_m_s2[0],
            ay_m_s2=reading.accel_m_s2[1],
            phi_rad=reading.phi_rad,
            theta_rad=reading.theta_rad,
            **_truth(plant.motion),
        )
    if t_ns >= due["uwb"]:
        due["uwb"] += uwb_period_ns
        fix = uwb.fix(uwb.measure(plant.motion))
        if fix is not None:
            east, north, _ = fix
            log.at(uwb.arrival_ns(t_ns), north_m=north, east_m=east)


def _truth(motion: Motion) -> dict[str, float]:
    x = motion.x
    names = ("true_north_m", "true_east_m", "true_psi_rad", "true_u_m_s", "true_v_m_s", "true_r_rad_s")
    values: dict[str, float] = dict(zip(names, map(float, x[:6]), strict=True))
    values["true_psi_rad"] = wrapped(values["true_psi_rad"])
    return values


def teleop_logs(true: VesselFile, believed: VesselFile, seeds: Sequence[int], duration_s: float) -> list[Run]:
    """Logs of the true boat in its file's own weather, without the truth, by a pilot who goes by `believed`.

    UWB at the rate and noise of the true file.
    """
    weather = with_terms_of(Weather(), true)
    uwb, out = true.sensors.tag, []
    for seed in seeds:
        run = teleop_run(true, seed, duration_s, uwb_hz=uwb.rate_Hz, sigma_m=uwb.range_sigma_m, weather=weather,
                         believed=believed)  # fmt: skip
        kept = [c for c in run.table.columns if not c.startswith(TRUTH)]
        out.append(Run(run.table.select(kept), run.meta))
    return out
