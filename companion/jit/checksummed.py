"""Bytes behind their SHA-256, so that truncated or changed data is detected."""

from __future__ import annotations

import hashlib

DIGEST = hashlib.sha256().digest_size


class ChecksumError(Exception):
    """The data does not match its checksum, or is empty."""


def with_checksum(data: bytes) -> bytes:
    """SHA-256 of the data, then the data."""
    return hashlib.sha256(data).digest() + data


def checked(message: bytes) -> bytes:
    """The data of `with_checksum`, not empty. Raises ChecksumError."""
    data = message[DIGEST:]
    if not data or hashlib.sha256(data).digest() != message[:DIGEST]:
        raise ChecksumError
    return data
