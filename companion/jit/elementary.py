"""sin, cos, exp, log, pow and atan2 of lanes, as straight lines of LLVM's language.

LLVM knows no such functions for vectors: it calls the C library's once for each lane, which costs more than all the
rest of a boat's dynamics. These here are the same for every lane, processor and width; their results are within a few
units in the last place of the C library's (a test measures it). What they leave out:

    sin, cos   NaN beyond |x| = `FAR`
    exp        0 below -708, where the C library's becomes subnormal
    pow        a^b = exp(b log a): its last digits are lost as |b log a| grows
    sin, cos   of atan2(y, x): wrong where y^2 + x^2 is beyond 1e308 or below 1e-300

Sources: coefficients of sin, cos and log from fdlibm (Sun Microsystems, 1993), of atan from Cephes (Moshier, 1989);
exp is Taylor's series of degree 13 on |x| <= log(2) / 2, where the next term is below 5e-18.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import casadi as ca

from companion.jit.emit import constant

if TYPE_CHECKING:
    from companion.jit.lanes import Lanes

FAR = 1e6
"""[rad] Up to here x - n pi / 2 is exact enough: n fits into 20 bits."""
_PI_2 = (1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624879595063154e-21)
"""pi / 2 in three parts; the first two have 33 bits, so that n times them is exact."""
_SIN = (
    -1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04, 2.75573137070700676789e-06,
    -2.50507602534068634195e-08, 1.58969099521155010221e-10,
)  # fmt: skip
_COS = (
    4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05, -2.75573143513906633035e-07,
    2.08757232129817482790e-09, -1.13596475577881948265e-11,
)  # fmt: skip
_LN2 = (6.93147180369123816490e-01, 1.90821492927058770002e-10)
_LOG = (
    6.666666666666735130e-01, 3.999999999940941908e-01, 2.857142874366239149e-01, 2.222219843214978396e-01,
    1.818357216161805012e-01, 1.531383769920937332e-01, 1.479819860511658591e-01,
)  # fmt: skip
_EXP = tuple(1 / math.factorial(k) for k in range(2, 14))
"""From x^2 on."""
_ATAN_P = (
    -6.485021904942025371773e1, -1.228866684490136173410e2, -7.500855792314704667340e1, -1.615753718733365076637e1,
    -8.750608600031904122785e-1,
)  # fmt: skip
_ATAN_Q = (
    1.945506571482613964425e2, 4.853903996359136964868e2, 4.328810604912902668951e2, 1.650270098316988542046e2,
    2.485846490142306297962e1, 1.0,
)  # fmt: skip
_MAGIC = 1.5 * 2.0**52
"""Added to a small number it rounds it to a whole one, which then stands in the lowest bits."""


class Lines:
    """Arithmetic on lanes of one body: names in, names out."""

    def __init__(self, body: Lanes):
        self.body = body
        self.double, self.whole, self.bit = body.type_of(True), f"<{body.width} x i64>", f"<{body.width} x i1>"

    def number(self, value: float) -> str:
        """The same number in every lane."""
        return self.body.spread((constant(value), False))

    def integer(self, value: int) -> str:
        """The same 64 bits in every lane."""
        return "<" + ", ".join([f"i64 {value}"] * self.body.width) + ">"

    def two(self, op: str, a: str, b: str) -> str:
        """fadd, fsub, fmul or fdiv."""
        return self.body.binary(op, (a, True), (b, True))[0]

    def call(self, name: str, *args: str) -> str:
        """A function of LLVM's own."""
        return self.body.call(name, *((a, True) for a in args))[0]

    def bits(self, op: str, a: str, b: str) -> str:
        """and, or, xor, add, sub, shl, ashr."""
        return self.body.add(f"{op} {self.whole} {a}, {b}")

    def as_bits(self, a: str) -> str:
        """The bits of doubles."""
        return self.body.add(f"bitcast {self.double} {a} to {self.whole}")

    def as_double(self, a: str) -> str:
        """Doubles of bits."""
        return self.body.add(f"bitcast {self.whole} {a} to {self.double}")

    def test(self, op: str, a: str, b: str) -> str:
        """A comparison of doubles."""
        return self.body.add(f"fcmp {op} {self.double} {a}, {b}")

    def choose(self, test: str, yes: str, no: str) -> str:
        """Lane by lane."""
        return self.body.add(f"select {self.bit} {test}, {self.double} {yes}, {self.double} {no}")

    def series(self, z: str, coefficients: Sequence[float]) -> str:
        """c_0 + z (c_1 + z (..)), even and odd powers side by side: half the waiting."""
        if len(coefficients) > 3:
            square = self.two("fmul", z, z)
            even, odd = (self.series(square, coefficients[k::2]) for k in (0, 1))
            return self.two("fadd", even, self.two("fmul", odd, z))
        total = self.number(coefficients[-1])
        for c in reversed(coefficients[:-1]):
            total = self.two("fadd", self.number(c), self.two("fmul", total, z))
        return total

    def rounded(self, a: str, factor: float) -> tuple[str, str]:
        """`factor` a rounded to a whole number: as a double, and as bits whose lowest are that number."""
        high = self.two("fadd", self.two("fmul", a, self.number(factor)), self.number(_MAGIC))
        return self.two("fsub", high, self.number(_MAGIC)), self.as_bits(high)


