"""SX functions, and loops of them, as source text of two languages: Python for numba, and C."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca

Name = str
PYTHON_HEAD = """
from math import acos, asin, atan, atan2, copysign, cos, cosh, exp, log, sin, sinh, sqrt, tan, tanh
from numba import njit
from numpy import ceil, floor, inf, nan, uint64
fabs = abs
pow = lambda a, b: a**b
"""
C_HEAD = """
#include <math.h>
typedef unsigned long uint64;
#define inf INFINITY
#define nan NAN
"""
BINARY = {ca.OP_ADD: "+", ca.OP_SUB: "-", ca.OP_MUL: "*", ca.OP_DIV: "/"}
COMPARE = {ca.OP_LT: "<", ca.OP_LE: "<=", ca.OP_EQ: "==", ca.OP_NE: "!="}
CALLS = {
    ca.OP_SQRT: "sqrt", ca.OP_FABS: "fabs", ca.OP_FLOOR: "floor", ca.OP_CEIL: "ceil", ca.OP_SIN: "sin",
    ca.OP_COS: "cos", ca.OP_TAN: "tan", ca.OP_ASIN: "asin", ca.OP_ACOS: "acos", ca.OP_ATAN: "atan",
    ca.OP_SINH: "sinh", ca.OP_COSH: "cosh", ca.OP_TANH: "tanh", ca.OP_EXP: "exp", ca.OP_LOG: "log",
    ca.OP_ATAN2: "atan2", ca.OP_COPYSIGN: "copysign",
}  # fmt: skip


@dataclass(frozen=True)
class Language:
    """What differs: a choice, a power, a new variable, a loop head, a block's end."""

    choose: str
    power: str
    let: str
    loop: str
    end: str

    def chosen(self, test: str, yes: str, no: str) -> str:
        """`yes` where the test holds, else `no`."""
        return self.choose.format(test=test, yes=yes, no=no)


PYTHON = Language("({yes} if {test} else {no})", "{a} ** {b}", "{name} = {value}", "for {i} in range({n}):", "")
C = Language(
    "({test} ? {yes} : {no})", "pow({a}, {b})", "const double {name} = {value};",
    "for (long {i} = 0; {i} < {n}; {i}++) {{", "}",
)  # fmt: skip


def expression(to: Language, op: int, a: Name, b: Name = "") -> str:
    """One CasADi operation. Raises KeyError where there is no counterpart."""
    if op in BINARY:
        return f"{a} {BINARY[op]} {b}"
    if op in COMPARE:
        return to.chosen(f"{a} {COMPARE[op]} {b}", "1.0", "0.0")
    if op in (ca.OP_POW, ca.OP_CONSTPOW):
        return to.power.format(a=a, b=b)
    if op in CALLS:
        return f"{CALLS[op]}({a}{', ' + b if b else ''})"
    return {
        ca.OP_ASSIGN: a, ca.OP_NEG: f"-{a}", ca.OP_SQ: f"{a} * {a}", ca.OP_TWICE: f"{a} + {a}", ca.OP_INV: f"1.0 / {a}",
        ca.OP_SIGN: to.chosen(f"{a} > 0.0", "1.0", to.chosen(f"{a} < 0.0", "-1.0", "0.0")),
        ca.OP_NOT: to.chosen(f"{a} == 0.0", "1.0", "0.0"),
        ca.OP_AND: to.chosen(f"{a} != 0.0", to.chosen(f"{b} != 0.0", "1.0", "0.0"), "0.0"),
        ca.OP_OR: to.chosen(f"{a} != 0.0", "1.0", to.chosen(f"{b} != 0.0", "1.0", "0.0")),
        ca.OP_IF_ELSE_ZERO: to.chosen(f"{a} != 0.0", b, "0.0"),
        ca.OP_FMIN: to.chosen(f"{a} < {b}", a, to.chosen(f"{b} == {b}", b, a)),
        ca.OP_FMAX: to.chosen(f"{a} > {b}", a, to.chosen(f"{b} == {b}", b, a)),
    }[op]  # fmt: skip


Load = Callable[[int, int], tuple[str, bool]]
"""(input, nonzero) -> expression, and whether it changes in the inner loop."""


def walk(to: Language, function: ca.Function, load: Load) -> tuple[list[str], list[str], dict[tuple[int, int], Name]]:
    """Lines before the inner loop, lines in it, and the name of each output nonzero."""
    outer: list[str] = []
    inner: list[str] = []
    names: dict[int, tuple[Name, bool]] = {}
    out: dict[tuple[int, int], Name] = {}
    for k in range(function.n_instructions()):
        op, into, args = function.instruction_id(k), function.instruction_output(k), function.instruction_input(k)
        if op == ca.OP_OUTPUT:
            out[into[0], into[1]] = names[args[0]][0]
            continue
        if op == ca.OP_CONST:
            value = function.instruction_constant(k)
            names[into[0]] = (repr(value) if value >= 0 or math.isnan(value) else f"({value!r})"), False
            continue
        text, varies = load(args[0], args[1]) if op == ca.OP_INPUT else ("", any(names[i][1] for i in args))
        text = text or expression(to, op, *(names[i][0] for i in args))
        names[into[0]] = f"v{k}", varies
        (inner if varies else outer).append(to.let.format(name=f"v{k}", value=text))
    return outer, inner, out
