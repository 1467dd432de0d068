"""What every struct that the boat sends to the shore begins with."""

from __future__ import annotations

from typing import Annotated

import msgspec

VERSION = 1
# Telemetry is anybody's, and the name is shown to people, on terminals too, and told to boats (`Order.heard`).
RunName = Annotated[str, msgspec.Meta(pattern=r"^[A-Za-z0-9_.-]{0,64}\Z")]


class ShoreMessage(msgspec.Struct, frozen=True, kw_only=True):
    """`v`: version of the struct; `run`: names this run of the boat's program; `t_ns`: the boat's monotonic clock."""

    v: int = VERSION
    run: RunName
    t_ns: int
