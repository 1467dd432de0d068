"""MAVLink FTP over a few files in memory: list, read, write, remove, checksum. What `ftp` refuses, this does.

Payload as in `ftp`. Errors: 1 fail, 6 end of file, 7 unknown command, 10 file not found. One session, number 0, as in
the firmware; a file that is created is emptied first, and a folder is there once a file is in it (source, `GCS_FTP`).
Source of the protocol: https://mavlink.io/en/services/ftp.html
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

_HEADER = struct.Struct("<HBBBBBBI")
_PAYLOAD_BYTES, _DATA_BYTES = 251, 239
_ACK, _NAK = 128, 129
_FAIL, _END, _UNKNOWN, _NOT_FOUND = 1, 6, 7, 10
NONE, TERMINATE, RESET, LIST, OPEN, READ, CREATE, WRITE, REMOVE, MAKE_FOLDER = range(10)
OPEN_TO_WRITE, CHECKSUM, BURST = 11, 14, 15


class _RefusedError(Exception):
    def __init__(self, code: int):
        self.code = code


class FtpFiles:
    """`stored`: contents by absolute path. The folder of scripts exists without a file in it, too."""

    def __init__(self, stored: dict[str, bytes] | None = None):
        self.stored = dict(stored or {})
        self._folders = {"/APM/scripts"}
        self._open: str | None = None

    def answer(self, payload: Sequence[int]) -> bytes:
        """Reply payload (251 bytes) to a request payload."""
        sequence, session, opcode, size, _, _, _, offset = _HEADER.unpack_from(bytes(payload))
        data = bytes(payload)[_HEADER.size : _HEADER.size + size]
        try:
            reply, code = self._do(opcode, offset, data), _ACK
        except _RefusedError as error:
            reply, code = bytes([error.code]), _NAK
        header = _HEADER.pack((sequence + 1) % 65536, session, code, len(reply), opcode, opcode == BURST, 0, offset)
        return (header + reply).ljust(_PAYLOAD_BYTES, b"\0")

    def _do(self, opcode: int, offset: int, data: bytes) -> bytes:
        if opcode in (NONE, TERMINATE, RESET):
            self._open = None if opcode else self._open
            return b""
        if opcode in (READ, BURST):
            return self._read(offset)
        if opcode == WRITE:
            return self._write(offset, data)
        path = "/" + data.partition(b"\0")[0].decode("ascii", "replace").strip("/")
        return self._named(opcode, path, offset)

    def _named(self, opcode: int, path: str, offset: int) -> bytes:
        """What is done to a path."""
        if opcode == LIST:
            return self._list(path, offset)
        if opcode == MAKE_FOLDER:
            self._folders.add(path)
            return b""
        if opcode == CREATE:
            if path.rpartition("/")[0] not in self._there():
                raise _RefusedError(_NOT_FOUND)
            self.stored[path], self._open = b"", path
            return b""
        if opcode not in (OPEN, OPEN_TO_WRITE, REMOVE, CHECKSUM):
            raise _RefusedError(_UNKNOWN)
        if path not in self.stored:
            raise _RefusedError(_NOT_FOUND)
        if opcode == REMOVE:
            del self.stored[path]
            return b""
        if opcode == CHECKSUM:
            return struct.pack("<I", checksum(self.stored[path]))
        self._open = path
        return struct.pack("<I", len(self.stored[path]))

    def _there(self) -> set[str]:
        return self._folders | {path.rpartition("/")[0] for path in self.stored}

    def _list(self, folder: str, offset: int) -> bytes:
        if folder not in self._there():
            raise _RefusedError(_NOT_FOUND)
        names = sorted(path for path in self.stored if path.rpartition("/")[0] == folder)
        lines = [f"F{path.rpartition('/')[2]}\t{len(self.stored[path])}\0".encode() for path in names][offset:]
        if not lines:
            raise _RefusedError(_END)
        listed = b""
        for line in lines:
            if len(listed) + len(line) > _DATA_BYTES:
                break
            listed += line
        return listed

    def _read(self, offset: int) -> bytes:
        if self._open is None:
            raise _RefusedError(_FAIL)
        data = self.stored[self._open][offset : offset + _DATA_BYTES]
        if not data:
            raise _RefusedError(_END)
        return data

    def _write(self, offset: int, data: bytes) -> bytes:
        if self._open is None:
            raise _RefusedError(_FAIL)
        before = self.stored[self._open].ljust(offset, b"\0")
        self.stored[self._open] = before[:offset] + data + before[offset + len(data) :]
        return b""


def checksum(data: bytes) -> int:
    """CRC-32 without inversion before and after, as the protocol wants it."""
    value = 0
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0xEDB88320 if value & 1 else 0)
    return value
