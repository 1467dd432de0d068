"""Why the autopilot refuses to arm, in its own words: what `starting` waits for.

ArduPilot says each reason in a STATUSTEXT that begins with "Arm: " or "PreArm: ", and answers the request with a
COMMAND_ACK that is not "accepted" (observed). The request is repeated every second (`autopilot_state`), and so is
that.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import msgspec
from msgspec.structs import replace

from companion.core.messages import Alert, CommandAck, Heartbeat, StatusText
from companion.core.pilot.monitors.monitor import NOTHING, Monitor, MonitorReport

ARM_DISARM, ACCEPTED, IN_PROGRESS = 400, 0, 5
"""MAV_CMD_COMPONENT_ARM_DISARM; MAV_RESULT."""
RESULTS = {1: "temporarily rejected", 2: "denied", 3: "unsupported", 4: "failed", 6: "cancelled"}
STANDS_NS = 3_000_000_000
"""How long a reason stands that is not repeated; assumed: three requests."""


class ArmingRefusals(msgspec.Struct, frozen=True):
    """`reasons`: (text, instant [ns] when last heard), oldest first; `refused`: the latest answer that was no; `told`:
    reasons of which there has been an alert since it was last armed.
    """

    reasons: tuple[tuple[str, int], ...] = ()
    refused: tuple[str, int] | None = None
    told: frozenset[str] = frozenset()


class ArmingMonitor(Monitor[ArmingRefusals]):
    """Keeps what the autopilot says against arming; forgets it once it is armed."""

    hears = (Heartbeat, StatusText, CommandAck)
    initial = ArmingRefusals()

    def on_message(self, state: ArmingRefusals, message: Any, t_ns: int) -> tuple[ArmingRefusals, MonitorReport]:
        """A heartbeat, a text or an answer."""
        if isinstance(message, Heartbeat):
            return ArmingRefusals() if message.armed else state, NOTHING
        if isinstance(message, StatusText):
            kind, colon, reason = message.text.partition(": ")
            if not colon or kind not in ("Arm", "PreArm"):
                return state, NOTHING
            others = tuple((text, heard_ns) for text, heard_ns in state.reasons if text != reason)
            return replace(state, reasons=(*_standing(others, t_ns), (reason, t_ns))), NOTHING
        if message.command == ARM_DISARM and message.result not in (ACCEPTED, IN_PROGRESS):
            text = RESULTS.get(message.result, f"result {message.result}")
            return replace(state, refused=(text, t_ns)), NOTHING
        return state, NOTHING


def explain(state: ArmingRefusals, t_ns: int) -> tuple[ArmingRefusals, str, list[Alert]]:
    """While arming is asked for: what stands against it at `t_ns` [ns] (empty: nothing), and alerts of what is new."""
    reasons = [text for text, _ in _standing(state.reasons, t_ns)]
    if not reasons and state.refused and t_ns - state.refused[1] <= STANDS_NS:
        reasons = [f"without a reason ({state.refused[0]})"]
    new = [text for text in reasons if text not in state.told]
    if new:
        state = replace(state, told=state.told | set(new))
    alerts = [Alert(t_ns=t_ns, level="warning", text=f"the autopilot refuses to arm: {text}") for text in new]
    return state, "; ".join(reasons), alerts


def _standing(reasons: Iterable[tuple[str, int]], t_ns: int) -> list[tuple[str, int]]:
    return [(text, heard_ns) for text, heard_ns in reasons if t_ns - heard_ns <= STANDS_NS]
