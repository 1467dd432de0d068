"""The autopilot as its heartbeats show it: getting it to let us drive, and noticing who takes that away.

Overrides flow from the first tick; then MANUAL is asked for, then arming, each again every second. Somebody
else's disarm or mode change is an event of the mode table (`modes`): what was MANUAL or armed no longer is.
Without a receiver the autopilot boots into HOLD and stays there until overrides flow.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from companion.core.messages import Heartbeat, VehicleRequest
from companion.core.pilot.modes import Event

MANUAL = 0
"""ArduPilot Rover's custom mode in which RC overrides reach the thrusters."""
RETRY_NS = 1_000_000_000
"""Between repeated requests; assumed: an answer shows in the next heartbeat, 1 s later."""
HEARTBEAT_LOST_NS = 3_000_000_000
"""Heartbeats come at 1 Hz; three missing are a lost autopilot (assumed)."""


@dataclass(frozen=True)
class AutopilotState:
    """What is known of the autopilot, and when something was last asked of it."""

    heartbeat: Heartbeat | None = None
    asked_ns: int | None = None


UNKNOWN = AutopilotState()


def hear(vehicle: AutopilotState, heartbeat: Heartbeat) -> tuple[AutopilotState, list[tuple[Event, str]]]:
    """A heartbeat, and what it takes away of what the one before showed, in words."""
    before, events = vehicle.heartbeat, []
    if before is not None and before.armed and not heartbeat.armed:
        events.append(("disarmed", "the autopilot was disarmed"))
    if before is not None and before.custom_mode == MANUAL != heartbeat.custom_mode:
        events.append(("mode_changed", f"the autopilot's mode was changed to {heartbeat.custom_mode}"))
    return replace(vehicle, heartbeat=heartbeat), events


def silence(vehicle: AutopilotState, t_ns: int) -> str | None:
    """Why the autopilot counts as lost, or None."""
    if vehicle.heartbeat is None:
        return "no heartbeat from the autopilot yet"
    silent_ns = t_ns - vehicle.heartbeat.t_ns
    if silent_ns > HEARTBEAT_LOST_NS:
        return f"no heartbeat from the autopilot for {silent_ns * 1e-9:.1f} s"
    return None


def prepare(vehicle: AutopilotState, t_ns: int) -> tuple[AutopilotState, list[VehicleRequest], str]:
    """One tick on the way to driving: what to ask for now, and what is waited for (empty: ready)."""
    heartbeat = vehicle.heartbeat
    if heartbeat is None:
        return vehicle, [], "waiting for the autopilot"
    if heartbeat.custom_mode == MANUAL and heartbeat.armed:
        return replace(vehicle, asked_ns=None), [], ""
    wanted = "MANUAL" if heartbeat.custom_mode != MANUAL else "armed"
    why = f"waiting for the autopilot to be {wanted}"
    if vehicle.asked_ns is not None and t_ns - vehicle.asked_ns < RETRY_NS:
        return vehicle, [], why
    if wanted == "MANUAL":
        request = VehicleRequest(t_ns=t_ns, action="set_mode", custom_mode=MANUAL)
    else:
        request = VehicleRequest(t_ns=t_ns, action="arm")
    return replace(vehicle, asked_ns=t_ns), [request], why
