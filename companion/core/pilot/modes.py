"""What the boat does whatever happens: one table of modes and events, and nothing beside it.

A row is an event, a column the mode in which it comes, an entry the mode after it: `.` stays, `wanted` is the
mode that was asked for. What the thrusters do follows from the mode alone (`THRUSTERS`), what the operator reads
from the entry (`sentence`). Reference for people: docs/modes.md.

    idle        nothing was asked for
    starting    something was: neutral until nothing of `NEEDS` stands against it and the autopilot is ready
    auto        the mission                       hold      station keeping
    excitation  an excitation is flown            paused    ... waits, in neutral, for a healthy estimate
    manual      sticks                            locked    ... in neutral until the sticks have been at rest
    safe        something took the driving away: neutral until the operator asks for a mode

Events that last are conditions: `on` when they begin, `OVER[event]` when they end. In a mode, or for a mode that
is asked for, those of its NEEDS count for as long as they last; the others once, as they begin.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, get_args

from companion.core.messages import Alert, Mode

Wanted = Literal["auto", "hold", "excitation"]
Thrusters = Literal["neutral", "controller", "excitation", "sticks"]
Event = Literal[
    "link_lost", "unfit", "degraded", "fence_breached", "battery_low", "battery_critical", "override_ignored",
    "solver_failing", "loop_lag", "link_late",
    "link_back", "fit", "healthy", "fence_clear", "battery_ok", "override_obeyed", "solver_back", "loop_ok",
    "link_prompt",
    "rc_takeover", "disarmed", "mode_changed", "sticks_lost",
    "ready", "finished", "stop", "start", "hold", "excite", "manual",
]  # fmt: skip

MODES: tuple[Mode, ...] = get_args(Mode)
EVENTS: tuple[Event, ...] = get_args(Event)
_TURNING: dict[Mode, Thrusters] = {
    "auto": "controller",
    "hold": "controller",
    "excitation": "excitation",
    "manual": "sticks",
}
THRUSTERS: dict[Mode, Thrusters] = {mode: _TURNING.get(mode, "neutral") for mode in MODES}

_ROWS = """
                 idle     starting auto     hold     excitation paused     locked   manual   safe
link_lost        .        .        safe     safe     safe       safe       .        safe     .
unfit            .        .        safe     safe     safe       safe       .        .        .
degraded         .        .        .        .        paused     .          .        .        .
fence_breached   .        safe     safe     safe     safe       safe       .        safe     .
battery_low      .        .        .        .        .          .          .        .        .
battery_critical .        safe     safe     safe     safe       safe       .        .        .
override_ignored .        .        safe     safe     safe       safe       .        safe     .
solver_failing   .        .        hold     .        .          .          .        .        .
loop_lag         .        .        safe     safe     safe       safe       .        safe     .
link_late        .        .        safe     safe     safe       safe       .        safe     .

link_back        .        .        .        .        .          .          .        .        .
fit              .        .        .        .        .          .          .        .        .
healthy          .        .        .        .        .          excitation .        .        .
fence_clear      .        .        .        .        .          .          .        .        .
battery_ok       .        .        .        .        .          .          .        .        .
override_obeyed  .        .        .        .        .          .          .        .        .
solver_back      .        .        .        .        .          .          .        .        .
loop_ok          .        .        .        .        .          .          .        .        .
link_prompt      .        .        .        .        .          .          .        .        .

rc_takeover      .        safe     safe     safe     safe       safe       safe     safe     .
disarmed         .        safe     safe     safe     safe       safe       safe     safe     .
mode_changed     .        .        safe     safe     safe       safe       safe     safe     .
sticks_lost      .        .        .        .        .          .          .        locked   .

