"""What a parameter file would change on an autopilot, and what of it takes effect at the next boot only. Pure."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping

import msgspec

from companion.core.preflight.rows import ParameterSet

_REBOOT = re.compile(
    r"SCR_ENABLE|SCHED_LOOP_RATE|FRAME_CLASS|FRAME_TYPE|BRD_\w+|SERVO_32_ENABLE|SERVO\d+_FUNCTION|MAV_SYSID|SYSID_THISMAV"
)
"""ArduPilot's parameter reference, "Reboot required"; functions of outputs: some are set up at boot only."""


class Change(msgspec.Struct, frozen=True, kw_only=True):
    """One line of the difference. `name`: as the autopilot spells it; `found`: None where it has no such parameter."""

    name: str
    found: float | None
    wanted: float

    @property
    def reboot(self) -> bool:
        """Whether it takes effect at the next boot only."""
        return bool(_REBOOT.fullmatch(self.name))


def same(a: float, b: float) -> bool:
    """Equal as far as the autopilot's 32-bit numbers can tell."""
    return math.isclose(a, b, rel_tol=1e-6, abs_tol=1e-6)


def changes(stored: Mapping[str, float], wanted: Mapping[str, float]) -> list[Change]:
    """What differs between an autopilot and a file, in the file's order; names as the autopilot spells them."""
    p = ParameterSet(stored)
    all_changes = [Change(name=p.spelled(name), found=p.get(name), wanted=value) for name, value in wanted.items()]
    return [c for c in all_changes if c.found is None or not same(c.found, c.wanted)]


def unknown(differences: Iterable[Change]) -> list[str]:
    """Names that the autopilot does not have."""
    return [c.name for c in differences if c.found is None]
