"""Boats that are connected wrongly, with another cause beside, and their logs. Not by the room's own code."""

from collections.abc import Callable, Mapping
from itertools import combinations

import numpy as np
import polars as pl
from msgspec.structs import replace

from companion.core.configuration.vessel_file import VesselFile
from companion.logs.runs.run import Run
from sim.world.environment import Weather
from sim.world.teleop_log import teleop_run
from tests.support.vessel_fixtures import boat

BOAT = boat("aritra")
FP, FS, RP, RS = (t.name for t in BOAT.thrusters)
ALONE_S = 2.0
"""So long each thruster pushes alone at the beginning: without that a swap to port is as one to starboard."""
SWAPS = {f"swapped:{a}+{b}": {a: b, b: a} for a, b in combinations((FP, FS, RP, RS), 2)}
PLACES = SWAPS | {
    "mirrored:port_starboard": {FP: FS, FS: FP, RP: RS, RS: RP},
    "mirrored:fore_aft": {FP: RP, RP: FP, FS: RS, RS: FS},
}
REVERSED = {"reversed:all": (FP, FS, RP, RS), f"reversed:{RP}": (RP,)}
IMU_DEG = {"imu:90": 90, "imu:180": 180}
FAULTS = (*PLACES, *REVERSED, *IMU_DEG)


def _imu(vessel: VesselFile, **keys: float) -> VesselFile:
    return replace(vessel, sensors=replace(vessel.sensors, imu=replace(vessel.sensors.imu, **keys)))


def _heavy(vessel: VesselFile) -> VesselFile:
    i = vessel.inertia
    return replace(vessel, inertia=replace(i, mass_kg=1.15 * i.mass_kg, I_z_kg_m2=1.15 * i.I_z_kg_m2))


def _weak(vessel: VesselFile) -> VesselFile:
    return replace(vessel, thrusters=(replace(vessel.thrusters[0], gain=0.8), *vessel.thrusters[1:]))


BESIDE: Mapping[str, tuple[Callable[[VesselFile], VesselFile], Weather]] = {
    "nothing": (lambda v: v, Weather()),
    "current": (lambda v: v, Weather(V_c_m_s=0.12, beta_c_deg=60.0)),
    "wind": (lambda v: v, Weather(V_w_m_s=5.0, beta_w_deg=300.0)),
    "weak thruster": (_weak, Weather()),
    "compass": (lambda v: _imu(v, heading_offset_rad=np.radians(8.0)), Weather()),
    "heavy": (_heavy, Weather()),
}
"""What else may be wrong, of medium size in the sense of the diagnosis catalogue."""


def miswired(fault: str, vessel: VesselFile = BOAT) -> VesselFile:
    """The true boat: what the command of each thruster drives; the whole file where the fault is none of thrusters."""
    there, to = {t.name: t for t in vessel.thrusters}, PLACES.get(fault, {})
    moved = (replace(there[to.get(n, n)], name=n, channel=t.channel) for n, t in there.items())
    turned = REVERSED.get(fault, ())
    return replace(vessel, thrusters=tuple(replace(t, mirrored=t.name in turned) for t in moved))


def drive(
    fault: str = "",
    beside: str = "nothing",
    seed: int = 0,
    seconds: float = 120.0,
    uwb_hz: float = 1.0,
    alone_s: float = ALONE_S,
) -> Run:
    """A log by hand of the reference boat with a fault, and something else beside; labels are the file's.

    As read from an autopilot's own log, whose axes are known.
    """
    change, weather = BESIDE[beside]
    run = teleop_run(
        miswired(fault, change(BOAT)),
        seed,
        seconds,
        uwb_hz=uwb_hz,
        weather=weather,
        believed=BOAT,
        alone_s=alone_s,
    )
    meta = replace(run.meta, columns={"pwm": "what left the autopilot"})
    told = Run(run.table.select(c for c in run.table.columns if not c.startswith("true_")), meta)
    return turned_imu(told, IMU_DEG.get(fault, 0))


def turned_imu(run: Run, degrees: int) -> Run:
    """What an IMU says that is turned to starboard, about its own axis down: ahead is at `-degrees` of it."""
    c, s = round(np.cos(np.radians(degrees))), round(np.sin(np.radians(degrees)))
    ax, ay, phi, theta = (pl.col(name) for name in ("ax_m_s2", "ay_m_s2", "phi_rad", "theta_rad"))
    return changed(
        run,
        ax_m_s2=c * ax + s * ay,
        ay_m_s2=c * ay - s * ax,
        theta_rad=c * theta - s * phi,
        phi_rad=c * phi + s * theta,
    )


def changed(run: Run, **columns: pl.Expr) -> Run:
    """The run with columns computed anew."""
    return Run(run.table.with_columns(**columns), run.meta)
