"""A campaign from its cases to its files: what is done is left out, what comes is kept at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from sim.campaign.cases import Case
from sim.campaign.inputs import Inputs
from sim.campaign.journal import Journal
from sim.campaign.report import summary
from sim.campaign.runners.job import CaseOutcome, Runner
from sim.campaign.tables import REPORT, outputs
from sim.whole_file import write_whole


def to_do(cases: Sequence[Case], journal: Journal, retry: bool) -> list[Case]:
    """Cases that have not been run, by seed, so that what is there early is spread; `retry`: and those that failed."""
    left = [c for c in cases if c.id not in journal.outcomes or (retry and journal.outcomes[c.id].error)]
    return sorted(left, key=lambda case: (case.seed, case.id))


def run(
    inputs: Inputs, cases: Sequence[Case], journal: Journal, runner: Runner, say: Callable[[CaseOutcome], None]
) -> None:
    """Run `cases`; each outcome goes to the journal, then to `say`. Raises RunnerLost, ConfigError (other program)."""
    for outcome in runner([inputs.work(case) for case in cases]):
        journal.add(outcome)
        say(outcome)


def write(
    folder: Path, inputs: Inputs, cases: Sequence[Case], journal: Journal, program: dict[str, str]
) -> dict[str, bytes]:
    """Tables and failures, then the report of what is there; each replaces the one before whole. Their bytes by name.

    The report comes last: what goes wrong in a picture costs no table.
    """
    files = outputs(cases, journal.outcomes)
    for name, data in files.items():
        write_whole(folder / name, data)
    files[REPORT] = summary(inputs, cases, journal.outcomes, program).encode()
    write_whole(folder / REPORT, files[REPORT])
    return files
