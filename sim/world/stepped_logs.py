"""Logs of a stepped run, like a boat's: run.mcap as `aritra run` writes it, truth.mcap as `aritra sim` does.

Their wall clock goes as fast as the stepped clock, from the instant that it is given to begin with.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

from companion.boat.load_run import RunSetup
from companion.boat.recorder import Recorder
from companion.core.messages import GroundTruth, Message
from companion.logs.metadata import log_metadata

RUN, TRUTH = "run.mcap", "truth.mcap"


class SteppedLogs:
    """Both logs in `folder`, written as the run goes. `begin_unix_ns`: Unix time [ns] at which simulated time is 0.

    Raises OSError (FileExistsError: nothing is overwritten).
    """

    def __init__(self, folder: Path, setup: RunSetup, begin_unix_ns: int):
        self._t_ns = 0
        metadata = log_metadata(setup.pilot.vessel.name, setup.files)
        files = {name: text.encode() for name, text in setup.files.items()}
        make = partial(
            Recorder, metadata=metadata, now_ns=lambda: self._t_ns, wall_offset_ns=begin_unix_ns, background=False
        )
        self._run, self._truth = make(folder / RUN, attachments=files), make(folder / TRUTH)

    def __enter__(self) -> SteppedLogs:
        return self

    def __exit__(self, *_error: object) -> None:
        self._run.close()
        self._truth.close()

    def record(self, message: Message, t_ns: int) -> None:
        """Record one message as of `t_ns` in simulated time [ns]."""
        self._t_ns = t_ns
        (self._truth if isinstance(message, GroundTruth) else self._run).record(message)

    def sync(self) -> None:
        """Put on the disk what was recorded."""
        self._run.sync()
        self._truth.sync()
