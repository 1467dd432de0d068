"""A program as loops of SX functions over one block of doubles: a description, for whoever makes machine code of it.

A `Kernel` is an SX function with the places of its arguments; a `Loop` runs kernels for k = 0, 1, .. or backwards;
`Repeat` runs a body while a flag in memory is not nil, up to a count. An entry is a list of them:

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
    """No machine code here; the text says why."""


@dataclass(frozen=True)
class Operand:
    """Where the nonzeros of one argument are. `lane`: distance between lanes; None: the same for all of them."""

    base: int
    step: int
    offsets: Sequence[int]
    lane: int | None = None


@dataclass(frozen=True)
class Kernel:
    """An SX function, where its inputs and outputs are, and how many lanes it works on at once."""

    function: ca.Function
    inputs: Sequence[Operand]
    outputs: Sequence[Operand]
    width: int = 1


@dataclass(frozen=True)
class Loop:
    """The kernels, in their order, for each k of `indices`, which are `first`, `first + by`, .. `count` of them.

    A last step that would go beyond `last` is drawn back to it: lanes that overlap compute the same twice.
    """

    kernels: Sequence[Kernel]
    count: int
    first: int = 0
    by: int = 1
    last: int | None = None


@dataclass(frozen=True)
class Repeat:
    """The body while memory[flag] is not nil, at most `most` times."""

    body: Sequence[Step]
    flag: int
    most: int


@dataclass(frozen=True)
class Fetch:
    """Call the program's code into the cache, up to but without `end`, all lines at once, where they would come one
    after the other after a sleep. What that is worth: docs/benchmarks/speed.md.
    """

    end: Kernel


Step = Loop | Repeat | Fetch


def over_stages(kernels: Sequence[Kernel], stages: int) -> Loop:
    """A loop over stages for kernels whose lanes are stages."""
    width = kernels[0].width
    return Loop(kernels, -(-stages // width), 0, width, stages - width)


class Compiler(Protocol):
    """Makes machine code of a program."""

    def __call__(
        self, entries: Mapping[str, Sequence[Step]], memory: np.ndarray, /
    ) -> Mapping[str, Callable[[], None]]:
        """A function for each entry that runs it over `memory`, doubles, contiguous. Raises NotCompiled."""
        ...
