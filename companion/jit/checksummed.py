"""Bytes behind their SHA-256, so that what was cut short or changed on its way is not taken for what was sent."""

from __future__ import annotations

import hashlib

DIGEST = hashlib.sha256().digest_size


class Damaged(Exception):
    """The bytes are not what was sealed, or nothing was."""


def sealed(data: bytes) -> bytes:
    """The digest, then the data."""
    return hashlib.sha256(data).digest() + data


def opened(seal: bytes) -> bytes:
    """The data, which is not empty. Raises Damaged."""
    data = seal[DIGEST:]
    if not data or hashlib.sha256(data).digest() != seal[:DIGEST]:
        raise Damaged
    return data
