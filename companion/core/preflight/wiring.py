"""The wiring: which output of the autopilot carries which thruster, by SERVOn_FUNCTION, and what stops each kind.

    plain    1, 51 to 66    the channel's last pulse, for ever
    scaled   140 to 155     through RCn_* and SERVOn_*; SERVOn_TRIM in a radio fail-safe where SERVO_RC_FS_MSK says so
    script   94 to 109      Script1-16: the Lua gate, one output a thruster in the vessel file's order; nothing without
                            SCR_ENABLE where another output passes that thruster's channel
    motor    33 to 36       the Omni-X mixer

Behaviour: observed on ArduPilot Rover 4.6 and 4.7 (docs/autopilot.md), but function 1 (RCPassThru): read in its
parameter reference.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from companion.core.preflight.rows import ParameterSet

Kind = Literal["plain", "scaled", "script", "motor", "other"]

OUTPUTS, MORE_OUTPUTS = 16, 32
BAND_US = 25
"""A speed controller stands still within 1475 to 1525 us (Blue Robotics Basic ESC)."""
MOTORS = range(33, 37)


@dataclass(frozen=True)
class Companion:
    """What this companion overrides. `thrusters`: name and RC channel; `still`: channels held at 1500 us.

    `vision`: it also sends its position to the autopilot.
    """

    thrusters: tuple[tuple[str, int], ...]
    still: tuple[int, ...]
    system_id: int
    lease_s: float
    latency_s: float
    vision: bool = False

    @property
    def channels(self) -> frozenset[int]:
        """Every channel that it overrides."""
        return frozenset(channel for _, channel in self.thrusters) | frozenset(self.still)


@dataclass(frozen=True)
class Output:
    """One output of the autopilot. `channel`: what it passes (plain, scaled), `thruster`: whose it is, from 0."""

    number: int
    function: int
    kind: Kind
    channel: int | None
    thruster: int | None


@dataclass(frozen=True)
class Wiring:
    """All outputs that do anything. `kinds`: of those that carry a thruster."""

    outputs: tuple[Output, ...]
    missing: tuple[tuple[str, int], ...]

    def of(self, kind: Kind) -> tuple[Output, ...]:
        """Outputs of a kind that carry a thruster."""
        return tuple(o for o in self.outputs if o.kind == kind and o.thruster is not None)

    @property
    def kinds(self) -> frozenset[Kind]:
        """Kinds of the outputs that carry thrusters."""
        return frozenset(o.kind for o in self.outputs if o.thruster is not None)

    @property
    def omni(self) -> bool:
        """The mixer drives all four motors, and no thruster is wired otherwise."""
        motors = {o.function for o in self.outputs if o.kind == "motor"}
        return motors == set(MOTORS) and not self.kinds


def wiring(p: ParameterSet, companion: Companion) -> Wiring:
    """Read the outputs of a set of parameters."""
    outputs = tuple(_outputs(p, companion))
    if not p.whole("SCR_ENABLE"):
        passed = {o.thruster for o in outputs if o.kind in ("plain", "scaled")}
        outputs = tuple(
            replace(o, thruster=None) if o.kind == "script" and o.thruster in passed else o for o in outputs
        )
    carried = {o.thruster for o in outputs}
    missing = tuple(t for i, t in enumerate(companion.thrusters) if i not in carried)
    return Wiring(outputs, missing)


def output_names(p: ParameterSet) -> range:
    """Numbers of the outputs that exist."""
    return range(1, (MORE_OUTPUTS if p.whole("SERVO_32_ENABLE") else OUTPUTS) + 1)


def untold_functions(p: ParameterSet) -> tuple[str, ...]:
    """Outputs of which nobody knows what they carry: names of the SERVOn_FUNCTION that were not told."""
    return tuple(name for n in output_names(p) if p.get(name := f"SERVO{n}_FUNCTION") is None)


def _outputs(p: ParameterSet, companion: Companion) -> Iterator[Output]:
    channels = [channel for _, channel in companion.thrusters]
    for n in output_names(p):
        if function := p.whole(f"SERVO{n}_FUNCTION"):
            yield output(n, function, channels)


def output(number: int, function: int, channels: Sequence[int]) -> Output:
    """Kind of output `number` by its SERVOn_FUNCTION. `channels`: the thrusters', in the vessel file's order."""
    kind, channel = _kind(function, number)
    thruster = channels.index(channel) if channel in channels else None
    if kind == "script" and function - 94 < len(channels):
        thruster = function - 94
    return Output(number, function, kind, channel, thruster)


def _kind(function: int, number: int) -> tuple[Kind, int | None]:
    """Kind of a function, and the channel that it passes."""
    if function == 1:
        return "plain", number
    if 51 <= function <= 66:
        return "plain", function - 50
    if 140 <= function <= 155:
        return "scaled", function - 139
    if 94 <= function <= 109:
        return "script", None
    return ("motor" if function in MOTORS else "other"), None


def scaled_us(p: ParameterSet, output: Output, value_us: float) -> float:
    """Pulse width [us] of a scaled output for that of its channel: RCn_MIN/TRIM/MAX/DZ/REVERSED, then SERVOn_*."""
    rc, servo = f"RC{output.channel}", f"SERVO{output.number}"
    low, trim, high = p.whole(f"{rc}_MIN", 1100), p.whole(f"{rc}_TRIM", 1500), p.whole(f"{rc}_MAX", 1900)
    zone, part = p.whole(f"{rc}_DZ"), 0.0
    if value_us < trim - zone and trim - zone > low:
        part = max(-1.0, (value_us - trim + zone) / (trim - zone - low))
    elif value_us > trim + zone and high > trim + zone:
        part = min(1.0, (value_us - trim - zone) / (high - trim - zone))
    part = -part if bool(p.whole(f"{rc}_REVERSED")) != bool(p.whole(f"{servo}_REVERSED")) else part
    low, trim, high = p.whole(f"{servo}_MIN", 1100), p.whole(f"{servo}_TRIM", 1500), p.whole(f"{servo}_MAX", 1900)
    return trim + part * (high - trim if part > 0 else trim - low)
