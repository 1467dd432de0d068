"""What serial, UDP and TCP share: a non-blocking descriptor, watched by the event loop.

`receive` waits until the descriptor is readable and then reads once; between calls the bytes stay in the
kernel, so nothing is lost when a receiver is cancelled, and a slow receiver costs no memory here. `send`
writes at once what the kernel takes and leaves the rest to `add_writer`.
"""

from __future__ import annotations

import asyncio
import errno
from typing import Protocol

from drivers.ports.port import PortCounters, SendBuffer

READ_BYTES = 65536


class Handle(Protocol):
    """A socket, a serial device or a raw file."""

    def fileno(self) -> int:
        """The descriptor."""
        ...

    def close(self) -> None:
        """Release it."""
        ...


class DescriptorPort:
    """Base of the ports that own a descriptor. Subclasses open it and say how to read and write.

    `send_limit_bytes` bounds what waits to be sent. One receiver at a time.
    """

    def __init__(self, name: str, send_limit_bytes: int) -> None:
        self.name = name
        self.counters = PortCounters()
        self._outbox = SendBuffer(send_limit_bytes)
        self._handle: Handle | None = None
        self._is_open = False
        self._ended = False
        self._waiter: asyncio.Future[None] | None = None
        self._watching_fd = -1
        self._writing_fd = -1

    # --- for subclasses ------------------------------------------------------------------------------

    def _read(self) -> bytes | None:
        """Read once. b"": the other end is gone; None: nothing for us. OSError means gone, too."""
        raise NotImplementedError

    def _write(self, data: memoryview) -> int:
        """Write what fits now; returns the number of bytes, 0 to discard them all.

        BlockingIOError means later, any other OSError that the other end is gone.
        """
        raise NotImplementedError

    async def _release(self, handle: Handle) -> None:
        """Close the handle, which the event loop no longer watches."""
        handle.close()

    def _begin(self) -> None:
        """The port counts as open from now on, with or without a peer."""
        self._is_open, self._ended = True, False

    def _adopt(self, handle: Handle) -> None:
        """Use this handle from now on."""
        self._handle = handle
        self._wake()

    def _fileno(self) -> int:
        """Descriptor, or -1 without one."""
        return self._handle.fileno() if self._handle is not None else -1

    def _require_closed(self) -> None:
        if self._is_open:
            raise OSError(errno.EISCONN, "already open")

    # --- Port ----------------------------------------------------------------------------------------

    async def receive(self) -> bytes:
        """Next bytes as they come; b"" once the other end is gone or the port is closed."""
        while self._is_open and not self._ended:
            await self._readable()
            if self._fileno() < 0:
                continue
            try:
                data = self._read()
            except (BlockingIOError, InterruptedError):
                continue
            except OSError:
                data = b""
            if data is None:
                continue
            if data == b"":
                self._ended = True
            self.counters.received_bytes += len(data)
            return data
        return b""

    def send(self, data: bytes) -> None:
        """Queue bytes without blocking. Raises OSError where the port is not open."""
        if not self._is_open or self._ended:
            raise OSError(errno.ENOTCONN, f"{self.name} is not open")
        if self._handle is None:
            self.counters.dropped_bytes += len(data)
            return
        self._queue(data)
        if self._writing_fd < 0:
            self._flush()
        if self._ended:
            raise OSError(errno.EPIPE, f"the other end of {self.name} is gone")

    async def close(self) -> None:
        """Release the descriptor; what was not sent yet is dropped. May be called twice."""
        self._is_open = False
        handle = self._handle
        self._unwatch_write()
        self._wake()
        self._handle = None
        self.counters.dropped_bytes += self._outbox.clear()
        if handle is not None:
            await self._release(handle)

    # --- inside --------------------------------------------------------------------------------------

    def _queue(self, data: bytes) -> None:
        self.counters.dropped_bytes += self._outbox.push(data)

    async def _readable(self) -> None:
        """Wait until there is something to read, a peer was adopted, or the port was closed."""
        if self._waiter is not None:
            raise RuntimeError(f"{self.name}: only one receiver at a time")
        loop = asyncio.get_running_loop()
        waiter = self._waiter = loop.create_future()
        fd = self._fileno()
        if fd >= 0:
            loop.add_reader(fd, self._wake)
            self._watching_fd = fd
        try:
            await waiter
        finally:
            if self._waiter is waiter:
                self._wake()

    def _wake(self) -> None:
        """Stop watching for input and let the receiver look."""
        if self._watching_fd >= 0:
            asyncio.get_running_loop().remove_reader(self._watching_fd)
            self._watching_fd = -1
        waiter, self._waiter = self._waiter, None
        if waiter is not None and not waiter.done():
            waiter.set_result(None)

    def _flush(self) -> None:
        """Write until the kernel takes no more; then continue when it does."""
        try:
            while self._outbox:
                head = self._outbox.head()
                count = self._write(head)
                self._outbox.consume(count or len(head))
                self.counters.sent_bytes += count
                self.counters.dropped_bytes += 0 if count else len(head)
        except (BlockingIOError, InterruptedError):
            if self._writing_fd < 0:
                self._writing_fd = self._fileno()
                asyncio.get_running_loop().add_writer(self._writing_fd, self._flush)
            return
        except OSError:
            self._ended = True
            self.counters.dropped_bytes += self._outbox.clear()
            self._wake()
        self._unwatch_write()

    def _unwatch_write(self) -> None:
        if self._writing_fd >= 0:
            asyncio.get_running_loop().remove_writer(self._writing_fd)
            self._writing_fd = -1
