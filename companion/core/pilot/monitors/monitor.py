"""What every monitor is: a frozen state, the messages it hears, and what it reports of them and at each tick.

To add one: a subclass of `Monitor` in a file of this folder, and a row in `table`. Its state is kept in
`PilotState.monitors` by the state's type. A condition of its own is also a row of the mode table (`modes`).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

import msgspec

from companion.core.estimation.filter_state import FilterState
from companion.core.messages import Alert, Message, StateEstimate
from companion.core.pilot.modes import Event

State = TypeVar("State")


class LegAhead(NamedTuple):
    """What a mission's boat drives: `waypoint` ahead, from 1; `along_m` the course; `ahead_m`: distance to it."""

    waypoint: int
    along_m: float
    ahead_m: float


class TickView(msgspec.Struct, frozen=True):
    """What monitors may look at in a control tick at `t_ns` [ns].

    `lateness_ns`: of the tick; `plan_ns`: instant of the request that the latest usable plan answers;
    `autopilot_alive`: whether heartbeats come; `belief`: the filter at `t_ns`, None before it runs; `model_nu`: u, v,
    r of the model alone (`pilot.trust.model_motion`); `period_s`: of the ticks; `driving`: whether the thrusters may
    turn; `learning`: in an excitation, which is flown because the model is not known; `suspect`: sensors contradict
    each other, perhaps; `thrusters_suspected`: which, in words, do not obey, perhaps; `thrusters_changed`: one has just
    been found that does not obey, and what was reckoned without knowing is wrong; `leg`: None between missions.
    """

    t_ns: int
    lateness_ns: int
    estimate: StateEstimate
    plan_ns: int
    autopilot_alive: bool
    belief: FilterState | None = None
    model_nu: tuple[float, float, float] = (0.0, 0.0, 0.0)
    period_s: float = 0.1
    driving: bool = False
    learning: bool = False
    suspect: bool = False
    thrusters_suspected: str = ""
    thrusters_changed: bool = False
    leg: LegAhead | None = None


class MonitorReport(msgspec.Struct, frozen=True):
    """Events of the mode table, each with its reason, and alerts. At a tick the events are the conditions that hold.

    Only of a monitor that `screens`: `withhold`, the message must not reach the estimator; `instead`, what reaches it
    in its place.
    """

    events: Mapping[Event, str] = msgspec.field(default_factory=dict)
    alerts: tuple[Alert, ...] = ()
    withhold: bool = False
    instead: Message | None = None


NOTHING = MonitorReport()


class Monitor(Generic[State]):
    """Watches one thing. Its methods are pure: (state, input) -> (state, report).

    `hears`: types of messages given to `on_message`; `screens`: it hears them before the estimator does;
    `initial`: state at switch-on.
    """

    hears: ClassVar[tuple[type[Message], ...]] = ()
    screens: ClassVar[bool] = False
    initial: State

    def on_message(self, state: State, message: Any, t_ns: int) -> tuple[State, MonitorReport]:
        """One message that it hears, taken at `t_ns` [ns]."""
        return state, NOTHING

    def on_tick(self, state: State, view: TickView) -> tuple[State, MonitorReport]:
        """One control tick."""
        return state, NOTHING
