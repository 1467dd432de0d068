"""The autopilot as its heartbeats show it: whether it is alive, armed and in MANUAL, and the requests for that.

Overrides flow from the first tick; then MANUAL is requested, then arming, each again every second. Somebody
else's disarm or mode change is an event of the mode table (`modes`): what was MANUAL or armed no longer is, or the
autopilot says so.
Without a receiver the autopilot boots into HOLD and stays there until overrides flow.
"""

from __future__ import annotations

from typing import Any

import msgspec
from msgspec.structs import replace

from companion.core.messages import Heartbeat, StatusText, VehicleRequest
from companion.core.pilot.modes import Event
from companion.core.pilot.monitors.monitor import NOTHING, Monitor, MonitorReport, TickView

MANUAL = 0
"""ArduPilot Rover's custom mode in which RC overrides reach the thrusters."""
RETRY_NS = 1_000_000_000
"""Between repeated requests; assumed: an answer shows in the next heartbeat, 1 s later."""
DISARMED_TEXT = "Throttle disarmed"
"""What Rover says at once when it is disarmed (source: Rover/AP_Arming.cpp); two heartbeats may miss it."""
HEARTBEAT_LOST_NS = 3_000_000_000
"""Heartbeats come at 1 Hz; three missing are a lost autopilot (assumed)."""


class AutopilotState(msgspec.Struct, frozen=True):
    """The latest heartbeat, and when [ns] the latest request was made."""

    heartbeat: Heartbeat | None = None
    asked_ns: int | None = None

    @property
    def heartbeat_ns(self) -> int | None:
        """Instant of the latest heartbeat [ns]; None: there was none."""
        return self.heartbeat.t_ns if self.heartbeat else None


UNKNOWN = AutopilotState()


class AutopilotMonitor(Monitor[AutopilotState]):
    """Events `disarmed` and `mode_changed`, condition `link_lost`."""

    hears = (Heartbeat, StatusText)
    initial = UNKNOWN

    def on_message(self, state: AutopilotState, message: Any, t_ns: int) -> tuple[AutopilotState, MonitorReport]:
        """A heartbeat, compared with the one before, or a text."""
        if isinstance(message, StatusText):
            disarmed = message.text.startswith(DISARMED_TEXT)
            return state, MonitorReport({"disarmed": "the autopilot was disarmed"}) if disarmed else NOTHING
        return replace(state, heartbeat=message), MonitorReport(changes(state.heartbeat, message))

    def on_tick(self, state: AutopilotState, view: TickView) -> tuple[AutopilotState, MonitorReport]:
        """Whether heartbeats come."""
        if view.autopilot_alive:
            return state, NOTHING
        if state.heartbeat_ns is None:
            return state, MonitorReport({"link_lost": "no heartbeat from the autopilot yet"})
        silent_s = (view.t_ns - state.heartbeat_ns) * 1e-9
        return state, MonitorReport({"link_lost": f"no heartbeat from the autopilot for {silent_s:.1f} s"})


def changes(before: Heartbeat | None, heartbeat: Heartbeat) -> dict[Event, str]:
    """Events of a heartbeat that is no longer armed or in MANUAL as the one before was."""
    events: dict[Event, str] = {}
    if before is not None and before.armed and not heartbeat.armed:
        events["disarmed"] = "the autopilot was disarmed"
    if before is not None and before.custom_mode == MANUAL != heartbeat.custom_mode:
        events["mode_changed"] = f"the autopilot's mode was changed to {heartbeat.custom_mode}"
    return events


def is_alive(heartbeat_ns: int | None, t_ns: int) -> bool:
    """Whether the autopilot is alive at `t_ns`: its latest heartbeat [ns] is not too old."""
    return heartbeat_ns is not None and t_ns - heartbeat_ns <= HEARTBEAT_LOST_NS


def is_asked_to_arm(state: AutopilotState) -> bool:
    """Whether arming is what `prepare` asks for: in MANUAL it is, and not armed."""
    heartbeat = state.heartbeat
    return heartbeat is not None and heartbeat.custom_mode == MANUAL and not heartbeat.armed


def prepare(state: AutopilotState, t_ns: int) -> tuple[AutopilotState, list[VehicleRequest], str]:
    """One tick before driving: requests to send now, and what is waited for (empty: ready)."""
    heartbeat = state.heartbeat
    if heartbeat is None:
        return state, [], "waiting for the autopilot"
    if heartbeat.custom_mode == MANUAL and heartbeat.armed:
        return replace(state, asked_ns=None), [], ""
    missing = "MANUAL" if heartbeat.custom_mode != MANUAL else "armed"
    why = f"waiting for the autopilot to be {missing}"
    if state.asked_ns is not None and t_ns - state.asked_ns < RETRY_NS:
        return state, [], why
    if missing == "MANUAL":
        request = VehicleRequest(t_ns=t_ns, action="set_mode", custom_mode=MANUAL)
    else:
        request = VehicleRequest(t_ns=t_ns, action="arm")
    return replace(state, asked_ns=t_ns), [request], why
