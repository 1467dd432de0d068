"""A program as loops of SX functions over one block of doubles: a description that a `Compiler` makes machine code of.

A `Kernel` is an SX function with the addresses of its arguments; a `Loop` runs kernels for k = 0, 1, .. or backwards;
`Repeat` runs a body while a flag in memory is not zero, up to a count. An entry is a list of steps:

    operand of nonzero i, loop index k, lane l:   memory[base + step k + offsets[i] + lane l]

Such a program allocates nothing, and its time is bounded by its counts. A `Compiler` comes from outside the core
(`companion.jit`, ADR 30).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import casadi as ca
import numpy as np


class NotCompiled(Exception):
    """Machine code cannot be made or run on this machine; the text says why."""


@dataclass(frozen=True)
class Operand:
    """Addresses of the nonzeros of one argument, in doubles. `lane`: from lane to lane; None: one for all lanes."""

    base: int
    step: int
    offsets: Sequence[int]
    lane: int | None = None


@dataclass(frozen=True)
class Kernel:
    """An SX function, the addresses of its inputs and outputs, and its number of lanes."""

    function: ca.Function
    inputs: Sequence[Operand]
    outputs: Sequence[Operand]
    width: int = 1


@dataclass(frozen=True)
class Loop:
    """The kernels, in their order, for `count` indices k = `first`, `first + by`, ..

    An index beyond `last` is replaced by `last`: overlapping lanes compute the same values twice.
    """

    kernels: Sequence[Kernel]
    count: int
    first: int = 0
    by: int = 1
    last: int | None = None


@dataclass(frozen=True)
class Repeat:
    """The body while memory[flag] is not zero, at most `most` times."""

    body: Sequence[Step]
    flag: int
    most: int


@dataclass(frozen=True)
class Fetch:
    """Prefetch the program's code, up to but without the kernel `end`: all cache lines at once, where after a sleep
    they would be loaded one after the other. Time saved: docs/benchmarks/speed.md.
    """

    end: Kernel


Step = Loop | Repeat | Fetch


def over_stages(kernels: Sequence[Kernel], stages: int) -> Loop:
    """Loop over `stages` for kernels whose lanes are stages."""
    width = kernels[0].width
    return Loop(kernels, -(-stages // width), 0, width, stages - width)


class Compiler(Protocol):
    """Makes machine code of a program."""

    def __call__(
        self, entries: Mapping[str, Sequence[Step]], memory: np.ndarray, /
    ) -> Mapping[str, Callable[[], None]]:
        """A function for each entry that runs it over `memory`, doubles, contiguous. Raises NotCompiled."""
        ...
