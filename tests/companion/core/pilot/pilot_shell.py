"""A shell around the pilot for its tests: messages in, leases out, a plan or none."""

from __future__ import annotations

import math

import msgspec
import numpy as np

from companion.core import messages as m
from tests.support.drive_fixture import pilot, setup, under_way

S, MS = 1_000_000_000, 1_000_000
VESSEL = setup().pilot.vessel
CHANNELS = (9, 10, 11, 12, 1, 2, 3, 4)
N = len(VESSEL.thrusters)
NAN, INF = math.nan, math.inf


def heartbeat(t_ns, armed=True, mode=0):
    return m.Heartbeat(t_ns=t_ns, system=1, component=1, vehicle_type=11, autopilot=3, base_mode=0, custom_mode=mode,
                       system_status=4, armed=armed)  # fmt: skip


def attitude(shell, t_ns=None):
    """Of a boat that neither turns nor leans, by its estimate; its last digits live."""
    t_ns = shell.t_ns if t_ns is None else t_ns
    last_digits = 1e-4 * (t_ns // (20 * MS) % 10)
    psi_rad = shell.state.estimate.psi_rad + last_digits
    return m.Attitude(t_ns=t_ns, t_rx_ns=t_ns, phi_rad=0.0, theta_rad=0.0, psi_rad=psi_rad, p_rad_s=0.0, q_rad_s=0.0,
                      r_rad_s=last_digits)  # fmt: skip


def plan(index, t_ns=0, status="ok", f_n=None):
    rows = tuple((float(k + 1),) * N for k in range(20)) if f_n is None else f_n
    return m.PlanResult(t_ns=t_ns, index=index, status=status, reason="because", solve_time_s=0.001, iterations=1,
                        cost=0.0, f_n=rows, x=())  # fmt: skip


def operator(command, t_ns=0):
    return m.OperatorCommand(t_ns=t_ns, command=command)


def stick(t_ns, surge, source="pad"):
    return m.ManualInput(t_ns=t_ns, surge=surge, sway=0.0, yaw=0.0, source=source)


class Shell:
    """Feeds a pilot as a shell would, and holds every history to the rules."""

    def __init__(self, state, t_ns, index=0):
        self.state, self.t_ns, self.index = state, t_ns, index
        self.ticks, self.leases, self.outputs = [], [], []

    def feed(self, *inputs):
        self.state, outputs = pilot().step(self.state, inputs, self.t_ns)
        self.outputs += outputs
        self.ticks += [i.index for i in inputs if isinstance(i, m.Tick)]
        for lease in (o for o in outputs if isinstance(o, m.OverrideLease)):
            self.check(lease, inputs)
            self.leases.append(lease)
        indexes = [lease.index for lease in self.leases]
        waiting = [] if self.state.open_tick is None else [self.state.open_tick]
        assert indexes + waiting == self.ticks, "a tick without a lease, or with two"
        msgspec.json.encode(outputs)
        return outputs

    def check(self, lease, inputs):
        assert lease.channels == CHANNELS
        assert all(1100 <= pwm <= 1900 and type(pwm) is int for pwm in lease.pwm_us)
        assert lease.pwm_us[N:] == (1500,) * 4
        assert np.isfinite(lease.f_command_n).all() and lease.valid_for_s == 0.3
        if lease.source == "neutral":
            assert lease.reason and lease.pwm_us == (1500,) * 8
        if len(inputs) == 1 and not self.state.helm.driving:
            assert lease.source == "neutral", "thrust without leave to drive"

    def tick(self):
        self.t_ns += 100 * MS
        self.index += 1
        return self.feed(m.Tick(t_ns=self.t_ns, index=self.index))

    def wait(self, ms):
        self.t_ns += ms * MS

    def deadline(self):
        return self.feed(m.PlanDeadline(t_ns=self.t_ns, index=self.index))

    @property
    def lease(self):
        return self.leases[-1]


def on_the_leg():
    return Shell(*under_way(), index=1000)


def at_the_start():
    return Shell(pilot().initial(0), 0)


def sensors(boat, ms):
    """IMU and attitude of a boat that goes straight on, for the filter to follow without UWB."""
    for k in range(0, ms, 20):
        t_ns = boat.t_ns + k * MS
        boat.feed(
            m.ImuSample(t_ns=t_ns, t_rx_ns=t_ns, ax_m_s2=0.0, ay_m_s2=0.0, az_m_s2=-9.8, p_rad_s=0.0, q_rad_s=0.0,
                        r_rad_s=0.0, source="RAW_IMU"),
            attitude(boat, t_ns),
        )  # fmt: skip
    boat.t_ns += ms * MS
