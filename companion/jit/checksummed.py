"""Bytes behind their SHA-256, so that what was cut short or changed on its way is not taken for what was sent."""

from __future__ import annotations

import hashlib

DIGEST = hashlib.sha256().digest_size


class ChecksumError(Exception):
    """The bytes are not what was sealed, or nothing was."""


def with_checksum(data: bytes) -> bytes:
    """The digest, then the data."""
    return hashlib.sha256(data).digest() + data


def checked(seal: bytes) -> bytes:
    """The data, which is not empty. Raises Damaged."""
    data = seal[DIGEST:]
    if not data or hashlib.sha256(data).digest() != seal[:DIGEST]:
        raise ChecksumError
    return data
