"""The table of monitors: who hears what and when, what a report does, and that every monitor has its own state."""

import msgspec
from msgspec.structs import replace

from companion.core.estimation.estimator import Estimator
from companion.core.messages import Alert, Attitude, Heartbeat, ImuSample
from companion.core.pilot.monitors.monitor import Monitor, MonitorReport
from companion.core.pilot.monitors.table import MonitorTable, monitors_of
from companion.core.pilot.state import PilotState
from tests.companion.core.pilot.monitors.monitor_fixture import view
from tests.companion.core.pilot.pilot_shell import heartbeat
from tests.support.drive_fixture import pilot, setup, under_way

ALERT = Alert(t_ns=7, level="info", text="counted")


class Count(msgspec.Struct, frozen=True):
    heard: int = 0
    ticks: int = 0


class Counter(Monitor[Count]):
    """Stops the boat at every heartbeat, and has a condition from the second tick on."""

    hears = (Heartbeat,)
    initial = Count()

    def on_message(self, state, message, t_ns):
        return replace(state, heard=state.heard + 1), MonitorReport({"stop": "counted"}, (ALERT,))

    def on_tick(self, state, view):
        state = replace(state, ticks=state.ticks + 1)
        return state, MonitorReport({"loop_lag": "two"} if state.ticks > 1 else {}, (ALERT,))


class Shut(msgspec.Struct, frozen=True):
    pass


class Door(Monitor[Shut]):
    hears = (Heartbeat,)
    screens = True
    initial = Shut()

    def on_message(self, state, message, t_ns):
        return state, MonitorReport(withhold=True)


def state_of(table) -> PilotState:
    return replace(under_way()[0], monitors=table.initial())


def test_a_report_changes_the_mode_and_is_told_and_the_state_is_kept():
    table = MonitorTable([Counter()])
    state, outputs = table.hear(state_of(table), heartbeat(7), 7)
    assert state.monitor(Count) == Count(heard=1) and state.helm.mode == "idle" and outputs[0] == ALERT
    same, outputs = table.hear(state, Attitude(t_ns=7, t_rx_ns=7, phi_rad=0.0, theta_rad=0.0, psi_rad=0.0, p_rad_s=0.0,
                                               q_rad_s=0.0, r_rad_s=0.0), 7)  # fmt: skip
    assert same == state and outputs == [], "what it does not hear"


def test_conditions_of_a_tick_are_those_that_hold_now():
    table = MonitorTable([Counter()])
    state, conditions, alerts = table.on_tick(state_of(table), view(7))
    assert conditions == {} and alerts == [ALERT]
    state, conditions, _ = table.on_tick(state, view(8))
    assert conditions == {"loop_lag": "two"} and state.monitor(Count) == Count(ticks=2)


def test_a_screen_is_heard_first_and_may_withhold():
    table = MonitorTable([Counter(), Door()])
    state, outputs, let_through = table.screen(state_of(table), heartbeat(7), 7)
    assert let_through is None and outputs == [] and state.monitor(Count) == Count(), "the others hear it later"
    assert table.screen(state, imu(), 7)[2] == imu()


def imu():
    return ImuSample(t_ns=0, t_rx_ns=0, ax_m_s2=0.0, ay_m_s2=0.0, az_m_s2=0.0, p_rad_s=0.0, q_rad_s=0.0, r_rad_s=0.0,
                     source="RAW_IMU")  # fmt: skip


def test_every_monitor_of_the_boat_has_a_state_of_its_own():
    settings = setup().pilot
    anchors = Estimator(settings.vessel, settings.site).anchors
    table = monitors_of(settings, (9, 10, 11, 12), anchors)
    assert len(table.initial()) == len(table.monitors) == len({type(m) for m in table.monitors})
    assert set(pilot().initial(0).monitors) == set(table.initial())
