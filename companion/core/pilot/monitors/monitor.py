"""What every monitor is: a frozen state, the messages it hears, and what it reports of them and at each tick.

To add one: a subclass of `Monitor` in a file of this folder, and a row in `table`. Its state is kept in
`PilotState.monitors` by the state's type. A condition of its own is also a row of the mode table (`modes`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Generic, TypeVar

from companion.core.messages import Alert, Message, StateEstimate
from companion.core.pilot.modes import Event

State = TypeVar("State")


@dataclass(frozen=True)
class TickView:
    """What monitors may look at in a control tick at `t_ns` [ns].

    `lateness_ns`: of the tick; `plan_ns`: instant of the request that the latest usable plan answers;
    `autopilot_alive`: whether heartbeats come.
    """

    t_ns: int
    lateness_ns: int
    estimate: StateEstimate
    plan_ns: int
    autopilot_alive: bool


@dataclass(frozen=True)
class MonitorReport:
    """Events of the mode table, each with its reason, and alerts. At a tick the events are the conditions that hold.

    `withhold`: the message must not reach the estimator; only of a monitor that `screens`.
    """

    events: Mapping[Event, str] = field(default_factory=dict)
    alerts: tuple[Alert, ...] = ()
    withhold: bool = False


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
