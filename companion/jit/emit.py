"""An SX function as text of LLVM's intermediate language: one line for each operation.

A value is a scalar or a lane vector ("lane"): the same quantity for `width` neighbours (stages of a horizon, columns of
a matrix, boats). Operations on scalars alone give a scalar; otherwise scalars are broadcast. A multiplication and an
addition may become one fused operation (`contract`), nothing else is rearranged: results differ from CasADi's own in
the last bits only.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence

import casadi as ca

from companion.core.control.rti.loops import NotCompiled

Value = tuple[str, bool]
"""Name in the text, and whether it is a lane vector."""

BINARY = {ca.OP_ADD: "fadd", ca.OP_SUB: "fsub", ca.OP_MUL: "fmul", ca.OP_DIV: "fdiv"}
COMPARE = {ca.OP_LT: "olt", ca.OP_LE: "ole", ca.OP_EQ: "oeq", ca.OP_NE: "une"}
CALLS = {
    ca.OP_SQRT: "sqrt", ca.OP_FABS: "fabs", ca.OP_FLOOR: "floor", ca.OP_CEIL: "ceil",
    ca.OP_SIN: "sin", ca.OP_COS: "cos", ca.OP_TAN: "tan", ca.OP_ASIN: "asin", ca.OP_ACOS: "acos", ca.OP_ATAN: "atan",
    ca.OP_SINH: "sinh", ca.OP_COSH: "cosh", ca.OP_TANH: "tanh", ca.OP_EXP: "exp", ca.OP_LOG: "log",
    ca.OP_FMIN: "minnum", ca.OP_FMAX: "maxnum", ca.OP_POW: "pow", ca.OP_CONSTPOW: "pow", ca.OP_ATAN2: "atan2",
    ca.OP_COPYSIGN: "copysign",
}  # fmt: skip
"""Operations with an LLVM intrinsic, and its name."""


def bits_of(value: float) -> int:
    """The 64 bits of a double."""
    return struct.unpack("<Q", struct.pack("<d", value))[0]


def constant(value: float) -> str:
    """A number in LLVM's syntax: its bits in hexadecimal."""
    return f"0x{bits_of(value):016X}"


class Body:
    """Lines of one LLVM function. `width`: lanes of a vector; 1: scalars only."""

    def __init__(self, width: int):
        self.width = width
        self.lines: list[str] = []
        self.intrinsics: set[str] = set()
        self._count = 0

    def type_of(self, lane: bool) -> str:
        """LLVM's name of the type."""
        return f"<{self.width} x double>" if lane else "double"

    def add(self, text: str) -> str:
        """Append one instruction; the name of its result."""
        self._count += 1
        self.lines.append(f"  %v{self._count} = {text}")
        return f"%v{self._count}"

    def spread(self, value: Value) -> str:
        """Broadcast a value to a lane vector; its name."""
        name, lane = value
        if lane:
            return name
        if name.startswith("0x"):
            return "<" + ", ".join([f"double {name}"] * self.width) + ">"
        kind = self.type_of(True)
        first = self.add(f"insertelement {kind} poison, double {name}, i32 0")
        return self.add(f"shufflevector {kind} {first}, {kind} poison, <{self.width} x i32> zeroinitializer")

    def gathered(self, place: Callable[[int], str]) -> Value:
        """A lane vector of doubles at any addresses; `place`: pointer of each."""
        kind, lane = self.type_of(True), "poison"
        for i in range(self.width):
            one = self.add(f"load double, ptr {place(i)}, align 8")
            lane = self.add(f"insertelement {kind} {lane}, double {one}, i32 {i}")
        return lane, True

    def scatter(self, value: Value, place: Callable[[int], str]) -> None:
        """Store the doubles of a lane vector to any addresses."""
        for i in range(self.width):
            one = self.add(f"extractelement {self.type_of(True)} {value[0]}, i32 {i}") if value[1] else value[0]
            self.lines.append(f"  store double {one}, ptr {place(i)}, align 8")

    def alike(self, *values: Value) -> tuple[list[str], bool]:
        """Names of the values, broadcast if one of them is a lane vector; whether that is so."""
        lane = any(v[1] for v in values)
        return [self.spread(v) if lane else v[0] for v in values], lane

    def call(self, name: str, *values: Value) -> Value:
        """An LLVM intrinsic, element by element."""
        names, lane = self.alike(*values)
        kind = self.type_of(lane)
        full = f"llvm.{name}." + (f"v{self.width}f64" if lane else "f64")
        self.intrinsics.add(f"declare {kind} @{full}({', '.join([kind] * len(names))})")
        return self.add(f"call contract {kind} @{full}({', '.join(f'{kind} {n}' for n in names)})"), lane

    def binary(self, op: str, a: Value, b: Value) -> Value:
        """fadd, fsub, fmul or fdiv."""
        (left, right), lane = self.alike(a, b)
        return self.add(f"{op} contract {self.type_of(lane)} {left}, {right}"), lane

    def where(self, op: str, a: Value, b: Value, yes: Value, no: Value) -> Value:
        """`yes` where a op b holds, else `no`."""
        (left, right, y, n), lane = self.alike(a, b, yes, no)
        kind, bit = self.type_of(lane), f"<{self.width} x i1>" if lane else "i1"
        test = self.add(f"fcmp {op} {kind} {left}, {right}")
        return self.add(f"select {bit} {test}, {kind} {y}, {kind} {n}"), lane

    def operation(self, op: int, args: Sequence[Value]) -> Value:
        """One CasADi operation. Raises NotCompiled."""
        if op in BINARY:
            return self.binary(BINARY[op], args[0], args[1])
        if op in COMPARE:
            return self.where(COMPARE[op], args[0], args[1], ONE, ZERO)
        if op in CALLS:
            return self.call(CALLS[op], *args)
        if rule := RULES.get(op):
            return rule(self, *args)
        raise NotCompiled(f"CasADi operation {op} has no counterpart")


