"""The excitation file: manoeuvres one after the other, as shares of what the thrusters can do.

Reference: docs/excite.md. `excitation_toml` writes what `load_excitation` reads.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

import msgspec

from companion.core.configuration import file_kinds
from companion.core.configuration.tables import ConfigError, Table, parse_toml

Share = Annotated[float, msgspec.Meta(ge=-1, le=1)]
Amplitude = Annotated[float, msgspec.Meta(ge=0, le=1)]
Seconds = Annotated[float, msgspec.Meta(gt=0, le=600)]
Levels = Annotated[tuple[Share, ...], msgspec.Meta(min_length=1, max_length=200)]


class _Segment(Table, frozen=True, kw_only=True):
    """Base of all kinds. `name`: in logs and tables; `why`: what it shows, as text."""

    name: Annotated[str, msgspec.Meta(min_length=1)]
    why: str = ""


class Steps(_Segment, frozen=True, kw_only=True, tag="steps", tag_field="kind"):
    """Body force level x [X, Y, N], each level held; shares of the largest force along each axis alone."""

    X: Share = 0.0
    Y: Share = 0.0
    N: Share = 0.0
    levels: Levels = (1.0,)
    hold_s: Seconds


class Zigzag(_Segment, frozen=True, kw_only=True, tag="zigzag", tag_field="kind"):
    """Nomoto's zig-zag: X held, N changes sides when the heading has turned by `switch_deg` from the start's."""

    X: Share
    N: Annotated[float, msgspec.Meta(gt=0, le=1)]
    switch_deg: Annotated[float, msgspec.Meta(gt=0, le=90)]
    duration_s: Seconds


class Multisine(_Segment, frozen=True, kw_only=True, tag="multisine", tag_field="kind"):
    """Sines of equal size with Schroeder's phases; the axes share out the harmonics of 1 / `period_s`."""

    X: Amplitude = 0.0
    Y: Amplitude = 0.0
    N: Amplitude = 0.0
    period_s: Annotated[float, msgspec.Meta(ge=2, le=120)]
    f_max_Hz: Annotated[float, msgspec.Meta(gt=0, le=2)]
    periods: Annotated[int, msgspec.Meta(ge=1, le=100)] = 1


class Pulses(_Segment, frozen=True, kw_only=True, tag="pulses", tag_field="kind"):
    """One thruster at a time (all, where none is named): each level on, then off; shares of its own limit."""

    thrusters: tuple[str, ...] = ()
    levels: Levels
    on_s: Seconds
    off_s: Seconds


class Opposed(_Segment, frozen=True, kw_only=True, tag="opposed", tag_field="kind"):
    """Thrusters against each other, so that by the file nothing moves: what moves is a difference of gains."""

    levels: Levels
    hold_s: Seconds


class Idle(_Segment, frozen=True, kw_only=True, tag="idle", tag_field="kind"):
    """No force: drift and biases."""

    duration_s: Seconds


Segment = Steps | Zigzag | Multisine | Pulses | Opposed | Idle


class Excitation(Table, frozen=True, kw_only=True):
    """Segments in order. `margin_m`: kept from the fence; before a segment begins, and after the last, the boat
    goes back to within `return_m` of the middle at up to `return_speed_m_s`. `caution`: the boat may be so many times
    as heavy, its drag and thrust so many times weaker, than the vessel file says. All assumed.

    `homing` false: the boat never drives back by itself; it drifts between its segments. For thrusters of which nobody
    knows yet which way they push.
    """

    FILE: ClassVar = file_kinds.EXCITATION
    format: Literal[1]
    name: str
    margin_m: Annotated[float, msgspec.Meta(ge=0, le=50)] = 1.5
    return_m: Annotated[float, msgspec.Meta(ge=0.5, le=50)] = 3.0
    return_speed_m_s: Annotated[float, msgspec.Meta(gt=0, le=2)] = 0.6
    caution: Annotated[float, msgspec.Meta(ge=1, le=5)] = 1.5
    homing: bool = True
    segments: Annotated[tuple[Segment, ...], msgspec.Meta(min_length=1, max_length=500)]


def load_excitation(text: str, *, name: str) -> Excitation:
    """Excitation file text -> Excitation. Raises ConfigError naming file and key."""
    excitation = parse_toml(text, Excitation, name=name)
    for i, segment in enumerate(excitation.segments):
        if problem := _problem(segment):
            raise ConfigError(f"{name}: segments[{i}].{problem}")
    return excitation


def _problem(s: Segment) -> str | None:
    """What no single key can know to be wrong."""
    if isinstance(s, Steps | Multisine) and not (s.X or s.Y or s.N):
        return "X: expected a share other than 0 for at least one of X, Y, N"
    if isinstance(s, Multisine) and harmonics_count(s) < axes_count(s):
        return f"f_max_Hz: expected at least {axes_count(s)} / period_s: one harmonic for each axis"
    return None


def axes_count(s: Multisine) -> int:
    """How many axes are excited."""
    return sum(share > 0 for share in (s.X, s.Y, s.N))


def harmonics_count(s: Multisine) -> int:
    """How many harmonics of 1 / `period_s` lie at or below `f_max_Hz`."""
    return int(s.f_max_Hz * s.period_s + 1e-9)


def excitation_toml(excitation: Excitation, comment: str = "") -> str:
    """The excitation as TOML text."""
    data = msgspec.to_builtins(excitation)
    segments = data.pop("segments")
    lines = [f"# {line}".rstrip() for line in comment.splitlines()] + _pairs(data)
    for segment in segments:
        lines += ["", "[[segments]]", *_pairs(segment)]
    return "\n".join(lines) + "\n"


def _pairs(table: Mapping[str, Any]) -> list[str]:
    return [f"{key} = {_value(value)}" for key, value in table.items()]


def _value(value: Any) -> str:
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")  # TOML's strings, but for DEL
    return repr(value)