def _turned(at: Lines, x: str) -> tuple[str, str, str]:
    """sin and cos of x less whole quarter turns, NaN where x is too far; how many those are."""
    n, quarter = at.rounded(x, 2 / math.pi)
    y = x
    for part in _PI_2:
        y = at.two("fsub", y, at.two("fmul", n, at.number(part)))
    y = at.choose(at.test("ole", at.call("fabs", x), at.number(FAR)), y, at.number(math.nan))
    z = at.two("fmul", y, y)
    sine = at.two("fadd", y, at.two("fmul", at.two("fmul", y, z), at.series(z, _SIN)))
    half = at.two("fmul", z, at.number(0.5))
    near = at.two("fsub", at.number(1.0), half)
    rest = at.two("fsub", at.two("fsub", at.number(1.0), near), half)
    tail = at.two("fmul", at.two("fmul", z, z), at.series(z, _COS))
    return sine, at.two("fadd", near, at.two("fadd", rest, tail)), quarter


def _quarter(at: Lines, even: str, odd: str, quarter: str) -> str:
    """By quarter turns: even, odd, -even, -odd."""
    is_odd = at.body.add(f"trunc {at.whole} {quarter} to {at.bit}")
    sign = at.bits("shl", at.bits("and", quarter, at.integer(2)), at.integer(62))
    return at.as_double(at.bits("xor", at.as_bits(at.choose(is_odd, odd, even)), sign))


def _sin(at: Lines, x: str) -> str:
    sine, cosine, quarter = _turned(at, x)
    return _quarter(at, sine, cosine, quarter)


def _cos(at: Lines, x: str) -> str:
    sine, cosine, quarter = _turned(at, x)
    return _quarter(at, sine, cosine, at.bits("add", quarter, at.integer(1)))


def _exp(at: Lines, x: str) -> str:
    n, whole = at.rounded(x, 1 / math.log(2))
    r = x
    for part in _LN2:
        r = at.two("fsub", r, at.two("fmul", n, at.number(part)))
    power = at.bits("shl", whole, at.integer(52))
    less_one = at.two("fadd", r, at.two("fmul", at.two("fmul", r, r), at.series(r, _EXP)))
    scaled = at.as_double(at.bits("add", at.as_bits(at.two("fadd", at.number(1.0), less_one)), power))
    low, high = at.test("olt", x, at.number(-708.0)), at.test("ogt", x, at.number(709.782712893384))
    there = at.choose(low, at.number(0.0), at.choose(high, at.number(math.inf), scaled))
    return at.choose(at.test("uno", x, x), x, there)


def _log(at: Lines, x: str) -> str:
    small = at.test("olt", x, at.number(2.0**-1022))
    normal = at.choose(small, at.two("fmul", x, at.number(2.0**54)), x)
    bits = at.as_bits(normal)
    over = at.bits("sub", bits, at.integer(_bits(math.sqrt(0.5))))
    power = at.bits("ashr", over, at.integer(52))
    mantissa = at.bits("sub", bits, at.bits("shl", power, at.integer(52)))
    magic = at.as_double(at.bits("add", power, at.integer(_bits(_MAGIC))))
    n = at.two("fsub", magic, at.number(_MAGIC))
    n = at.choose(small, at.two("fsub", n, at.number(54.0)), n)
    f = at.two("fsub", at.as_double(mantissa), at.number(1.0))
    s = at.two("fdiv", f, at.two("fadd", f, at.number(2.0)))
    z = at.two("fmul", s, s)
    R = at.two("fmul", z, at.series(z, _LOG))
    half = at.two("fmul", at.two("fmul", f, f), at.number(0.5))
    inner = at.two("fadd", at.two("fmul", s, at.two("fadd", half, R)), at.two("fmul", n, at.number(_LN2[1])))
    near = at.two("fsub", at.two("fmul", n, at.number(_LN2[0])), at.two("fsub", at.two("fsub", half, inner), f))
    there = at.choose(at.test("oeq", x, at.number(math.inf)), x, near)
    there = at.choose(at.test("oeq", x, at.number(0.0)), at.number(-math.inf), there)
    return at.choose(at.test("oge", x, at.number(0.0)), there, at.number(math.nan))


