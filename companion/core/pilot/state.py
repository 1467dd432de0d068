"""What a run is configured with, and what the boat remembers between steps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar

import msgspec
from msgspec.structs import replace

from companion.core.configuration.run_file import BatteryLimits, Control
from companion.core.configuration.site_file import Site
from companion.core.configuration.vessel_file import VesselFile
from companion.core.control.nmpc import NmpcSettings
from companion.core.estimation.estimator import EstimatorState
from companion.core.excitation.file import Excitation
from companion.core.excitation.flight import BEGINNING, Flight, FlightState
from companion.core.excitation.pen import Pen
from companion.core.geometry.fence import Fence
from companion.core.guidance import guidance
from companion.core.guidance.guidance import GuidanceSettings, GuidanceState
from companion.core.guidance.missions.mission import Mission
from companion.core.messages import Message, Mode, PlanResult, StateEstimate
from companion.core.pilot import modes
from companion.core.pilot.modes import ModeState
from companion.core.pilot.plan_check import NO_PROPOSALS, Proposals

Outputs = list[Message]
"""Messages to be sent, shown or logged, in this order."""
Own = TypeVar("Own")


@dataclass(frozen=True)
class PilotSettings:
    """Everything that a run is configured with."""

    vessel: VesselFile
    site: Site
    mission: Mission
    control: Control = field(default_factory=Control)
    guidance: GuidanceSettings = field(default_factory=GuidanceSettings)
    nmpc: NmpcSettings = field(default_factory=NmpcSettings)
    excitation: Excitation | None = None
    """Flown on the operator's `excite`."""
    battery: BatteryLimits = field(default_factory=BatteryLimits)
    system_id: int = 1
    """Ours on the MAVLink wire: alerts name it."""

    @property
    def fence(self) -> Fence:
        """The site's fence and the mission's."""
        others = self.pen.others
        return Fence((self.site.fence, *others.within), others.without)

    @property
    def pen(self) -> Pen:
        """The same for an excitation."""
        within = tuple(f.polygon for f in self.mission.fences if f.inclusion)
        return Pen(self.site, Fence(within, tuple(f.polygon for f in self.mission.fences if not f.inclusion)))

    def flight(self, name: str = "") -> Flight | None:
        """The excitation, if there is one, for this boat and water. `name`: of its file. Raises ConfigError."""
        if self.excitation is None:
            return None
        name, others, period_s = name or self.excitation.name, self.pen.others, self.control.period_s
        return Flight(self.excitation, self.vessel, self.site, name=name, others=others, period_s=period_s)


class PilotState(msgspec.Struct, frozen=True):
    """Everything the boat remembers between steps."""

    estimator: EstimatorState
    monitors: Mapping[type, Any]
    """State of each monitor, by its type: see `monitor` and `with_monitors`."""
    f_command_n: tuple[float, ...]
    lease_end_ns: int | None = None
    """Until when `f_command_n` was leased; None: there was no lease."""
    helm: ModeState = modes.AT_REST
    ordered_ns: int | None = None
    """Instant [ns] of the operator's latest order to drive; None: there was none."""
    guidance: GuidanceState = guidance.IDLE
    flight: FlightState = BEGINNING
    passed: tuple[guidance.Passage, ...] = ()
    mission: Mission | None = None
    """One loaded under way (NewMission), instead of the configured one."""
    open_tick: int | None = None
    asked: tuple[tuple[int, int], ...] = ()
    """Tick and instant [ns] of the latest SolveRequests."""
    estimate: StateEstimate | None = None
    row: tuple[float, ...] | None = None
    plan: PlanResult | None = None
    plan_ns: int = 0
    proposals: Proposals = NO_PROPOSALS
    model_nu: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """u, v, r that the commanded thrust makes of the model alone."""
    last_status: tuple[Mode, int | None] = ("idle", None)
    """Mode and instant [ns] of the latest ModeStatus."""

    def monitor(self, kind: type[Own]) -> Own:
        """State of one monitor, for instance `monitor(BatteryState).voltage_v`."""
        return self.monitors[kind]

    def with_monitors(self, *states: object) -> PilotState:
        """With these states of monitors instead of those of the same types."""
        return replace(self, monitors={**self.monitors, **{type(state): state for state in states}})
