"""Getting the autopilot to let us drive: overrides first, then MANUAL, then armed; and noticing when it ends.

    waiting --ready--> arming --armed and MANUAL--> driving --taken away or unfit--> stopped
    any --operator stop--> stopped;  stopped --operator start--> waiting

Somebody else's disarm or mode change is respected: it takes an operator's start to drive again. Without a
receiver the autopilot boots into HOLD and stays there until overrides flow: they do from the first tick.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from companion.core.messages import Alert, Heartbeat, Message, VehicleRequest

MANUAL = 0
"""ArduPilot Rover's custom mode in which RC overrides reach the thrusters."""
RETRY_NS = 1_000_000_000
"""Between repeated requests; assumed: an answer shows in the next heartbeat, 1 s later."""
HEARTBEAT_LOST_NS = 3_000_000_000
"""Heartbeats come at 1 Hz; three missing are a lost autopilot (assumed)."""

Phase = Literal["waiting", "arming", "driving", "stopped"]


@dataclass(frozen=True)
class Vehicle:
    """What is known of the autopilot, and how far we are. `why`: what is waited for, in words."""

    phase: Phase = "stopped"
    why: str = "waiting for the operator's start"
    heartbeat: Heartbeat | None = None
    asked_ns: int = 0


STOPPED = Vehicle()


def advance(vehicle: Vehicle, t_ns: int, *, unfit: str | None) -> tuple[Vehicle, list[Message]]:
    """One tick. `unfit`: why the boat may not drive now (estimator, mission), None where it may."""
    trouble = _link_trouble(vehicle.heartbeat, t_ns) or unfit
    if vehicle.phase == "waiting":
        vehicle = replace(vehicle, why=trouble or "")
        if not trouble:
            vehicle = replace(vehicle, phase="arming", asked_ns=0)
    if vehicle.phase == "arming":
        return _arm(vehicle, t_ns, trouble)
    if vehicle.phase == "driving" and trouble:
        return _stop(vehicle, t_ns, trouble)
    return vehicle, []


def hear(vehicle: Vehicle, heartbeat: Heartbeat, t_ns: int) -> tuple[Vehicle, list[Message]]:
    """A heartbeat; one that takes the driving away counts at once, and is not undone by the next."""
    vehicle = replace(vehicle, heartbeat=heartbeat)
    taken = _taken_away(heartbeat) if vehicle.phase == "driving" else None
    return _stop(vehicle, t_ns, taken) if taken else (vehicle, [])


def _stop(vehicle: Vehicle, t_ns: int, why: str) -> tuple[Vehicle, list[Message]]:
    text = f"stopped: {why}; thrusters are neutral until the operator starts again"
    return replace(vehicle, phase="stopped", why=why), [Alert(t_ns=t_ns, level="error", text=text)]


def _arm(vehicle: Vehicle, t_ns: int, trouble: str | None) -> tuple[Vehicle, list[Message]]:
    heartbeat = vehicle.heartbeat
    if trouble or heartbeat is None:
        return replace(vehicle, phase="waiting", why=trouble or "no heartbeat"), []
    if heartbeat.custom_mode == MANUAL and heartbeat.armed:
        return replace(vehicle, phase="driving", why=""), []
    wanted = "MANUAL" if heartbeat.custom_mode != MANUAL else "armed"
    vehicle = replace(vehicle, why=f"waiting for the autopilot to be {wanted}")
    if t_ns - vehicle.asked_ns < RETRY_NS:
        return vehicle, []
    if wanted == "MANUAL":
        request = VehicleRequest(t_ns=t_ns, action="set_mode", custom_mode=MANUAL)
    else:
        request = VehicleRequest(t_ns=t_ns, action="arm")
    return replace(vehicle, asked_ns=t_ns), [request]


def _link_trouble(heartbeat: Heartbeat | None, t_ns: int) -> str | None:
    if heartbeat is None:
        return "no heartbeat from the autopilot yet"
    silent_ns = t_ns - heartbeat.t_ns
    if silent_ns > HEARTBEAT_LOST_NS:
        return f"no heartbeat from the autopilot for {silent_ns * 1e-9:.1f} s"
    return None


def _taken_away(heartbeat: Heartbeat) -> str | None:
    if not heartbeat.armed:
        return "the autopilot was disarmed"
    if heartbeat.custom_mode != MANUAL:
        return f"the autopilot's mode was changed to {heartbeat.custom_mode}"
    return None
