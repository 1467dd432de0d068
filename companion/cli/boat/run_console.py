"""What a run shows itself on: the teleop table, in place of lines of progress."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from companion.boat.app import App
from companion.boat.clock import Clock
from companion.boat.load_run import RunSetup
from companion.core.messages import Alert, Message


class RunConsole(Protocol):
    """User interface of a run: gets every message and may command the App. `run` ends with the run."""

    def begins(self, log: Path) -> None:
        """The run begins, and is recorded in `log`."""
        ...

    def see(self, message: Message) -> None:
        """Note one message."""
        ...

    def ends(self) -> None:
        """The run ends now: what follows is neutral and a disarm."""
        ...

    def close(self) -> None:
        """The run is over."""
        ...

    async def run(
        self, app: App, setup: RunSetup, clock: Clock, tell: Callable[[Alert], None], end: Callable[[], None]
    ) -> None:
        """Work until cancelled; `tell` logs and shows an alert, `end` ends the run."""
        ...