ready            .        wanted   .        .        .          .          manual   .        .
finished         .        .        .        .        idle       .          .        .        .
stop             .        idle     idle     idle     idle       idle       idle     idle     idle
start            starting starting .        auto     auto       starting   starting starting starting
hold             starting starting hold     .        hold       starting   starting starting starting
excite           starting starting starting starting .          .          starting starting starting
manual           locked   locked   locked   locked   locked     locked     .        .        locked
"""

OVER: dict[Event, Event] = {
    "link_lost": "link_back",
    "unfit": "fit",
    "degraded": "healthy",
    "fence_breached": "fence_clear",
    "battery_low": "battery_ok",
    "override_ignored": "override_obeyed",
    "solver_failing": "solver_back",
    "loop_lag": "loop_ok",
    "link_late": "link_prompt",
}
"""Condition -> the event of its end. battery_critical has none: battery_low goes on."""


def _events(*events: Event) -> frozenset[Event]:
    return frozenset(events)


_ALL = _events("link_lost", "override_ignored", "loop_lag", "link_late")
_KNOWING = _ALL | _events("unfit", "fence_breached", "battery_critical")
_NEEDS: dict[Mode, frozenset[Event]] = {
    "locked": _ALL,
    "manual": _ALL,
    "auto": _KNOWING,
    "hold": _KNOWING,
    "excitation": _KNOWING | _events("degraded"),
    "paused": _KNOWING,
}
NEEDS: dict[Mode, frozenset[Event]] = {mode: _NEEDS.get(mode, _events()) for mode in MODES}
"""Mode -> conditions under which its thrusters may not turn. By hand a boat may be fetched from beyond the fence,
with an empty battery and without an estimate."""

WANTED: dict[Event, Wanted] = {"start": "auto", "hold": "hold", "excite": "excitation"}
_OPERATOR = _events("stop", "start", "hold", "excite", "manual")
_CALM = _OPERATOR | _events("ready", "finished", *OVER.values())
_TOLD_AT_REST = _events(
    "fence_breached", "battery_low", "battery_critical", "override_ignored", "fence_clear", "battery_ok"
)
"""Told in neutral, too."""
_TOLD_ELSEWHERE = _events("link_lost", "unfit", "degraded")
"""The links and the estimate speak for themselves where nothing changes."""

_HINTS: dict[Event, str] = {
    "fence_breached": "fetch it by hand (manual)",
    "battery_low": "bring the boat home",
    "battery_critical": "bring the boat home, by hand if need be, and change the pack",
    "solver_failing": "the processor is too slow or busy, or the problem has no solution; the log has each reason",
    "loop_lag": "something keeps the processor: see `aritra log` for lateness",
    "link_late": "look for a radio, a router or a full buffer on the way to the autopilot",
    "rc_takeover": "the pilot on the sticks has it",
}


class ModeOutcome(NamedTuple):
    """One entry of the table. `next` may be `wanted`."""

    next: Mode | Literal["wanted"]

    @property
    def thrusters(self) -> Thrusters | Literal["as wanted"]:
        """What they do from now on."""
        return "as wanted" if self.next == "wanted" else THRUSTERS[self.next]


def _parse(text: str) -> dict[tuple[Mode, Event], ModeOutcome]:
    header, *lines = (line.split() for line in text.splitlines() if line.strip())
    assert tuple(header) == MODES, "the columns are the modes in their order"
    table: dict = {}
    for event, *cells in lines:
        for mode, cell in zip(MODES, cells, strict=True):
            table[mode, event] = ModeOutcome(mode if cell == "." else cell)  # pyright: ignore[reportArgumentType]
    assert len(table) == len(MODES) * len(EVENTS) and {e for _, e in table} == set(EVENTS), "every pair, once"
    assert {o.next for o in table.values()} <= {*MODES, "wanted"}, "entries are modes"
    return table


TABLE: Mapping[tuple[Mode, Event], ModeOutcome] = _parse(_ROWS)
"""(mode, event) -> outcome, for every pair."""


def sentence(mode: Mode, event: Event, after: Mode, why: str) -> str:
    """What the operator is told of one entry. `why`: the event in words."""
    hint = f" ({_HINTS[event]})" if event in _HINTS else ""
    if after == "safe" and mode != "safe":
        return f"stopped: {why}{hint}; thrusters are neutral until the operator starts again"
    if after == mode:
        effect = "goes on" if THRUSTERS[mode] != "neutral" else "thrusters stay neutral"
        return f"{why}{hint}; {mode} {effect}" if effect == "goes on" else f"{why}{hint}; {effect}"
    if after == "idle":
        return why
    effect = {
        "starting": "thrusters are neutral until all is ready",
        "locked": "thrusters are neutral until the sticks have been at rest",
        "paused": "thrusters are neutral until the estimate is healthy",
        "hold": "the boat keeps station",
    }.get(after, f"{after} drives")
    return f"{why}{hint}; {effect}"


@dataclass(frozen=True)
class ModeState:
    """Who steers. `wanted`: what `starting` is for; `why`: the last change, or what is waited for, in words;
    `lasting`: conditions that were there at the last look.
    """

    mode: Mode = "idle"
    wanted: Wanted = "auto"
    why: str = "waiting for the operator's start"
    lasting: frozenset[Event] = frozenset()

    @property
    def driving(self) -> bool:
        """Whether the thrusters may turn."""
        return THRUSTERS[self.mode] != "neutral"

    @property
    def on_mission(self) -> bool:
        """Whether a mission is driven, or about to be."""
        return self.mode == "auto" or (self.mode == "starting" and self.wanted == "auto")

    @property
    def needs(self) -> frozenset[Event]:
        """Conditions that count for as long as they last."""
        return NEEDS[self.wanted if self.mode == "starting" else self.mode]


AT_REST = ModeState()


def apply_event(helm: ModeState, event: Event, why: str, t_ns: int) -> tuple[ModeState, list[Alert]]:
    """One event through the table: what steers now, and what there is to tell. `why`: the event in words."""
    entry = TABLE[helm.mode, event].next
    after: Mode = helm.wanted if entry == "wanted" else entry
    text = sentence(helm.mode, event, after, why)
    wanted = WANTED.get(event, helm.wanted) if after == "starting" else helm.wanted
    told: list[Alert] = []
    changed = after != helm.mode
    worth = helm.driving and event not in _TOLD_ELSEWHERE
    if event not in _CALM and (changed or worth or event in _TOLD_AT_REST):
        level = "error" if changed and after in ("safe", "hold") else "warning"
        told.append(Alert(t_ns=t_ns, level=level, text=text))
    elif event in _TOLD_AT_REST or (event == "healthy" and changed):
        told.append(Alert(t_ns=t_ns, level="info", text=text))
    return replace(helm, mode=after, wanted=wanted, why=text if changed or after == "starting" else helm.why), told


def apply_conditions(helm: ModeState, conditions: Mapping[Event, str], t_ns: int) -> tuple[ModeState, list[Alert]]:
    """One tick: conditions that began or ended since the last, and those that the mode may not have.

    `conditions`: those there are now, each in words.
    """
    told: list[Alert] = []
    for event in EVENTS:
        if event not in conditions:
            continue
        minds = event in helm.needs
        begun = event not in helm.lasting and (minds or helm.mode != "starting")
        if begun or minds:
            before = helm.mode
            helm, more = apply_event(helm, event, conditions[event], t_ns)
            told += more if begun or helm.mode != before else []
    for event, over in OVER.items():
        if event in helm.lasting and event not in conditions:
            helm, more = apply_event(helm, over, over.replace("_", " "), t_ns)
            told += more
    return replace(helm, lasting=frozenset(conditions)), told


def waits_for(helm: ModeState, conditions: Mapping[Event, str]) -> str | None:
    """What still stands against the mode that is asked for, in words."""
    return next((conditions[event] for event in EVENTS if event in conditions and event in helm.needs), None)
