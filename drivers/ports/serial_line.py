"""Serial device through pyserial: raw 8N1, exclusive, never blocking the event loop.

Opening, and closing a dead USB device, can take seconds inside the kernel; both run in a thread. An
unplugged device reads as end of file, EIO or ENODEV: all of them end the stream.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import termios
from typing import cast

import serial

from drivers.ports.descriptor import READ_BYTES, DescriptorPort, Handle

SEND_LIMIT_BYTES = 4096
"""Assumed: 0.36 s at 115200 baud 8N1, so that a queued command is never older than that."""

HINTS = {
    errno.EACCES: " (is the user in group dialout?)",
    errno.EAGAIN: " (another program holds this device)",
    errno.EBUSY: " (another program holds this device)",
}


class SerialPort(DescriptorPort):
    """`serial:/dev/ttyACM0:115200`. `baud`: bit/s; ignored by USB CDC devices and ptys."""

    def __init__(self, path: str, baud: int, *, send_limit_bytes: int = SEND_LIMIT_BYTES) -> None:
        super().__init__(f"serial:{path}:{baud}", send_limit_bytes)
        self.path = path
        self.baud = baud

    async def open(self) -> None:
        """Open the device exclusively. Raises OSError with the reason and, where there is one, a hint."""
        self._require_closed()
        opening = asyncio.get_running_loop().run_in_executor(None, self._open_device)
        try:
            device = await asyncio.shield(opening)
        except asyncio.CancelledError:
            opening.add_done_callback(_close_unused)
            raise
        self._begin()
        self._adopt(device)

    def _open_device(self) -> serial.Serial:
        """VMIN = 1 (inter_byte_timeout = 0), so that an empty read is EAGAIN and only a hang-up is b""."""
        try:
            return serial.Serial(self.path, self.baud, exclusive=True, timeout=0, write_timeout=0, inter_byte_timeout=0)
        except OSError as error:
            code = error.errno
            reason = os.strerror(code) + HINTS.get(code, "") if code else str(error)
            raise OSError(code or errno.EIO, reason) from error
        except (ValueError, termios.error) as error:
            raise OSError(errno.EINVAL, f"{error}") from error

    def _read(self) -> bytes | None:
        return os.read(self._fileno(), READ_BYTES)

    def _write(self, data: memoryview) -> int:
        return os.write(self._fileno(), data)

    async def _release(self, handle: Handle) -> None:
        closing = asyncio.get_running_loop().run_in_executor(None, _close_device, cast("serial.Serial", handle))
        await asyncio.shield(closing)


def _close_device(device: serial.Serial) -> None:
    """Throw away unsent output first: the kernel would wait for it, up to 30 s on a stuck device."""
    with contextlib.suppress(OSError, termios.error):
        device.reset_output_buffer()
    device.close()


def _close_unused(opening: asyncio.Future[serial.Serial]) -> None:
    if not opening.cancelled() and opening.exception() is None:
        _close_device(opening.result())
