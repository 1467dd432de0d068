"""The campaign file: what to run, with which seeds, and what differs between cases. Reference: docs/campaign.md."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal

import msgspec

from companion.core.configuration import file_kinds
from companion.core.configuration.tables import ConfigError, Table, parse_toml
from sim.campaign.dotted_keys import Value, flat

Positive = Annotated[float, msgspec.Meta(gt=0)]
LARGEST = 2**53
"""Whole numbers up to this are themselves as fractions, too, and in every table."""
Seed = Annotated[int, msgspec.Meta(ge=0, le=LARGEST)]
Kind = Literal["missions", "identify", "diagnose"]
ROLES = {
    "missions": ("run", "vessel", "site", "mission", "truth"),
    "identify": ("vessel", "truth", "site", "log", "held_out"),
    "diagnose": ("vessel", "truth", "site", "log", "held_out", "reference"),
}
"""Files that a kind knows."""
LOGS = ("log", "held_out", "reference")
"""Roles of logs; the others are text."""


class SeedRange(Table, frozen=True, kw_only=True):
    """Seeds `first`, `first` + 1, .. in all `count`."""

    count: Annotated[int, msgspec.Meta(ge=1, le=1_000_000)]
    first: Seed = 1


class Missions(Table, frozen=True, kw_only=True):
    """A mission ends once the boat has kept station for `station_s`, or after `limit_s`; simulated seconds."""

    limit_s: Annotated[float, msgspec.Meta(gt=0, le=86400)] = 240.0
    station_s: Annotated[float, msgspec.Meta(gt=0, le=3600)] = 10.0

    def __post_init__(self) -> None:
        if self.limit_s <= self.station_s:
            raise ValueError(f"limit_s: expected more than station_s ({self.station_s:g} s)")


class Identify(Table, frozen=True, kw_only=True):
    """`drive_s`: the log is a simulated drive of so long, by the case's seed; `block_s`: as `--block`."""

    drive_s: Annotated[float, msgspec.Meta(ge=50, le=3600)] | None = None
    block_s: Positive | None = None
    taylor: bool = False


class Diagnose(Table, frozen=True, kw_only=True):
    """As in `Identify`. `reference_s`: a simulated drive of the boat as believed, in calm, is the reference log."""

    drive_s: Annotated[float, msgspec.Meta(ge=50, le=3600)] | None = None
    reference_s: Annotated[float, msgspec.Meta(ge=50, le=3600)] | None = None
    block_s: Positive | None = None


Settings = Missions | Identify | Diagnose
SETTINGS: dict[str, type[Missions] | type[Identify] | type[Diagnose]] = {
    "missions": Missions,
    "identify": Identify,
    "diagnose": Diagnose,
}


class Draw(Table, frozen=True, kw_only=True):
    """One number from the case's seed: uniform or log-uniform between two, normal (mean, sigma), or one of several."""

    uniform: tuple[float, float] | None = None
    log_uniform: tuple[float, float] | None = None
    normal: tuple[float, float] | None = None
    choice: Annotated[tuple[Value, ...], msgspec.Meta(min_length=1)] | None = None

    def __post_init__(self) -> None:
        given_keys = [name for name in self.__struct_fields__ if getattr(self, name) is not None]
        if len(given_keys) != 1:
            raise ValueError(f"expected one of {', '.join(self.__struct_fields__)}")
        if (span := self.uniform or self.log_uniform) and not span[0] < span[1]:
            raise ValueError(f"{given_keys[0]}: expected the smaller number first")
        if self.uniform and not math.isfinite(self.uniform[1] - self.uniform[0]):
            raise ValueError("uniform: expected numbers that lie closer together")
        if self.log_uniform and self.log_uniform[0] <= 0:
            raise ValueError("log_uniform: expected numbers above 0")
        if self.normal and self.normal[1] <= 0:
            raise ValueError("normal: expected [mean, sigma] with sigma above 0")

    @property
    def examples(self) -> tuple[Value, ...]:
        """Values that must be possible: all of a choice, the ends of a span, the mean."""
        if self.choice:
            return self.choice
        return self.uniform or self.log_uniform or (self.normal or (math.nan,))[:1]


class CampaignText(Table, frozen=True, kw_only=True):
    """The file as it stands."""

    FILE: ClassVar = file_kinds.CAMPAIGN
    format: Literal[1]
    name: Annotated[str, msgspec.Meta(pattern=r"^[A-Za-z0-9_. -]{1,60}\Z")]
    kind: Kind
    seeds: SeedRange | tuple[Seed, ...]
    files: dict[str, str | tuple[str, ...]]
    missions: Missions | None = None
    identify: Identify | None = None
    diagnose: Diagnose | None = None
    set: dict[str, Any] = msgspec.field(default_factory=dict)
    grid: dict[str, Any] = msgspec.field(default_factory=dict)
    draw: dict[str, Any] = msgspec.field(default_factory=dict)


