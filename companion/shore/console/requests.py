"""Bodies of the page's requests, and what it says over its WebSocket."""

from __future__ import annotations

from typing import Annotated

import msgspec

from companion.core.telemetry.order_gate import Command, MissionFile
from companion.shore.console.store import BOATS, NAME

BoatName = Annotated[str, msgspec.Meta(pattern=NAME)]


class BrowserRequest(msgspec.Struct, forbid_unknown_fields=True):
    """Body of POST /order."""

    boat: BoatName
    command: Command
    mission: MissionFile | None = None


class DriveThereRequest(msgspec.Struct, forbid_unknown_fields=True):
    """Body of POST /drive_there: a mission of one point. `leave`: the mission that is driven is left for it."""

    boat: BoatName
    mission: MissionFile
    leave: bool


class StopRequest(msgspec.Struct, forbid_unknown_fields=True):
    """Body of POST /stop: to all of these at once."""

    boats: Annotated[list[BoatName], msgspec.Meta(min_length=1, max_length=BOATS)]


class BrowserSelection(msgspec.Struct):
    """Message of a page over its WebSocket: the boat that it shows."""

    choose: str
