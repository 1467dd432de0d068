"""Logs of a stepped run, like a boat's: run.mcap as `aritra run` writes it, truth.mcap as `aritra sim` does."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from pathlib import Path

from companion.boat.load_run import RunSetup
from companion.boat.recorder import Recorder
from companion.core.messages import GroundTruth, Message
from companion.logs.metadata import log_metadata

RUN, TRUTH = "run.mcap", "truth.mcap"


class SteppedLogs:
    """Both logs in `folder`, written as the run goes. Raises OSError (FileExistsError: nothing is overwritten)."""

    def __init__(self, folder: Path, setup: RunSetup):
        self._t_ns = 0
        metadata = log_metadata(setup.pilot.vessel.name, setup.files)
        files = {name: text.encode() for name, text in setup.files.items()}
        make = partial(Recorder, metadata=metadata, now_ns=lambda: self._t_ns, wall_offset_ns=0, background=False)
        self._run, self._truth = make(folder / RUN, attachments=files), make(folder / TRUTH)

    def __enter__(self) -> SteppedLogs:
        return self

    def __exit__(self, *_error: object) -> None:
        self._run.close()
        self._truth.close()

    def take(self, messages: Iterable[Message], t_ns: int) -> None:
        """Record them as of `t_ns`, and put them on the disk."""
        self._t_ns = t_ns
        for message in messages:
            (self._truth if isinstance(message, GroundTruth) else self._run).record(message)
        self._run.sync()
        self._truth.sync()
