"""The mode table: the mode after every event in every mode.

A row is an event, a column the mode in which it happens, an entry the mode after it: `.` stays, `wanted` is the
requested mode. What the thrusters do follows from the mode alone (`THRUSTERS`), what the operator reads
from the entry (`sentence`). Reference for people: docs/modes.md.

    idle        no mode is requested
    starting    one is: neutral until nothing of `NEEDS` stands against it and the autopilot is ready
    auto        the mission                       hold      station keeping
    excitation  an excitation is flown            paused    ... waits, in neutral, for a healthy estimate
    manual      sticks                            locked    ... in neutral until the sticks have been at rest
    safe        driving was stopped: neutral until the operator requests a mode

Events that last are conditions: `on` when they begin, `OVER[event]` when they end. In a mode, or for a mode that
is asked for, those of its NEEDS count for as long as they last; the others once, as they begin.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, NamedTuple, get_args

import msgspec
from msgspec.structs import replace

from companion.core.messages import Alert, Mode

Wanted = Literal["auto", "hold", "excitation"]
Thrusters = Literal["neutral", "controller", "excitation", "sticks"]
Event = Literal[
    "link_lost", "unfit", "degraded", "fence_breached", "battery_low", "battery_critical", "override_ignored",
    "outputs_cut", "solver_failing", "loop_lag", "link_late", "untrusted", "crippled",
    "link_back", "fit", "healthy", "fence_clear", "battery_ok", "override_obeyed", "outputs_back", "solver_back",
    "loop_ok", "link_prompt", "trusted", "thrusters_fit",
    "rc_takeover", "disarmed", "mode_changed", "outputs_still", "interlock_trip", "sticks_lost",
    "ready", "expired", "finished", "stop", "start", "hold", "excite", "manual",
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
outputs_cut      .        safe     safe     safe     safe       safe       safe     safe     .
solver_failing   .        .        hold     .        .          .          .        .        .
loop_lag         .        .        safe     safe     safe       safe       .        safe     .
link_late        .        .        safe     safe     safe       safe       .        safe     .
untrusted        .        .        safe     safe     safe       safe       .        .        .
crippled         .        .        safe     safe     safe       safe       .        .        .

link_back        .        .        .        .        .          .          .        .        .
fit              .        .        .        .        .          .          .        .        .
healthy          .        .        .        .        .          excitation .        .        .
fence_clear      .        .        .        .        .          .          .        .        .
battery_ok       .        .        .        .        .          .          .        .        .
override_obeyed  .        .        .        .        .          .          .        .        .
outputs_back     .        .        .        .        .          .          .        .        .
solver_back      .        .        .        .        .          .          .        .        .
loop_ok          .        .        .        .        .          .          .        .        .
link_prompt      .        .        .        .        .          .          .        .        .
trusted          .        .        .        .        .          .          .        .        .
thrusters_fit    .        .        .        .        .          .          .        .        .

rc_takeover      .        safe     safe     safe     safe       safe       safe     safe     .
disarmed         .        safe     safe     safe     safe       safe       safe     safe     .
mode_changed     .        .        safe     safe     safe       safe       safe     safe     .
outputs_still    .        safe     safe     safe     safe       safe       safe     safe     .
interlock_trip   .        safe     safe     safe     safe       safe       safe     safe     .
sticks_lost      .        .        .        .        .          .          .        locked   .

ready            .        wanted   .        .        .          .          manual   .        .
expired          .        idle     .        .        .          .          .        .        .
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
    "outputs_cut": "outputs_back",
    "solver_failing": "solver_back",
    "loop_lag": "loop_ok",
    "link_late": "link_prompt",
    "untrusted": "trusted",
    "crippled": "thrusters_fit",
}
"""Condition -> the event of its end. battery_critical has none: battery_low goes on."""


def _events(*events: Event) -> frozenset[Event]:
    return frozenset(events)


_ALL = _events("link_lost", "override_ignored", "outputs_cut", "loop_lag", "link_late")
_KNOWING = _ALL | _events("unfit", "fence_breached", "battery_critical", "untrusted", "crippled")
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
_TAKES_AWAY = _events("rc_takeover", "disarmed", "mode_changed", "outputs_still", "interlock_trip")
"""Somebody, or the autopilot, takes the thrusters away: an order of before counts no more (`ModeState.taken`). A safety
switch that is on as an autopilot boots took nothing away."""
_CALM = _OPERATOR | _events("ready", "finished", *OVER.values())
_ALERTED_AT_REST = _events(
    "fence_breached", "battery_low", "battery_critical", "override_ignored", "outputs_cut", "fence_clear", "battery_ok",
    "outputs_back",
)  # fmt: skip
"""Alerts of these are raised in neutral, too."""
_ALERTED_ELSEWHERE = _events("link_lost", "unfit", "degraded")
"""Links and estimate have alerts of their own, which suffice where the mode stays."""

_HINTS: dict[Event, str] = {
    "fence_breached": "fetch it by hand (manual)",
    "battery_low": "bring the boat home",
    "battery_critical": "bring the boat home, by hand if need be, and change the pack",
    "solver_failing": "the processor is too slow or busy, or the problem has no solution; the log has each reason",
    "loop_lag": "this computer is too busy: end other programs; `aritra log plot` draws the lateness",
    "rc_takeover": "the pilot on the sticks has it",
}


class Taken(NamedTuple):
    """The thrusters were taken away: when [ns], and why."""

    t_ns: int
    why: str


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
    """Text of the alert for one entry. `why`: reason of the event."""
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


class ModeState(msgspec.Struct, frozen=True):
    """The mode. `wanted`: the mode after `starting`; `why`: the last change, or what is waited for, as text;
    `lasting`: conditions that held at the last tick; `taken`: the last time that somebody took the thrusters away.
    """

    mode: Mode = "idle"
    wanted: Wanted = "auto"
    why: str = "waiting for the operator's start"
    lasting: frozenset[Event] = frozenset()
    taken: Taken | None = None

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
    """One event through the table: the state after it, and alerts. `why`: reason of the event."""
    entry = TABLE[helm.mode, event].next
    after: Mode = helm.wanted if entry == "wanted" else entry
    text = sentence(helm.mode, event, after, why)
    wanted = WANTED.get(event, helm.wanted) if after == "starting" else helm.wanted
    helm = replace(helm, taken=Taken(t_ns, why)) if event in _TAKES_AWAY else helm
    alerts: list[Alert] = []
    changed = after != helm.mode
    worth = helm.driving and event not in _ALERTED_ELSEWHERE
    if event not in _CALM and (changed or worth or event in _ALERTED_AT_REST):
        level = "error" if changed and after in ("safe", "hold") else "warning"
        alerts.append(Alert(t_ns=t_ns, level=level, text=text))
    elif event in _ALERTED_AT_REST or (event == "healthy" and changed):
        alerts.append(Alert(t_ns=t_ns, level="info", text=text))
    return replace(helm, mode=after, wanted=wanted, why=text if changed or after == "starting" else helm.why), alerts


def apply_conditions(helm: ModeState, conditions: Mapping[Event, str], t_ns: int) -> tuple[ModeState, list[Alert]]:
    """One tick: conditions that began or ended since the last, and those that the mode does not allow.

    `conditions`: those that hold now, each with its reason.
    """
    alerts: list[Alert] = []
    for event in EVENTS:
        if event not in conditions:
            continue
        counts = event in helm.needs
        begun = event not in helm.lasting and (counts or helm.mode != "starting")
        if begun or counts:
            before = helm.mode
            helm, more = apply_event(helm, event, conditions[event], t_ns)
            alerts += more if begun or helm.mode != before else []
    for event, over in OVER.items():
        if event in helm.lasting and event not in conditions:
            helm, more = apply_event(helm, over, over.replace("_", " "), t_ns)
            alerts += more
    return replace(helm, lasting=frozenset(conditions)), alerts


def waits_for(helm: ModeState, conditions: Mapping[Event, str]) -> str | None:
    """Reason of the first condition that does not allow the requested mode; None: there is none."""
    return next((conditions[event] for event in EVENTS if event in conditions and event in helm.needs), None)
