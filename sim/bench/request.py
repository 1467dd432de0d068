"""What a benchmark is asked to measure, and what its parts give back."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from companion.core.configuration.vessel_file import VesselFile
from sim.bench.controller.worlds import BenchWorld, paper_world, production_world
from sim.bench.result import BenchRow, Growth, SolverRefused

PROBLEMS = {"production": production_world, "paper": paper_world}
STEP_S = {"production": 0.2, "paper": 0.1}
"""Of one stage."""
Found = Iterator[BenchRow | SolverRefused | Growth]
"""What a part finds, as it finds it."""


@dataclass
class BenchRequest:
    """`solves` recorded states a round, `rounds` rounds, `cadence_solves` at 10 Hz; `progress` gets lines of text."""

    vessel: VesselFile
    vessel_path: Path
    problems: tuple[str, ...] = ("production",)
    solves: int = 200
    rounds: int = 3
    cadence_solves: int = 200
    seed: int = 1
    progress: Callable[[str], None] = lambda _: None
    _worlds: dict[str, BenchWorld] = field(default_factory=dict)

    def world(self, problem: str) -> BenchWorld:
        """A problem with this vessel; built once."""
        if problem not in self._worlds:
            self._worlds[problem] = PROBLEMS[problem](self.vessel)
        return self._worlds[problem]
