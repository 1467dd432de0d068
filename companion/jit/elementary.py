"""sin, cos, exp, log, pow and atan2 of vectors, as straight-line LLVM code.

LLVM has no such vector functions: it calls the C library once for each lane, which costs more than all the rest of a
boat's dynamics. These give the same result for every lane, processor and vector width, within a few units in the last
place of the C library's (a test measures it). Limits:

    sin, cos   NaN beyond |x| = `LARGEST_ANGLE`
    exp        0 below -708, where the C library's becomes subnormal
    pow        a^b = exp(b log a): the last digits are lost as |b log a| grows
    sin, cos   of atan2(y, x): wrong where y^2 + x^2 is beyond 1e308 or below 1e-300

Sources: coefficients of sin, cos and log from fdlibm (Sun Microsystems, 1993), of atan from Cephes (Moshier, 1989);
exp is Taylor's series of degree 13 on |x| <= log(2) / 2, where the next term is below 5e-18.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import casadi as ca

from companion.jit.emit import bits_of
from companion.jit.operators import MAGIC, Bits, Lane

LARGEST_ANGLE = 1e6
"""Largest angle [rad] at which x - n pi / 2 is exact enough: n fits into 20 bits."""
_PI_2 = (1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624879595063154e-21)
"""pi / 2 in three parts (Cody-Waite); the first two have 33 bits, so that n times them is exact."""
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
"""1 / k! from k = 2."""
_ATAN_P = (
    -6.485021904942025371773e1, -1.228866684490136173410e2, -7.500855792314704667340e1, -1.615753718733365076637e1,
    -8.750608600031904122785e-1,
)  # fmt: skip
_ATAN_Q = (
    1.945506571482613964425e2, 4.853903996359136964868e2, 4.328810604912902668951e2, 1.650270098316988542046e2,
    2.485846490142306297962e1, 1.0,
)  # fmt: skip


def _series(z: Lane, coefficients: Sequence[float]) -> Lane | float:
    """c_0 + c_1 z + c_2 z^2 ..: even and odd powers apart (Estrin), which run in parallel; Horner at the end."""
    if len(coefficients) > 3:
        square = z * z
        even, odd = (_series(square, coefficients[k::2]) for k in (0, 1))
        return even + odd * z
    total: Lane | float = coefficients[-1]
    for c in reversed(coefficients[:-1]):
        total = c + total * z
    return total


def _reduced(x: Lane) -> tuple[Lane, Lane, Bits]:
    """sin and cos of y = x - n pi / 2, |y| <= pi / 4, NaN where |x| is too large; n in the lowest bits."""
    # 1. y = x - n pi / 2
    n, quarter = x.rounded(2 / math.pi)
    y = x
    for part in _PI_2:
        y = y - n * part
    y = x.call("fabs").test("ole", LARGEST_ANGLE).choose(y, math.nan)
    # 2. polynomials of fdlibm on |y| <= pi / 4
    z = y * y
    sine = y + y * z * _series(z, _SIN)
    half = z * 0.5
    near = 1.0 - half
    rest = (1.0 - near) - half
    return sine, near + (rest + z * z * _series(z, _COS)), quarter


def _quarter(even: Lane, odd: Lane, quarter: Bits) -> Lane:
    """`even`, `odd`, -`even`, -`odd` for n mod 4 = 0 .. 3."""
    is_odd = quarter.odd()
    sign = (quarter & 2) << 62
    return (is_odd.choose(odd, even).bits() ^ sign).double()


def _sin(x: Lane) -> Lane:
    sine, cosine, quarter = _reduced(x)
    return _quarter(sine, cosine, quarter)


def _cos(x: Lane) -> Lane:
    sine, cosine, quarter = _reduced(x)
    return _quarter(sine, cosine, quarter + 1)


def _exp(x: Lane) -> Lane:
    # exp(x) = 2^n exp(r), r = x - n log 2; 2^n by addition to the exponent bits
    n, whole = x.rounded(1 / math.log(2))
    r = x
    for part in _LN2:
        r = r - n * part
    power = whole << 52
    less_one = r + r * r * _series(r, _EXP)
    scaled = ((1.0 + less_one).bits() + power).double()
    low, high = x.test("olt", -708.0), x.test("ogt", 709.782712893384)
    value = low.choose(0.0, high.choose(math.inf, scaled))
    return x.test("uno", x).choose(x, value)


def _log(x: Lane) -> Lane:
    # 1. x = 2^n m, sqrt(1/2) <= m < sqrt(2), from the bits; subnormal x scaled by 2^54
    small = x.test("olt", 2.0**-1022)
    bits = small.choose(x * 2.0**54, x).bits()
    power = (bits - bits_of(math.sqrt(0.5))) >> 52
    mantissa = bits - (power << 52)
    n = (power + bits_of(MAGIC)).double() - MAGIC
    n = small.choose(n - 54.0, n)
    # 2. log(1 + f) = f - (f^2 / 2 - s (f^2 / 2 + R)), s = f / (2 + f)    (fdlibm)
    f = mantissa.double() - 1.0
    s = f / (f + 2.0)
    z = s * s
    R = z * _series(z, _LOG)
    half = f * f * 0.5
    inner = s * (half + R) + n * _LN2[1]
    near = n * _LN2[0] - ((half - inner) - f)
    # 3. special values
    value = x.test("oeq", math.inf).choose(x, near)
    value = x.test("oeq", 0.0).choose(-math.inf, value)
    return x.test("oge", 0.0).choose(value, math.nan)


def _pow(a: Lane, b: Lane) -> Lane:
    # |a|^b = exp(b log |a|); a < 0: sign by the parity of b, NaN unless b is an integer
    is_one = b.test("oeq", 0.0)
    if a.name in a.body.never_negative:
        return is_one.choose(1.0, _exp(b * _log(a)))
    size = _exp(b * _log(a.call("fabs")))
    whole = b.call("rint")
    half = b * 0.5
    of_whole = half.call("rint").test("une", half).choose(-size, size)
    negative = whole.test("oeq", b).choose(of_whole, math.nan)
    return is_one.choose(1.0, a.test("olt", 0.0).choose(negative, size))


def _atan2(y: Lane, x: Lane) -> Lane:
    # 1. t = min(|x|, |y|) / max(|x|, |y|), reduced to |t| <= 0.66 by atan t = pi / 4 + atan((t - 1) / (t + 1))
    wide, high = x.call("fabs"), y.call("fabs")
    steep = high.test("ogt", wide)
    large, less = steep.choose(high, wide), steep.choose(wide, high)
    t = less / large.test("oeq", 0.0).choose(1.0, large)
    beyond = t.test("ogt", 0.66)
    t = beyond.choose((t - 1.0) / (t + 1.0), t)
    # 2. atan t = t + t z P(z) / Q(z)    (Cephes)
    z = t * t
    bent = z * _series(z, _ATAN_P) / _series(z, _ATAN_Q)
    angle = t + t * bent
    # 3. octant and sign
    angle = angle + beyond.choose(math.pi / 4, 0.0)
    angle = steep.choose(math.pi / 2 - angle, angle)
    angle = x.bits().negative().choose(math.pi - angle, angle)
    return x.test("uno", y).choose(math.nan, angle).call("copysign", y)


def atan2_sine_cosine(y: Lane, x: Lane) -> tuple[Lane, Lane]:
    """Sine and cosine of atan2(y, x): y / r and x / r; 0 and 1 where r = 0."""
    r = (x * x + y * y).call("sqrt")
    zero = r.test("oeq", 0.0)
    one = 1.0 / zero.choose(1.0, r)
    return y * one, zero.choose(1.0, x * one)


def double_angle(sine: Lane, cosine: Lane) -> tuple[Lane, Lane]:
    """Sine and cosine of twice the angle."""
    product = sine * cosine
    squares = cosine * cosine - sine * sine
    return product + product, squares


OF_LANES: dict[int, Callable[..., Lane]] = {
    ca.OP_SIN: _sin, ca.OP_COS: _cos, ca.OP_EXP: _exp, ca.OP_LOG: _log, ca.OP_POW: _pow, ca.OP_CONSTPOW: _pow,
    ca.OP_ATAN2: _atan2,
}  # fmt: skip
"""Functions by CasADi's operation code."""
