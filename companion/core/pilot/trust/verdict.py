"""What the tests of this room say, and what becomes of the estimate for it.

A verdict names the kind of what is wrong, how much speaks for it [nats], and the sentence for the operator. Verdicts
on sensors are latched until the operator starts anew: an estimate that was contradicted does not call itself healthy.
"""

from __future__ import annotations

from typing import Literal

import msgspec
from msgspec.structs import replace

from companion.core.messages import OperatorCommand, StateEstimate

Cause = Literal["sensor", "thruster", "surroundings"]


class Finding(msgspec.Struct, frozen=True):
    """`cause`; `what`: which sensor, thruster or force, in words; `text`: for the operator; `t_ns`: since when;
    `bearable`: the estimate is as sound as it was.
    """

    cause: Cause
    what: str
    text: str
    t_ns: int
    nats: float = 0.0
    bearable: bool = False


def is_forgotten(findings: tuple[Finding, ...], order: OperatorCommand) -> bool:
    """Whether a monitor begins anew after an order: a new start forgets what was found, a stop does not."""
    return bool(findings) and order.command != "stop"


def vet(estimate: StateEstimate, findings: tuple[Finding, ...]) -> StateEstimate:
    """The estimate with the health that findings on sensors leave it."""
    findings = tuple(f for f in findings if not f.bearable)
    if not findings or estimate.health in ("initialising", "lost"):
        return estimate
    reasons = [f.text for f in findings] + ([estimate.reason] if estimate.reason else [])
    return replace(estimate, health="degraded", reason="; ".join(reasons))
