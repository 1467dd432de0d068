"""Nominal flight: an excitation simulated with the vessel file's own boat and sensors without noise.

Fisher information is computed from it. The excitation's controller gets the true state. Samples come at the rates of
the file's sensors; the size of their noise enters the information by the covariance R alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import polars as pl

from companion.core.configuration.site_file import Site
from companion.core.configuration.vessel_file import VesselFile
from companion.core.control.allocation import pulse_widths
from companion.core.excitation.file import Excitation
from companion.core.excitation.flight import BEGINNING, Flight
from companion.core.geometry.frames import point_acceleration, point_position, ssa
from companion.core.messages import ExcitationStatus, GroundTruth
from companion.logs.readers.aritra import meta_fields
from companion.logs.runs.run import Run, RunMeta
from sim.world.environment import Environment, Weather
from sim.world.plant import Motion, Plant

STEP_NS, TICK_NS = 10_000_000, 100_000_000
LATENCY_NS = 30_000_000  # from a tick to the autopilot's outputs: `Control.latency_s`
VOLTAGE_V = 15.6  # open circuit, as the simulated world has it
LIMIT_S = 7200.0  # a flight that takes longer is given up; assumed


@dataclass(frozen=True)
class NominalFlight:
    """One flight: log, status and truth at every tick, notes (t [s], text), least distance from the fence [m]."""

    run: Run
    statuses: tuple[ExcitationStatus, ...]
    truths: tuple[GroundTruth, ...]
    notes: tuple[tuple[float, str], ...]
    least_clearance_m: float

    @property
    def done(self) -> bool:
        """Whether the whole excitation was flown."""
        return self.statuses[-1].phase == "done"

    @property
    def duration_s(self) -> float:
        """From the first row to the last."""
        return self.run.duration_s


def fly_nominal(
    excitation: Excitation, vessel: VesselFile, site: Site, *, limit_s: float = LIMIT_S, step_ns: int = STEP_NS
) -> NominalFlight:
    """Fly `excitation` from rest in the middle of `site` until it is over, in calm. Raises ConfigError if it cannot be.

    `step_ns`: step of the plant; a tick is a whole number of them.
    """
    flight = Flight(excitation, vessel, site, name=excitation.name)
    plant = Plant(vessel, np.array([*flight.pen.middle, 0.0, 0, 0, 0]), step_ns=step_ns, voltage_v=VOLTAGE_V)
    calm = Environment(Weather(), np.random.default_rng(0)).step(0.0, 0.0)
    rows, state, clearance = _Rows(vessel, step_ns), BEGINNING, np.inf
    notes, statuses, truths = [], [], []
    while not flight.is_over(state) and plant.motion.t_ns < limit_s * 1e9:
        t_ns, x = plant.motion.t_ns, plant.motion.x
        if t_ns % TICK_NS == 0:
            state, f, note = flight.step(state, x[:3], x[3:6], t_ns)
            statuses.append(flight.status(state, t_ns))
            truths.append(truth_of(t_ns, x))
            if note:
                notes.append((t_ns * 1e-9, note))
            pwm = pulse_widths(f, vessel, plant.voltage_v)
            plant.command(t_ns + LATENCY_NS, tuple(map(float, pwm)))
            rows.command(t_ns + LATENCY_NS, pwm)
            clearance = min(clearance, float(flight.pen.clearance(x[None, :2])[0]))
        rows.sense(plant)
        plant.step(calm)
    run = rows.run(vessel, site, excitation.name)
    return NominalFlight(run, tuple(statuses), tuple(truths), tuple(notes), clearance)


def truth_of(t_ns: int, x: np.ndarray) -> GroundTruth:
    """The plant's state as a message."""
    north, east, psi, u, v, r, *f = map(float, x)
    return GroundTruth(t_ns=t_ns, north_m=north, east_m=east, psi_rad=psi, u_m_s=u, v_m_s=v, r_rad_s=r, f_n=tuple(f))


class _Rows:
    """Rows of a run, collected sample by sample."""

    def __init__(self, vessel: VesselFile, step_ns: int):
        self._step_ns = step_ns
        self._names = [f"pwm_{t.name}" for t in vessel.thrusters]
        self._imu, self._tag = vessel.sensors.imu, vessel.sensors.position
        self._imu_ns, self._fix_ns = round(1e9 / self._imu.rate_Hz), round(1e9 / self._tag.rate_Hz)
        self._late_ns = round(self._tag.latency_s * 1e9)
        self._rows: dict[int, dict[str, float]] = {}
        self._last_ns = 0

    def command(self, t_ns: int, pwm: tuple[int, ...]) -> None:
        self._at(t_ns, **dict(zip(self._names, map(float, pwm), strict=True)))

    def sense(self, plant: Plant) -> None:
        """Add the samples that the sensors take at this step of the plant."""
        motion = plant.motion
        self._last_ns = t_ns = motion.t_ns
        if t_ns % self._imu_ns < self._step_ns:
            self._at(t_ns, battery_v=plant.voltage_v, **self._inertial(motion))
        if t_ns % self._fix_ns < self._step_ns:
            north, east = point_position(motion.x, (self._tag.x_m, self._tag.y_m))
            self._at(t_ns + self._late_ns, north_m=float(north), east_m=float(east))

    def _inertial(self, motion: Motion) -> dict[str, float]:
        x, (u, v, r) = motion.x, motion.x[3:6]
        a_x, a_y = point_acceleration(x[3:6], motion.nu_dot, (self._imu.x_m, self._imu.y_m))
        return {
            "psi_rad": ssa(float(x[2])),
            "r_rad_s": float(r),
            "ax_m_s2": float(a_x),
            "ay_m_s2": float(a_y),
            "true_north_m": float(x[0]),
            "true_east_m": float(x[1]),
            "true_psi_rad": ssa(float(x[2])),
            "true_u_m_s": float(u),
            "true_v_m_s": float(v),
            "true_r_rad_s": float(r),
        }

    def _at(self, t_ns: int, **values: float) -> None:
        self._rows.setdefault(t_ns, {}).update(values)

    def run(self, vessel: VesselFile, site: Site, name: str) -> Run:
        """The log so far."""
        stamps = [t for t in sorted(self._rows) if t <= self._last_ns]
        keys = list(dict.fromkeys(key for t in stamps for key in self._rows[t]))
        data = {"t_s": [t * 1e-9 for t in stamps]} | {k: [self._rows[t].get(k) for t in stamps] for k in keys}
        table = pl.DataFrame(data, schema=dict.fromkeys(data, pl.Float64))
        held = [*self._names, "battery_v"]
        table = table.with_columns(pl.col(held).forward_fill())
        source = f"nominal flight of {name}"
        return Run(table, RunMeta(vessel=vessel.name, source=source, clock="simulated", **meta_fields(vessel, site)))
