"""Evidence that the checks of single sensors are quiet on a boat that nobody here built: BlueBoat's own runs."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace

import numpy as np
from msgspec.structs import replace

from companion.core.constants import GRAVITY_M_S2
from companion.core.messages import Attitude, ImuSample
from companion.core.model.thrusters import force_from_pwm
from companion.core.pilot.trust.sensors.accelerometer_check import AccelerometerMonitor
from companion.core.pilot.trust.sensors.heading_check import HeadingMonitor
from companion.logs.runs.run import Run
from tests.companion.core.pilot.monitors.monitor_fixture import view
from tests.evidence.line import Line, exactly, information
from tests.evidence.real_logs.blueboat import FIT, JUDGED, absent, blueboat, runs

BATTERY_V = 14.8
"""Of four cells, assumed: the runs do not say."""


def real_boat(full: bool) -> Iterator[Line]:
    """Heading, gyro and accelerometer of 16 runs of a real catamaran, of which nothing is known to be broken"""
    every = runs(FIT + JUDGED)
    if not every:
        yield from absent()
        return
    found = {name: findings(run) for name, run in every.items()}
    for name, texts in found.items():
        for text in texts:
            print(f"  {name}: {text}")
    minutes = sum(float(run.table["t_s"][-1]) for run in every.values()) / 60
    for names, which in ((FIT, "ten runs by which limits were chosen"), (JUDGED, "six others")):
        yield exactly(f"findings on {which}", sum(len(found[name]) for name in names), 0, "")
    yield information("minutes of all", minutes, "min")


def findings(run: Run) -> list[str]:
    """What the monitors find in a run, from its columns; the boat's roll and pitch are not in it: level."""
    vessel = blueboat()
    heading, accelerometer = HeadingMonitor(vessel, 0.0), AccelerometerMonitor(vessel.sensors.imu)
    turning, shaking, tick_s = heading.initial, accelerometer.initial, 0.0
    columns = ("t_s", "psi_rad", "r_rad_s", "ax_m_s2", "ay_m_s2", "pwm_left", "pwm_right")
    for t_s, psi, r, ax, ay, left, right in run.table.select(columns).fill_null(float("nan")).iter_rows():
        t_ns = round(t_s * 1e9)
        seen = Attitude(
            t_ns=t_ns, t_rx_ns=t_ns, phi_rad=0.0, theta_rad=0.0, psi_rad=psi, p_rad_s=0.0, q_rad_s=0.0, r_rad_s=r
        )
        turning, _ = heading.on_message(turning, seen, t_ns)
        if np.isfinite([ax, ay]).all():
            sample = ImuSample(
                t_ns=t_ns, t_rx_ns=t_ns, ax_m_s2=ax, ay_m_s2=ay, az_m_s2=-GRAVITY_M_S2, p_rad_s=0.0, q_rad_s=0.0,
                r_rad_s=r, source="",
            )  # fmt: skip
            shaking, _ = accelerometer.on_message(shaking, sample, t_ns)
        if t_s >= tick_s:
            tick_s = t_s + 0.1
            f_n = np.array(
                [
                    force_from_pwm(t, vessel.force_maps[t.force_map], us, BATTERY_V)
                    for t, us in zip(vessel.thrusters, (left, right), strict=True)
                ]
            )
            turning, _ = heading.on_tick(turning, replace(view(t_ns), belief=SimpleNamespace(f_n=f_n)))
    return [finding.text for finding in (*turning.findings, *shaking.findings)]


PARTS = (real_boat,)
