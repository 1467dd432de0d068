"""A function body of lane vectors whose results depend on the expression only, not on width, processor or compiler."""

from __future__ import annotations

import struct
from collections.abc import Collection, Sequence

import casadi as ca

from companion.jit.elementary import OF_LANES, atan2_sine_cosine, double_angle
from companion.jit.emit import Body, Value, constant
from companion.jit.operators import Lane


class Lanes(Body):
    """A body with its own sin, cos, exp, log, pow and atan2 (`elementary`), that leaves no choice to the compiler.

    A sum with a product is written as one fused multiply-add; a division by a constant (a number, or a name in
    `steady`) as a product with its reciprocal. So results do not depend on the width and are the same on every
    processor. Sine and cosine of atan2(y, x) are y / r and x / r, so that the angle need not be computed.
    """

    def __init__(self, width: int, steady: Collection[str] = ()):
        super().__init__(width)
        self._steady = steady
        self._products: dict[str, tuple[str, str]] = {}
        self._reciprocals: dict[str, Value] = {}
        self._angles: dict[str, tuple[Lane, Lane]] = {}
        self.never_negative: set[str] = set()

    def operation(self, op: int, args: Sequence[Value]) -> Value:
        """One CasADi operation; the functions of `OF_LANES` by `elementary`."""
        names, lane = self.alike(*args)
        if not lane:
            return super().operation(op, args)
        known = self._angles.get(names[0])
        if known and op in (ca.OP_SIN, ca.OP_COS):
            return known[op == ca.OP_COS].name, True
        rule, lanes = OF_LANES.get(op), [Lane(self, name) for name in names]
        value = (rule(*lanes).name, True) if rule else super().operation(op, args)
        if op == ca.OP_ATAN2:
            self._angles[value[0]] = atan2_sine_cosine(*lanes)
        elif known and op == ca.OP_NEG:
            self._angles[value[0]] = -known[0], known[1]
        elif known and op == ca.OP_TWICE:
            self._angles[value[0]] = double_angle(*known)
        if op in (ca.OP_FABS, ca.OP_SQRT, ca.OP_SQ) or (op == ca.OP_FMAX and any(map(self._is_nonnegative, args))):
            self.never_negative.add(value[0])
        return value

    def _is_nonnegative(self, value: Value) -> bool:
        """Whether the value is known to be never negative (it may be NaN)."""
        name = value[0]
        return parsed_constant(name) >= 0 if name.startswith("0x") else name in self.never_negative

    def binary(self, op: str, a: Value, b: Value) -> Value:
        """fadd, fsub, fmul or fdiv, fused where an operand is a product."""
        if op == "fdiv" and (reciprocal := self._reciprocal(b)):
            op, b = "fmul", reciprocal
        (left, right), lane = self.alike(a, b)
        kind = self.type_of(lane)
        if op == "fmul":
            name = self.add(f"fmul {kind} {left}, {right}")
            self._products[name] = left, right
            if self._is_nonnegative(a) and self._is_nonnegative(b):
                self.never_negative.add(name)
            return name, lane
        if op in ("fadd", "fsub") and right in self._products:
            x, y = self._products[right]
            return self._fused(lane, self._negative(kind, x) if op == "fsub" else x, y, left), lane
        if op in ("fadd", "fsub") and left in self._products:
            x, y = self._products[left]
            return self._fused(lane, x, y, self._negative(kind, right) if op == "fsub" else right), lane
        return self.add(f"{op} {kind} {left}, {right}"), lane

    def _reciprocal(self, b: Value) -> Value | None:
        """1 / b where b is constant and not 0, else None."""
        name, lane = b
        if name.startswith("0x"):
            return (constant(1 / value), False) if (value := parsed_constant(name)) else None
        if name in self._steady and name not in self._reciprocals:
            one, kind = self.alike((constant(1.0), False), b)[0][0], self.type_of(lane)
            self._reciprocals[name] = self.add(f"fdiv {kind} {one}, {name}"), lane
        return self._reciprocals.get(name)

    def _fused(self, lane: bool, x: str, y: str, z: str) -> str:
        """Fused multiply-add x y + z, rounded once."""
        return self.call("fma", (x, lane), (y, lane), (z, lane))[0]

    def _negative(self, kind: str, x: str) -> str:
        return self.add(f"fneg {kind} {x}")


def parsed_constant(text: str) -> float:
    """The number that `constant` wrote."""
    return struct.unpack("<d", int(text, 16).to_bytes(8, "little"))[0]
