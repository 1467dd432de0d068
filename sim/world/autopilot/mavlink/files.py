"""MAVLink FTP over a few files in memory, as the firmware serves it (source: `GCS_FTP`).

One file is open at a time. A request in another session is refused until the open file has been idle for 3 s. A path
must be as long as the request says; where it is counted with its NUL, 4.6 refuses it and 4.7 does not
(`counts_nul`). A burst ends with a refusal, "end of file". Requests that were answered are answered again.

Payload: sequence u16, session u8, opcode u8, size u8, requested opcode u8, burst complete u8, padding u8, offset u32,
data. Source of the protocol: https://mavlink.io/en/services/ftp.html
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence

_HEADER = struct.Struct("<HBBBBBBI")
_PAYLOAD_BYTES, DATA_BYTES = 251, 239
_ACK, _NAK = 128, 129
_FAIL, _SIZE, _SESSION, _END, _EXISTS, _NOT_FOUND = 1, 3, 4, 6, 8, 10
NONE, TERMINATE, RESET, LIST, OPEN, READ, CREATE, WRITE, REMOVE, MAKE_FOLDER = range(10)
REMOVE_FOLDER, OPEN_TO_WRITE, TRUNCATE, RENAME, CHECKSUM, BURST = range(10, 16)
OPCODE_AT = 3
"""Where the opcode is in a payload."""
_IDLE_NS = 3_000_000_000

Pieces = list[tuple[int, bytes]]
"""Offset and data of each answer."""


class _RefusedError(Exception):
    def __init__(self, code: int, after: Pieces = ()):  # type: ignore[assignment]
        self.code, self.after = code, list(after)


class FtpFiles:
    """`stored`: contents by absolute path; `virtual(path)`: a file that is made when it is opened, None: no such."""

    def __init__(
        self,
        stored: dict[str, bytes] | None = None,
        counts_nul: bool = True,
        virtual: Callable[[str], bytes | None] = lambda path: None,
    ):
        self.stored = dict(stored or {})
        self._counts_nul, self._virtual = counts_nul, virtual
        self._folders = {"", "/APM", "/APM/scripts"}
        self._reading: bytes | None = None
        self._writing: str | None = None
        self._session: int | None = None
        self._used_ns = 0
        self._answered: tuple[int, int, list[bytes]] | None = None

    def answers(self, payload: Sequence[int], t_ns: int) -> list[bytes]:
        """Reply payloads (251 bytes each) to a request payload at t."""
        sequence, session, opcode, size, _, _, _, offset = _HEADER.unpack_from(bytes(payload))
        if self._answered is not None and self._answered[:2] == (sequence, session):
            return self._answered[2]
        if opcode in (_ACK, _NAK):
            return []
        data = bytes(payload)[_HEADER.size :]
        pieces, code = [], None
        try:
            if size > DATA_BYTES:
                raise _RefusedError(_SIZE)
            pieces = self._do(opcode, session, offset, size, data, t_ns)
        except _RefusedError as error:
            pieces, code = error.after, error.code
        replies = [(_ACK, at, piece) for at, piece in pieces]
        if code is not None:
            end = pieces[-1][0] + len(pieces[-1][1]) if pieces else (offset if opcode == LIST else 0)
            replies.append((_NAK, end, bytes([code])))
        self._used_ns = t_ns
        packed = []
        for k, (kind, at, piece) in enumerate(replies):
            last = opcode == BURST and self._counts_nul and kind == _ACK and len(piece) < size
            head = _HEADER.pack((sequence + 1 + k) % 65536, session, kind, len(piece), opcode, last, 0, at)
            packed.append((head + piece).ljust(_PAYLOAD_BYTES, b"\0"))
        self._answered = sequence, session, packed[-1:]
        return packed

    def _do(self, opcode: int, session: int, offset: int, size: int, data: bytes, t_ns: int) -> Pieces:
        is_open = self._reading is not None or self._writing is not None
        if session != self._session and opcode in (TERMINATE, RESET):
            return [(0, b"")]
        if is_open and session != self._session:
            if t_ns - self._used_ns < _IDLE_NS:
                raise _RefusedError(_SESSION)
            self._close()
            is_open = False
        if opcode in (NONE, TERMINATE, RESET):
            if opcode != NONE:
                self._close()
            return [(0, b"")]
        if opcode in (READ, BURST):
            return self._read(opcode, offset, size or DATA_BYTES)
        if opcode == WRITE:
            return self._write(offset, data[:size])
        if opcode in (OPEN, CREATE, OPEN_TO_WRITE):
            if is_open:
                raise _RefusedError(_FAIL)
            return self._opened(opcode, session, self._path(size, data))
        return self._named(opcode, size, data, offset)

    def _path(self, size: int, data: bytes) -> str:
        """The path of a request."""
        name = data.partition(b"\0")[0]
        counted = self._counts_nul and size - len(name) == 1 and data[-1] == 0
        if size == 0 or not (len(name) == size or counted):
            raise _RefusedError(_SIZE)
        return _absolute(name)

    def _opened(self, opcode: int, session: int, path: str) -> Pieces:
        virtual = self._virtual(path) if opcode == OPEN else None
        if opcode == CREATE:
            if path.rpartition("/")[0] not in self._folders:
                raise _RefusedError(_NOT_FOUND)
            self.stored[path] = b""
        elif virtual is None and path not in self.stored:
            raise _RefusedError(_NOT_FOUND)
        self._session = session
        if opcode != OPEN:
            self._writing = path
            return [(0, b"")]
        self._reading = self.stored[path] if virtual is None else virtual
        return [(0, struct.pack("<I", len(self._reading)))]

    def _named(self, opcode: int, size: int, data: bytes, offset: int) -> Pieces:
        """What is done to a path without opening it."""
        if opcode == RENAME:
            return self._rename(size, data)
        if opcode not in (LIST, MAKE_FOLDER, REMOVE, REMOVE_FOLDER, CHECKSUM):
            raise _RefusedError(_FAIL)
        path = self._path(size, data)
        if opcode == LIST:
            return self._list(path, offset)
        if opcode == MAKE_FOLDER:
            if path in self._folders:
                raise _RefusedError(_EXISTS)
            self._folders.add(path)
        elif opcode == CHECKSUM and path in self.stored:
            return [(0, struct.pack("<I", checksum(self.stored[path])))]
        elif opcode in (REMOVE, REMOVE_FOLDER) and path in self._folders:
            self._folders.remove(path)
        elif opcode in (REMOVE, REMOVE_FOLDER) and path in self.stored:
            del self.stored[path]
        else:
            raise _RefusedError(_NOT_FOUND)
        return [(0, b"")]

    def _rename(self, size: int, data: bytes) -> Pieces:
        before, _, rest = data.partition(b"\0")
        after = rest.partition(b"\0")[0]
        counted = self._counts_nul and size - len(before) - len(after) == 2
        if size == 0 or not (len(before) + len(after) + 1 == size or counted):
            raise _RefusedError(_SIZE)
        if _absolute(before) not in self.stored:
            raise _RefusedError(_NOT_FOUND)
        self.stored[_absolute(after)] = self.stored.pop(_absolute(before))
        return [(0, b"")]

    def _list(self, folder: str, offset: int) -> Pieces:
        if folder not in self._folders:
            raise _RefusedError(_NOT_FOUND)
        names = sorted({*self.stored, *self._folders} - {""})
        inside = [path for path in names if path.rpartition("/")[0] == folder]
        listed = b""
        for path in inside[offset:]:
            name = path.rpartition("/")[2]
            line = f"F{name}\t{len(self.stored[path])}\0" if path in self.stored else f"D{name}\0"
            if len(listed) + len(line) >= DATA_BYTES:
                break
            listed += line.encode()
        if not listed:
            raise _RefusedError(_END)
        return [(offset, listed)]

    def _read(self, opcode: int, offset: int, size: int) -> Pieces:
        if self._reading is None:
            raise _RefusedError(_NOT_FOUND if self._writing is None else _FAIL)
        end = len(self._reading) if opcode == BURST else min(offset + size, len(self._reading))
        pieces = [(at, self._reading[at : min(at + size, end)]) for at in range(offset, end, size)]
        if not pieces or opcode == BURST:
            raise _RefusedError(_END, pieces)
        return pieces

    def _write(self, offset: int, data: bytes) -> Pieces:
        if self._writing is None:
            raise _RefusedError(_NOT_FOUND if self._reading is None else _FAIL)
        before = self.stored[self._writing].ljust(offset, b"\0")
        self.stored[self._writing] = before[:offset] + data + before[offset + len(data) :]
        return [(offset, b"")]

    def _close(self) -> None:
        self._reading = self._writing = self._session = None


def is_known(opcode: int) -> bool:
    """Whether the firmware has something to do for it, an answer that is eaten included."""
    return (opcode <= BURST and opcode != TRUNCATE) or opcode in (_ACK, _NAK)


def _absolute(name: bytes) -> str:
    path = "/" + name.decode("ascii", "replace").strip("/")
    return "" if path == "/" else path


def checksum(data: bytes) -> int:
    """CRC-32 without inversion before and after, as the protocol wants it."""
    value = 0
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0xEDB88320 if value & 1 else 0)
    return value