class Campaign(Table, frozen=True, kw_only=True):
    """The file, read: values by dotted key. `files`: paths by role; `grid` of `files.ROLE`: lists of paths."""

    name: str
    kind: Kind
    seeds: tuple[int, ...]
    files: dict[str, tuple[str, ...]]
    settings: Settings
    set: dict[str, Value]
    grid: dict[str, tuple[Any, ...]]
    draw: dict[str, Draw]


def load_campaign(text: str, *, name: str) -> Campaign:
    """Campaign file text -> Campaign. Raises ConfigError naming file and key."""
    document = parse_toml(text, CampaignText, name=name)
    try:
        return _read(document)
    except ValueError as error:
        raise ConfigError(f"{name}: {error}") from None


def _read(document: CampaignText) -> Campaign:
    seeds = tuple(range(document.seeds.first, document.seeds.first + document.seeds.count)) if isinstance(
        document.seeds, SeedRange
    ) else document.seeds  # fmt: skip
    if not seeds or len(set(seeds)) < len(seeds):
        raise ValueError("seeds: expected at least one, each once")
    for other in SETTINGS:
        if other != document.kind and getattr(document, other) is not None:
            raise ValueError(f'{other}: kind is "{document.kind}"')
    for role in document.files:
        if role not in ROLES[document.kind]:
            raise ValueError(
                f"files.{role}: unknown key; of {document.kind} there are {', '.join(ROLES[document.kind])}"
            )
    varied = {key: _varied(key, v) for key, v in flat(document.grid, "grid", lambda v: isinstance(v, list)).items()}
    drawn = {key: _drawn(key, v) for key, v in flat(document.draw, "draw", _is_draw).items()}
    fixed = {key: _fixed(key, v) for key, v in flat(document.set, "set", lambda v: not isinstance(v, dict)).items()}
    for key in [*fixed, *varied, *drawn]:
        if (key in fixed) + (key in varied) + (key in drawn) > 1:
            raise ValueError(f"{key}: stands in more than one of set, grid and draw")
    return Campaign(
        name=document.name,
        kind=document.kind,
        seeds=seeds,
        files={role: (given,) if isinstance(given, str) else given for role, given in document.files.items()},
        settings=getattr(document, document.kind) or SETTINGS[document.kind](),
        set=fixed,
        grid=varied,
        draw=drawn,
    )


def _is_draw(value: Any) -> bool:
    return isinstance(value, Mapping) and bool(set(value) & set(Draw.__struct_fields__))


def _varied(key: str, value: Any) -> tuple[Any, ...]:
    if key.startswith("files."):
        role = key.removeprefix("files.")
        many = tuple(tuple(v) if isinstance(v, list) and role in LOGS else v for v in value)
        rest = [p for v in many for p in (v if isinstance(v, tuple) else (v,))]
        if not many or not all(isinstance(p, str) for p in rest):
            raise ValueError(f"grid.{key}: expected a list of file names")
    else:
        many = _alike(f"grid.{key}", value)
    if len(set(many)) < len(many):
        raise ValueError(f"grid.{key}: a value is there twice")
    return many


def _drawn(key: str, value: Any) -> Draw:
    try:
        draw = msgspec.convert(value, Draw)
    except msgspec.ValidationError as error:
        raise ValueError(f"draw.{key}: {str(error).replace(' - at `$', ' - at `')}") from None
    return msgspec.structs.replace(draw, choice=_alike(f"draw.{key}", draw.choice)) if draw.choice else draw


def _fixed(key: str, value: Any) -> Value:
    if key.startswith("files."):
        raise ValueError(f"set.{key}: files that all cases share stand in [files]")
    return _alike(f"set.{key}", [value])[0]


def _alike(where: str, values: Sequence[Any]) -> tuple[Value, ...]:
    """Values of one kind: texts, yes or no, or numbers; whole ones among fractions become fractions."""
    if not values:
        raise ValueError(f"{where}: expected at least one value")
    kinds = {type(v) for v in values}
    if any(isinstance(v, int) and abs(v) > LARGEST for v in values):
        raise ValueError(f"{where}: expected whole numbers of at most {LARGEST}")
    if kinds == {int, float}:
        return tuple(map(float, values))
    if len(kinds) > 1 or not kinds <= {int, float, str, bool}:
        raise ValueError(f"{where}: expected numbers, texts, or true and false, and not mixed")
    return tuple(values)
