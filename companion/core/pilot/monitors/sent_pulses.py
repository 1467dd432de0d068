"""What was sent to the autopilot, and which output carries which thruster: for monitors that compare echoes with it.

A thruster's pulse is on the output that carries it by SERVOn_FUNCTION, and until that parameter has been read, on
outputs 1 to n in the vessel file's order, as our parameter files wire them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import TypeVar

import msgspec
from msgspec.structs import replace

from companion.core.constants import NEUTRAL_US
from companion.core.messages import OverrideLease, ParamValue
from companion.core.preflight.wiring import BAND_US, output

WINDOW_NS = 500_000_000
"""How far back a lease may explain an echo: 0.1 s a tick, 64 ms of the gate at 50 Hz (observed), stamps; assumed."""
SLACK_NS = 50_000_000
"""An echo's stamp may run ahead of the lease it shows, by the error of the clock offset; assumed."""
_FUNCTION = re.compile(r"SERVO([1-9]\d?)_FUNCTION\Z")
_REMEMBERED = 50
"""Leases: at 50 Hz, the quickest period, the window and half a second of delay on the way."""


class SentPulses(msgspec.Struct, frozen=True):
    """`sent`: (from, until [ns], pulses [us]) of the latest leases; `carries`: output (from 1) -> thruster (from 0)."""

    sent: tuple[tuple[int, int, tuple[int, ...]], ...] = ()
    carries: Mapping[int, int] = msgspec.field(default_factory=dict)


State = TypeVar("State", bound=SentPulses)


def nothing_turns(pulses_us: Iterable[int]) -> bool:
    """Whether no thruster turns at these pulse widths [us]: none, or within the speed controllers' band of rest."""
    return all(pulse == 0 or abs(pulse - NEUTRAL_US) <= BAND_US for pulse in pulses_us)


def at_lease(state: State, lease: OverrideLease) -> State:
    """Remember what was sent."""
    until_ns = lease.t_ns + round(lease.valid_for_s * 1e9)
    return replace(state, sent=(*state.sent, (lease.t_ns, until_ns, lease.pwm_us))[-_REMEMBERED:])


def expected_pulses(state: SentPulses, t_ns: int) -> list[tuple[int, ...]]:
    """Pulses that an echo of `t_ns` may show, in the order of the lease's channels; none: nothing was sent by then."""
    expected: list[tuple[int, ...]] = []
    for k, (begin_ns, end_ns, pwm_us) in enumerate(state.sent):
        if begin_ns > t_ns + SLACK_NS:
            break
        after_ns = min(t_ns + SLACK_NS, state.sent[k + 1][0] if k + 1 < len(state.sent) else t_ns + SLACK_NS)
        if min(end_ns, after_ns) >= t_ns - WINDOW_NS:
            expected.append(pwm_us)
        if end_ns < after_ns and after_ns >= t_ns - WINDOW_NS:
            expected.append((NEUTRAL_US,) * len(pwm_us))
    return expected


def at_parameter(state: State, message: ParamValue, channels: Sequence[int]) -> State:
    """SERVOn_FUNCTION says which thruster output n carries. `channels`: the thrusters'."""
    if not (name := _FUNCTION.match(message.name)) or not math.isfinite(message.value):
        return state
    number = int(name[1])
    carries = {n: thruster for n, thruster in state.carries.items() if n != number}
    thruster = output(number, round(message.value), channels).thruster
    return replace(state, carries=carries if thruster is None else {**carries, number: thruster})


def scripted_output(message: ParamValue) -> dict[int, bool]:
    """SERVOn_FUNCTION as {n: whether a script writes output n}; nothing of other parameters."""
    if not (name := _FUNCTION.match(message.name)) or not math.isfinite(message.value):
        return {}
    return {int(name[1]): output(int(name[1]), round(message.value), ()).kind == "script"}


def outputs_of(state: SentPulses, thrusters: int) -> list[int]:
    """The output (from 1) of each thruster: the lowest that carries it; its own number where none is known to."""
    carried = {thruster: number for number, thruster in sorted(state.carries.items(), reverse=True)}
    return [carried.get(thruster, thruster + 1) for thruster in range(thrusters)]
