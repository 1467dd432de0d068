"""Readers under mutated bytes: valid inputs of each, broken at random from a seed, and what comes out.

    flip, insert, delete, splice, truncate, repeat, and for text: another number, another token

A case passes where the reader returns, or raises the error that it documents; anything else is kept by its kind
with the bytes that caused it. A case that takes over `CASE_S` counts as one that never ends.
"""

from __future__ import annotations

import contextlib
import io
import random
import re
import signal
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from tests.support.fuzzing.readers import READERS

CASE_S = 20
NUMBERS = (b"nan", b"-inf", b"1e999", b"-1", b"0", b"18446744073709551616", b"1e-320", b"0x7f", b"9" * 400, b"-0.0")


class TookTooLongError(Exception):
    """A case that does not end."""


@dataclass
class Outcome:
    """Cases, bytes, documented errors, and first examples of what should not have been raised, by kind."""

    cases: int = 0
    size: int = 0
    raised: Counter[str] = field(default_factory=Counter)
    wrong: dict[str, bytes] = field(default_factory=dict)


def fuzz(name: str, size: int, seed: int) -> Outcome:
    """Give a reader `size` bytes of mutated input, drawn from `seed`."""
    reader, dice, out = READERS[name], random.Random(f"{name} {seed}"), Outcome()
    seeds, read = reader.seeds(), reader.make()
    for data in seeds:
        read(data)  # valid input passes: raises where it does not
    with _bounded(), contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        while out.size < size:
            data = mutated(dice, seeds, text=reader.text)
            out.cases, out.size = out.cases + 1, out.size + len(data)
            read = read if reader.stream else reader.make()
            signal.alarm(CASE_S)
            try:
                read(data)
            except reader.documented as error:
                out.raised[type(error).__name__] += 1
            except Exception as error:
                out.wrong.setdefault(kind_of(error), data)
                read = reader.make()
            finally:
                signal.alarm(0)
    return out


def kind_of(error: BaseException) -> str:
    """Type, place and text: two errors of one kind are one finding."""
    at = error.__traceback__
    while at and at.tb_next:
        at = at.tb_next
    where = f"{Path(at.tb_frame.f_code.co_filename).name}:{at.tb_lineno}" if at else ""
    return f"{type(error).__name__} at {where}: {str(error)[:120]}"


@contextlib.contextmanager
def _bounded():
    def late(*_):
        raise TookTooLongError(f"over {CASE_S} s")

    before = signal.signal(signal.SIGALRM, late)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def mutated(dice: random.Random, seeds: list[bytes], *, text: bool) -> bytes:
    """One of the seeds after one to eight changes; of text one to three, most of them whole numbers and words."""
    data = bytearray(dice.choice(seeds))
    for _ in range(dice.randint(1, 3 if text else 8)):
        at, length = dice.randrange(len(data) + 1), min(len(data), 1 << dice.randrange(9))
        change = dice.choice((6, 7)) if text and dice.random() < 0.7 else dice.randrange(6)
        if change == 0 and data:
            data[at % len(data)] ^= 1 << dice.randrange(8)
        elif change == 1:
            data[at:at] = dice.randbytes(dice.randint(1, 16))
        elif change == 2:
            del data[at : at + length]
        elif change == 3:
            other = dice.choice(seeds)
            begin = dice.randrange(len(other))
            data[at : at + length] = other[begin : begin + length]
        elif change == 4:
            del data[max(at, len(data) // 4) :]
        elif change == 5:
            data[at:at] = bytes(data[at : at + length]) * dice.randint(1, 8)
        elif tokens := list(re.finditer(rb"-?\d[\d.e+-]*" if change == 6 else rb"\w+", data)):
            token = dice.choice(tokens)
            data[slice(*token.span())] = dice.choice(NUMBERS) if change == 6 else dice.choice(tokens)[0]
    return bytes(data)
