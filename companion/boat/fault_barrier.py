"""A fault of one task or callback ends the run, but not before the others have had time to send neutral.

A fault is whatever is raised: also what is no Exception (SystemExit, KeyboardInterrupt), and a CancelledError that
nobody asked for. Only a task that is told to end may end.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Sequence
from typing import Any, Protocol

from companion.core.messages import Message


class Feeding(Protocol):
    """The side of a codec that a link uses; see `drivers.link.Codec`."""

    @property
    def understood(self) -> int:
        """Sound frames or lines so far."""
        ...

    def feed(self, data: bytes, t_ns: int) -> Sequence[Message]:
        """Bytes in, messages out."""
        ...


class FaultBarrier:
    """Catches what tasks and callbacks raise. `failure`: the first fault; `on_fault` is called at every one.

    `over`: the boat has been let go of, and nothing needs to be kept any more.
    """

    def __init__(self, on_fault: Callable[[], None]) -> None:
        self.failure: BaseException | None = None
        self.over = False
        self._on_fault = on_fault

    async def task(self, work: Coroutine[Any, Any, None]) -> None:
        """Await one task; a fault in it leaves the others running."""
        try:
            await work
        except GeneratorExit:
            raise
        except BaseException as error:
            task = asyncio.current_task()
            if isinstance(error, asyncio.CancelledError) and task is not None and task.cancelling():
                raise
            self._fail(error)

    async def keep(self, make: Callable[[], Coroutine[Any, Any, None]], pause: Callable[[], Coroutine]) -> None:
        """Await a task until it is cancelled after all is `over`: anew after a fault and a pause, or a cancellation
        that comes before (a loop that breaks cancels all its tasks), for neutral goes out by it.
        """
        while True:
            try:
                await self.task(make())
                await pause()
            except asyncio.CancelledError:
                if self.over:
                    raise

    def call(self, function: Callable[..., None], *args: Any) -> None:
        """Call it, unless something has failed already."""
        if self.failure is None:
            try:
                function(*args)
            except BaseException as error:
                self._fail(error)

    def attempt(self, function: Callable[..., object], *args: Any) -> None:
        """Call it whatever has failed; its own fault is kept, and goes no further."""
        try:
            function(*args)
        except BaseException as error:
            self._keep(error)

    def end(self) -> None:
        """Raise the failure, if there is one; as RuntimeError what would not count as one, such as SystemExit(0)."""
        if isinstance(self.failure, Exception):
            raise self.failure
        if self.failure is not None:
            raise RuntimeError(f"something in the run raised {self.failure!r}") from self.failure

    def _fail(self, error: BaseException) -> None:
        self._keep(error)
        self._on_fault()

    def _keep(self, error: BaseException) -> None:
        self.failure = error if self.failure is None else self.failure


class GuardedCodec:
    """A codec behind the barrier: a fault in it leaves the link open, so that neutral still goes out by it."""

    def __init__(self, codec: Feeding, faults: FaultBarrier) -> None:
        self._codec, self._faults = codec, faults

    @property
    def understood(self) -> int:
        """Sound frames or lines so far."""
        return self._codec.understood

    def feed(self, data: bytes, t_ns: int) -> Sequence[Message]:
        """Messages of the codec; none once something has failed."""
        messages: list[Message] = []
        self._faults.call(lambda: messages.extend(self._codec.feed(data, t_ns)))
        return messages
