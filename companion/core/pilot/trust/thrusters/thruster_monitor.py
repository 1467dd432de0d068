"""The thruster bank at work: each tick's residual, from sensors and filter, and what a new order leaves of findings."""

from __future__ import annotations

import numpy as np
from msgspec.structs import replace

from companion.core.configuration.vessel_file import VesselFile
from companion.core.messages import Alert, Attitude, ImuSample, OperatorCommand
from companion.core.model.actuators.propulsion import is_steered
from companion.core.model.manoeuvring import mass_matrix
from companion.core.model.thrusters import configuration_matrix
from companion.core.pilot.monitors.monitor import NOTHING, Monitor, MonitorReport, TickView
from companion.core.pilot.trust.thrusters.force_balance import ForceBalance
from companion.core.pilot.trust.thrusters.hypothesis_bank import ThrusterBank
from companion.core.pilot.trust.thrusters.remaining_thrust import ThrusterHealth
from companion.core.pilot.trust.thrusters.thruster_verdict import ThrusterState, ThrusterVerdicts, TickMotion, report_of
from companion.core.sensors.inertial import AttitudeSensor, InertialSensor
from companion.core.sensors.sensor import Sensor

SETTLES_NS = 2_000_000_000
"""After a start or a gap the filter's tilt settles; assumed."""
UNSEEN_PERIODS, UNSEEN_S = 2.5, 1.0
"""Without a position for so many periods, and so long, speed is dead reckoning: it judges no thruster. Assumed."""


class ThrusterMonitor(Monitor[ThrusterState]):
    """Condition `crippled` where thrusters can no longer drive the boat; alerts of what was found.

    Its hypotheses are about fixed thrusters: a boat with servos it does not judge.
    """

    hears = (ImuSample, Attitude, OperatorCommand)
    screens = True

    def __init__(self, vessel: VesselFile):
        n, self._steered = len(vessel.thrusters), is_steered(vessel)
        imu = vessel.sensors.imu
        self._sensors: dict[type, Sensor] = {ImuSample: InertialSensor(imu), Attitude: AttitudeSensor(imu)}
        self._names = [thruster.name for thruster in vessel.thrusters]
        self._verdicts = ThrusterVerdicts(vessel, ThrusterBank(configuration_matrix(vessel), mass_matrix(vessel)))
        self._balance = ForceBalance(vessel)
        self._unseen_ns = round(max(UNSEEN_S, UNSEEN_PERIODS / vessel.sensors.position.rate_Hz) * 1e9)
        health = ThrusterHealth.sound(n)
        self.initial = ThrusterState(self._verdicts.initial(health), health)

    def on_message(
        self, state: ThrusterState, message: ImuSample | Attitude | OperatorCommand, t_ns: int
    ) -> tuple[ThrusterState, MonitorReport]:
        """Collect what the tick will need; a new start forgets that nothing can be done, not which thruster it is."""
        if isinstance(message, OperatorCommand):
            if message.command == "stop":
                return state, NOTHING
            if state.hopeless or state.accel_off or state.suspected:
                state = self._begun_anew(state, by_hand=message.command == "manual")
            text = state.health.known(self._names)
            return state, MonitorReport(alerts=(Alert(t_ns=t_ns, level="warning", text=text),) if text else ())
        sensor = self._sensors[type(message)]
        if sensor.screen(message)[0] is None:
            return state, NOTHING
        sensed = sensor.correct(message)
        if isinstance(sensed, Attitude):
            return replace(state, rate=(sensed.t_ns, sensed.r_rad_s)), NOTHING
        x, y, z = state.force
        force = (x + sensed.ax_m_s2, y + sensed.ay_m_s2, z + sensed.az_m_s2)
        state, alerts = replace(state, force=force, count=state.count + 1), ()
        if (pending := state.pending) is not None:
            state, found = self._stepped(replace(state, pending=None), pending)
            alerts = found.alerts
        return state, MonitorReport(alerts=alerts, withhold=state.accel_off)

    def _begun_anew(self, state: ThrusterState, *, by_hand: bool) -> ThrusterState:
        """After a new order: the power of a thruster that could not be borne has been cut, as was told, unless the boat
        is fetched by hand; one that still pushes is found again. So is a sensor that is still wrong.
        """
        findings = tuple(f for f in state.findings if f.cause != "sensor")
        bank = self._verdicts.initial(state.health)
        state = replace(state, bank=bank, findings=findings, accel_off=False, suspected="", pending=None)
        if by_hand:
            return state
        stuck = tuple(
            force if self._verdicts.is_bearable(i, force) else 0.0 for i, force in enumerate(state.health.stuck_n)
        )
        health = replace(state.health, stuck_n=stuck)
        return replace(state, bank=self._verdicts.initial(health), health=health, hopeless="")

    def on_tick(self, state: ThrusterState, view: TickView) -> tuple[ThrusterState, MonitorReport]:
        """The tick's motion; its residual goes through the bank with the next sample: no tick waits for that."""
        before, now = state.before, view.belief
        after = replace(state, force=(0.0, 0.0, 0.0), count=0, rate_before=state.rate, before=now, pending=None)
        report = report_of(state)
        if self._steered or not view.driving or view.learning:
            return replace(after, bank=self._verdicts.initial(state.health), probing=False), report
        if state.has_changed(view.t_ns):
            return replace(after, probing=False), report
        if before is None or now is None or view.t_ns - now.since_ns < SETTLES_NS or state.accel_off or not state.count:
            return after, report
        if now.t_ns - now.position_ns > self._unseen_ns:
            return replace(after, probing=False), report
        if state.rate is None or state.rate_before is None or state.rate[0] <= state.rate_before[0]:
            return after, report
        r_dot = (state.rate[1] - state.rate_before[1]) / ((state.rate[0] - state.rate_before[0]) * 1e-9)
        force = np.array(state.force) / state.count
        return replace(after, pending=TickMotion(before, now, force, r_dot, view)), report

    def _stepped(self, state: ThrusterState, tick: TickMotion) -> tuple[ThrusterState, MonitorReport]:
        """With a tick's residual in the bank. What a push or the accelerometer seemed to do until the filter knew its
        speed may have been the error of that speed, which is no more: the bank begins anew.
        """
        w, a = self._balance.residual(tick.before, tick.now, tick.force_m_s2, tick.r_dot_rad_s2)
        if not np.isfinite(w).all():
            return state, NOTHING
        dt_s = (tick.now.t_ns - tick.before.t_ns) * 1e-9
        bank = state.bank
        if tick.now.settled and not tick.before.settled and self._verdicts.may_be_speed(bank):
            bank = self._verdicts.initial(state.health)
        bank = self._verdicts.bank(state.health).step(bank, w, (tick.before.f_n + tick.now.f_n) / 2, a, dt_s)
        return self._verdicts.judge(replace(state, bank=bank), tick.view)
