"""What commands that turn logs into results share: folder, progress, versions, arguments."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from companion.core.config import ConfigError
from companion.log_metadata import log_metadata

LIBRARIES = ("numpy", "scipy", "casadi", "filterpy", "polars", "statsmodels")


def text_of(path: Path) -> str:
    """Of a UTF-8 file; ConfigError where it is none."""
    try:
        return path.read_text()
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: is not UTF-8 text") from None


def free_folder(out: Path, names: Sequence[str]) -> None:
    """Make the folder; ConfigError where it holds results already: they are never overwritten."""
    taken = [name for name in names if (out / name).exists()]
    if taken:
        raise ConfigError(f"{out}: holds {', '.join(taken)} already; choose another folder, or move them away")
    out.mkdir(parents=True, exist_ok=True)


def progress_of(console: Console) -> Progress:
    """Bars with time and what each is at."""
    columns = (
        TextColumn("{task.description:17}"),
        BarColumn(24),
        TimeElapsedColumn(),
        TextColumn("{task.fields[what]}"),
    )
    return Progress(*columns, console=console)


def bars(progress: Progress, steps: Sequence[str]) -> Callable[[str, str, float], None]:
    """A bar for each step; what it is at stands beside it."""
    tasks = {step: progress.add_task(step, total=1.0, start=False, what="") for step in steps}

    def say(step: str, text: str, share: float) -> None:
        task = tasks[step]
        progress.start_task(task)
        progress.update(task, completed=share, what=text)

    return say


def versions() -> dict[str, str]:
    """Of this program, its source, the machine, and the libraries that figures depend on."""
    about = log_metadata("", {})
    ours = {"aritra": about["version"]} | {k: about[k] for k in ("git_revision", "python", "machine")}
    return ours | {name: version(name) for name in LIBRARIES}


def now_utc() -> str:
    """ISO 8601."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def seconds(text: str) -> float:
    """An argument of the command line."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < 1e6:
        raise argparse.ArgumentTypeError(f"{text!r}: expected seconds, more than 0")
    return value