def _pow(at: Lines, a: str, b: str) -> str:
    is_one = at.test("oeq", b, at.number(0.0))
    if a in at.body.never_negative:
        return at.choose(is_one, at.number(1.0), _exp(at, at.two("fmul", b, _log(at, a))))
    size = _exp(at, at.two("fmul", b, _log(at, at.call("fabs", a))))
    whole = at.call("rint", b)
    half = at.two("fmul", b, at.number(0.5))
    odd = at.test("une", at.call("rint", half), half)
    of_whole = at.choose(odd, at.body.add(f"fneg {at.double} {size}"), size)
    negative = at.choose(at.test("oeq", whole, b), of_whole, at.number(math.nan))
    there = at.choose(at.test("olt", a, at.number(0.0)), negative, size)
    return at.choose(is_one, at.number(1.0), there)


def _atan2(at: Lines, y: str, x: str) -> str:
    wide, high = at.call("fabs", x), at.call("fabs", y)
    steep = at.test("ogt", high, wide)
    large, less = at.choose(steep, high, wide), at.choose(steep, wide, high)
    t = at.two("fdiv", less, at.choose(at.test("oeq", large, at.number(0.0)), at.number(1.0), large))
    beyond = at.test("ogt", t, at.number(0.66))
    turned = at.two("fdiv", at.two("fsub", t, at.number(1.0)), at.two("fadd", t, at.number(1.0)))
    t = at.choose(beyond, turned, t)
    z = at.two("fmul", t, t)
    bent = at.two("fdiv", at.two("fmul", z, at.series(z, _ATAN_P)), at.series(z, _ATAN_Q))
    angle = at.two("fadd", t, at.two("fmul", t, bent))
    angle = at.two("fadd", angle, at.choose(beyond, at.number(math.pi / 4), at.number(0.0)))
    angle = at.choose(steep, at.two("fsub", at.number(math.pi / 2), angle), angle)
    behind = at.body.add(f"icmp slt {at.whole} {at.as_bits(x)}, {at.integer(0)}")
    angle = at.choose(behind, at.two("fsub", at.number(math.pi), angle), angle)
    angle = at.choose(at.test("uno", x, y), at.number(math.nan), angle)
    return at.call("copysign", angle, y)


def direction(at: Lines, y: str, x: str) -> tuple[str, str]:
    """Sine and cosine of atan2(y, x); 0, 1 where both are nil."""
    far = at.call("sqrt", at.two("fadd", at.two("fmul", x, x), at.two("fmul", y, y)))
    nil = at.test("oeq", far, at.number(0.0))
    one = at.two("fdiv", at.number(1.0), at.choose(nil, at.number(1.0), far))
    return at.two("fmul", y, one), at.choose(nil, at.number(1.0), at.two("fmul", x, one))


def doubled(at: Lines, sine: str, cosine: str) -> tuple[str, str]:
    """Of twice the angle."""
    product = at.two("fmul", sine, cosine)
    squares = at.two("fsub", at.two("fmul", cosine, cosine), at.two("fmul", sine, sine))
    return at.two("fadd", product, product), squares


def _bits(value: float) -> int:
    return struct.unpack("<q", struct.pack("<d", value))[0]


OF_LANES: dict[int, Callable[..., str]] = {
    ca.OP_SIN: _sin, ca.OP_COS: _cos, ca.OP_EXP: _exp, ca.OP_LOG: _log, ca.OP_POW: _pow, ca.OP_CONSTPOW: _pow,
    ca.OP_ATAN2: _atan2,
}  # fmt: skip
"""By CasADi's operation: names of lanes in, name of the lane that comes out."""
