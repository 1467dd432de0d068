"""Shared by the commands that turn logs into results: inputs, refusals, progress, versions, arguments."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from companion.cli.options.files import text_of
from companion.cli.options.outputs import new_in_folder
from companion.cli.options.parser import BAD_INPUT
from companion.core.configuration.site_file import Site, load_site
from companion.core.configuration.vessel_file import VesselFile
from companion.core.model.actuators.propulsion import only_fixed
from companion.core.model.load_vessel import load_vessel
from companion.logs.log_file import LogError
from companion.logs.metadata import log_metadata

LIBRARIES = ("numpy", "scipy", "casadi", "filterpy", "polars", "statsmodels")


REFUSED = (LogError, ValueError, OSError)
"""Exceptions of bad input: ConfigError, RunError, JobError and StructuredFitError are ValueErrors."""


@dataclass(frozen=True)
class Opened:
    """The vessel file as text and as it loads, and the site if one was named."""

    vessel_text: str
    vessel: VesselFile
    site: Site | None


def opened(args: argparse.Namespace, logs: Sequence[Path], outputs: Sequence[str]) -> Opened:
    """`--vessel` and `--site`, checked: logs, and that `--out` has none of `outputs`. Raises ConfigError."""
    text = text_of(args.vessel)
    vessel = load_vessel(text, name=str(args.vessel))
    only_fixed(vessel, str(args.vessel), "identification and diagnosis")
    site = load_site(text_of(args.site), name=str(args.site)) if args.site else None
    for path in logs:
        path.stat()
    new_in_folder(args.out, outputs)
    return Opened(text, vessel, site)


def refuse(command: str, why: str | Exception) -> int:
    """Print on stderr what is wrong with the input; the exit code."""
    if isinstance(why, OSError) and why.filename:
        why = f"{why.filename}: {why.strerror}"
    print(f"aritra {command}: {why}", file=sys.stderr)
    return BAD_INPUT


def one_thread() -> AbstractContextManager[object]:
    """Linear algebra on one thread: the matrices are small, and threads that wait for each other cost more."""
    from threadpoolctl import threadpool_limits

    return threadpool_limits(limits=1)


def progress_of(console: Console) -> Progress:
    """Progress bars with elapsed time and current item."""
    columns = (
        TextColumn("{task.description:17}"),
        BarColumn(24),
        TimeElapsedColumn(),
        TextColumn("{task.fields[what]}"),
    )
    return Progress(*columns, console=console)


def bars(progress: Progress, steps: Sequence[str]) -> Callable[[str, str, float], None]:
    """A bar for each step, with its current item."""
    tasks = {step: progress.add_task(step, total=1.0, start=False, what="") for step in steps}

    def say(step: str, text: str, share: float) -> None:
        task = tasks[step]
        progress.start_task(task)
        progress.update(task, completed=share, what=text)

    return say


def versions() -> dict[str, str]:
    """Versions of this program, its source, the machine, and the libraries that results depend on."""
    about = log_metadata("", {})
    ours = {"aritra": about["version"]} | {k: about[k] for k in ("git_revision", "python", "machine")}
    return ours | {name: version(name) for name in LIBRARIES}


def now_utc() -> str:
    """Current time, UTC, ISO 8601."""
    return datetime.now(UTC).isoformat(timespec="seconds")
