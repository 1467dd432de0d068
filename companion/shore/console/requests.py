"""Bodies of the page's requests, and what it says over its WebSocket."""

from __future__ import annotations

from typing import Annotated

import msgspec

from companion.core.telemetry.order_gate import Command, MissionFile
from companion.core.telemetry.sticks import Share
from companion.shore.console.store import BOATS, NAME

PageName = Annotated[str, msgspec.Meta(pattern=r"^[A-Za-z0-9-]{8,40}\Z")]
"""Random, one for each page that is open."""
BoatName = Annotated[str, msgspec.Meta(pattern=NAME)]


class BrowserRequest(msgspec.Struct, forbid_unknown_fields=True):
    """Body of POST /order. `page`: whose sticks drive after `manual`. `given_ms`: when, on the console's clock."""

    boat: BoatName
    command: Command
    mission: MissionFile | None = None
    page: PageName | None = None
    given_ms: float | None = None


class DriveThereRequest(msgspec.Struct, forbid_unknown_fields=True):
    """Body of POST /drive_there: a mission of one point. `leave`: the mission that is driven is left for it.

    `given_ms`: as in BrowserRequest.
    """

    boat: BoatName
    mission: MissionFile
    leave: bool
    given_ms: float | None = None


class StopRequest(msgspec.Struct, forbid_unknown_fields=True):
    """Body of POST /stop: to all of these at once."""

    boats: Annotated[list[BoatName], msgspec.Meta(min_length=1, max_length=BOATS)]


class StickPlace(msgspec.Struct, forbid_unknown_fields=True):
    """Where a page's sticks are, at `t_ms` of the console's clock as the page knows it; as `StickSample`."""

    page: PageName
    boat: BoatName
    t_ms: float
    held: bool
    surge: Share
    sway: Share
    yaw: Share


class BrowserWord(msgspec.Struct):
    """Message of a page over its WebSocket: the boat that it shows, or its sticks."""

    choose: str | None = None
    sticks: StickPlace | None = None
