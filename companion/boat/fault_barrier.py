"""A fault of one task or callback ends the run, but not before the others have had time to send neutral."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from typing import Any


class FaultBarrier:
    """Catches what tasks and callbacks raise. `failure`: the first fault; `on_fault` is called at every one."""

    def __init__(self, on_fault: Callable[[], None]) -> None:
        self.failure: Exception | None = None
        self._on_fault = on_fault

    async def task(self, work: Coroutine[Any, Any, None]) -> None:
        """Await one task; a fault in it leaves the others running."""
        try:
            await work
        except Exception as error:
            self._fail(error)

    def call(self, function: Callable[..., None], *args: Any) -> None:
        """Call it, unless something has failed already."""
        if self.failure:
            return
        try:
            function(*args)
        except Exception as error:
            self._fail(error)

    def _fail(self, error: Exception) -> None:
        self.failure = self.failure or error
        self._on_fault()
