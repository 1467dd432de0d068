"""What every struct that the boat sends to the shore begins with."""

from __future__ import annotations

import msgspec

VERSION = 1


class ShoreMessage(msgspec.Struct, frozen=True, kw_only=True):
    """`v`: version of the struct; `run`: names this run of the boat's program; `t_ns`: the boat's monotonic clock."""

    v: int = VERSION
    run: str
    t_ns: int