ZERO, ONE = (constant(0.0), False), (constant(1.0), False)


def _sign(body: Body, a: Value) -> Value:
    return body.where("ogt", a, ZERO, ONE, body.where("olt", a, ZERO, (constant(-1.0), False), ZERO))


RULES: dict[int, Callable[..., Value]] = {
    ca.OP_ASSIGN: lambda body, a: a,
    ca.OP_NEG: lambda body, a: (body.add(f"fneg {body.type_of(a[1])} {a[0]}"), a[1]),
    ca.OP_SQ: lambda body, a: body.binary("fmul", a, a),
    ca.OP_TWICE: lambda body, a: body.binary("fadd", a, a),
    ca.OP_INV: lambda body, a: body.binary("fdiv", ONE, a),
    ca.OP_SIGN: _sign,
    ca.OP_NOT: lambda body, a: body.where("oeq", a, ZERO, ONE, ZERO),
    ca.OP_AND: lambda body, a, b: body.where("une", body.where("une", a, ZERO, b, ZERO), ZERO, ONE, ZERO),
    ca.OP_OR: lambda body, a, b: body.where("une", a, ZERO, ONE, body.where("une", b, ZERO, ONE, ZERO)),
    ca.OP_IF_ELSE_ZERO: lambda body, a, b: body.where("une", a, ZERO, b, ZERO),
}
"""Operations of several instructions, or of none."""


def translate(
    function: ca.Function, body: Body, load: Callable[[int, int], Value], store: Callable[[int, int, Value], None]
) -> None:
    """Translate an SX function instruction by instruction. `load(input, nonzero)`, `store(output, nonzero, value)`."""
    slots: dict[int, Value] = {}
    for op, out, args, number in _instructions(function):
        if op == ca.OP_INPUT:
            slots[out[0]] = load(args[0], args[1])
        elif op == ca.OP_OUTPUT:
            store(out[0], out[1], slots[args[0]])
        elif op == ca.OP_CONST:
            slots[out[0]] = (constant(number), False)
        else:
            slots[out[0]] = body.operation(op, [slots[i] for i in args])


def _instructions(function: ca.Function) -> Iterator[tuple[int, list[int], list[int], float]]:
    for k in range(function.n_instructions()):
        op = function.instruction_id(k)
        number = function.instruction_constant(k) if op == ca.OP_CONST else 0.0
        yield op, function.instruction_output(k), function.instruction_input(k), number
