"""Values of a body of lane vectors with Python's operators: each writes one LLVM instruction and names its result."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from companion.jit.emit import constant

if TYPE_CHECKING:
    from companion.jit.lanes import Lanes

MAGIC = 1.5 * 2.0**52
"""Adding it rounds a small number to an integer, which is then in the lowest bits of the sum."""


def _line(op: str, *, swapped: bool = False) -> Callable[[Any, Any], Any]:
    return lambda a, b: a.two(op, b, a) if swapped else a.two(op, a, b)


@dataclass(frozen=True)
class Lane:
    """A vector of doubles; a number as other operand is broadcast."""

    body: Lanes
    name: str

    __add__, __sub__, __mul__, __truediv__ = map(_line, ("fadd", "fsub", "fmul", "fdiv"))
    __radd__, __rsub__ = _line("fadd", swapped=True), _line("fsub", swapped=True)
    __rmul__, __rtruediv__ = _line("fmul", swapped=True), _line("fdiv", swapped=True)

    def two(self, op: str, a: Lane | float, b: Lane | float) -> Lane:
        """fadd, fsub, fmul or fdiv."""
        return Lane(self.body, self.body.binary(op, (_name(self.body, a), True), (_name(self.body, b), True))[0])

    def __neg__(self) -> Lane:
        return Lane(self.body, self.body.add(f"fneg {self.body.type_of(True)} {self.name}"))

    def call(self, name: str, *others: Lane) -> Lane:
        """An LLVM intrinsic, element by element."""
        return Lane(self.body, self.body.call(name, *((v.name, True) for v in (self, *others)))[0])

    def test(self, op: str, other: Lane | float) -> Test:
        """A comparison; `op`: predicate of LLVM's fcmp."""
        kind, b = self.body.type_of(True), _name(self.body, other)
        return Test(self.body, self.body.add(f"fcmp {op} {kind} {self.name}, {b}"))

    def bits(self) -> Bits:
        """The bits of these doubles."""
        width = self.body.width
        return Bits(self.body, self.body.add(f"bitcast <{width} x double> {self.name} to <{width} x i64>"))

    def rounded(self, factor: float) -> tuple[Lane, Bits]:
        """`factor` times this, rounded to an integer: as a double, and as bits with the integer in the lowest ones."""
        high = self * factor + MAGIC
        return high - MAGIC, high.bits()


@dataclass(frozen=True)
class Bits:
    """The 64 bits of each lane."""

    body: Lanes
    name: str

    __and__, __xor__, __add__, __sub__, __lshift__, __rshift__ = map(_line, ("and", "xor", "add", "sub", "shl", "ashr"))

    def two(self, op: str, _: Bits, other: Bits | int) -> Bits:
        """and, xor, add, sub, shl, ashr, or a comparison by icmp."""
        width = self.body.width
        b = other.name if isinstance(other, Bits) else f"<{', '.join([f'i64 {other}'] * width)}>"
        return Bits(self.body, self.body.add(f"{op} <{width} x i64> {self.name}, {b}"))

    def odd(self) -> Test:
        """Whether the lowest bit is set."""
        width = self.body.width
        return Test(self.body, self.body.add(f"trunc <{width} x i64> {self.name} to <{width} x i1>"))

    def negative(self) -> Test:
        """Whether the highest bit is set."""
        return Test(self.body, self.two("icmp slt", self, 0).name)

    def double(self) -> Lane:
        """The doubles with these bits."""
        width = self.body.width
        return Lane(self.body, self.body.add(f"bitcast <{width} x i64> {self.name} to <{width} x double>"))


@dataclass(frozen=True)
class Test:
    """A boolean for each lane."""

    body: Lanes
    name: str

    def choose(self, yes: Lane | float, no: Lane | float) -> Lane:
        """`yes` or `no`, lane by lane."""
        kind, (y, n) = self.body.type_of(True), (_name(self.body, v) for v in (yes, no))
        return Lane(self.body, self.body.add(f"select <{self.body.width} x i1> {self.name}, {kind} {y}, {kind} {n}"))


def _name(body: Lanes, value: Lane | float) -> str:
    return value.name if isinstance(value, Lane) else body.spread((constant(value), False))
