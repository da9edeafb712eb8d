"""Exponential, logarithm, sine and cosine that compiled float64 loops can do several of at once.

The system's mathematical library is called once per number, and may differ in the last bit from one system to another.
These are plain arithmetic without branches: LLVM turns a loop over them into SIMD code of any width, and each number
comes out the same to the bit, whatever the width.

All are Taylor series after a reduction of the argument by a constant in parts (Cody and Waite 1980), the first of which
have so few digits that products with whole numbers are exact. Terms are summed in pairs (Estrin 1960), which makes the
chain of operations shorter.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numba
import numpy as np

# Adding it moves a number's integer part, rounded, into the last bits of the sum.
_TO_INTEGER: Final = 1.5 * 2.0**52
_TWO_52: Final = 2.0**52
_TWO_52_BITS: Final = int(np.float64(_TWO_52).view(np.int64))
_ROOT_HALF_BITS: Final = int(np.float64(math.sqrt(0.5)).view(np.int64))
_ONE_EXPONENT: Final = 1023

# ln 2 and pi / 2 in parts of 33 binary digits, the last part as far as it goes.
_PER_LN_2: Final = 1.0 / math.log(2.0)
_LN_2_HIGH, _LN_2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
_PER_RIGHT_ANGLE: Final = 2.0 / math.pi
_RIGHT_HIGH, _RIGHT_MIDDLE, _RIGHT_LOW = 1.57079632673412561417, 6.07710050630396597660e-11, 2.02226624879595063154e-21

_E2, _E3, _E4, _E5, _E6, _E7, _E8, _E9, _E10, _E11, _E12 = (1.0 / math.factorial(k) for k in range(2, 13))
_S3, _S5, _S7, _S9, _S11, _S13, _S15 = ((-1.0) ** (k // 2) / math.factorial(k) for k in range(3, 16, 2))
_C4, _C6, _C8, _C10, _C12, _C14, _C16 = ((-1.0) ** (k // 2) / math.factorial(k) for k in range(4, 17, 2))
_L3, _L5, _L7, _L9, _L11, _L13, _L15, _L17, _L19 = (2.0 / k for k in range(3, 20, 2))

inlined = numba.njit(cache=True, error_model="numpy", nogil=True, forceinline=True)
"""As ``rod.jit``, for parts of loops: inlined whatever their size, since a loop that calls is not turned into SIMD."""


@inlined
def fast_exp(x: Any) -> Any:
    """exp(x) within 4e-16 of itself; outside -708 to 709 that of the nearer end."""
    x = min(max(x, -708.0), 709.0)
    shifted = x * _PER_LN_2 + _TO_INTEGER
    twos = shifted - _TO_INTEGER
    r = (x - twos * _LN_2_HIGH) - twos * _LN_2_LOW
    r2 = r * r
    r4 = r2 * r2
    low = (_E2 + r * _E3) + r2 * (_E4 + r * _E5)
    middle = (_E6 + r * _E7) + r2 * (_E8 + r * _E9)
    high = (_E10 + r * _E11) + r2 * _E12
    power = np.int64((np.float64(shifted).view(np.int64) + _ONE_EXPONENT) << 52).view(np.float64)
    return (1.0 + (r + r2 * (low + r4 * (middle + r4 * high)))) * power


@inlined
def fast_log1p(x: Any) -> Any:
    """log(1 + x) for x >= 0, within 4e-16 of itself."""
    whole = 1.0 + x
    lost = x - (whole - 1.0)
    bits = np.float64(whole).view(np.int64)
    twos = (bits - _ROOT_HALF_BITS) >> 52
    part = np.int64(bits - (twos << 52)).view(np.float64)
    f = (part - 1.0) + lost * np.int64((_ONE_EXPONENT - twos) << 52).view(np.float64)
    # log(1 + f) = 2 artanh z
    z = f / (2.0 + f)
    z2 = z * z
    z4 = z2 * z2
    z8 = z4 * z4
    low = (_L3 + z2 * _L5) + z4 * (_L7 + z2 * _L9)
    high = (_L11 + z2 * _L13) + z4 * (_L15 + z2 * _L17)
    count = np.int64(twos + _TWO_52_BITS).view(np.float64) - _TWO_52
    return count * _LN_2_HIGH + (2.0 * z + (z * z2 * (low + z8 * (high + z8 * _L19)) + count * _LN_2_LOW))


@inlined
def fast_sincos(x: Any) -> Any:
    """Sine and cosine of an angle up to 1e5 rad, each within 4e-16 of itself."""
    shifted = x * _PER_RIGHT_ANGLE + _TO_INTEGER
    turns = shifted - _TO_INTEGER
    r = ((x - turns * _RIGHT_HIGH) - turns * _RIGHT_MIDDLE) - turns * _RIGHT_LOW
    r2 = r * r
    r4 = r2 * r2
    r8 = r4 * r4
    s = ((_S3 + r2 * _S5) + r4 * (_S7 + r2 * _S9)) + r8 * ((_S11 + r2 * _S13) + r4 * _S15)
    c = ((_C4 + r2 * _C6) + r4 * (_C8 + r2 * _C10)) + r8 * ((_C12 + r2 * _C14) + r4 * _C16)
    s = r + (r * r2) * s
    c = 1.0 - (0.5 * r2 - r4 * c)
    quadrant = np.float64(shifted).view(np.int64)
    sin, cos = (c, s) if quadrant & 1 else (s, c)
    # the sign bit, from the quadrant's second bit
    sin_bits = np.float64(sin).view(np.int64) ^ ((quadrant & 2) << 62)
    cos_bits = np.float64(cos).view(np.int64) ^ (((quadrant + 1) & 2) << 62)
    return np.int64(sin_bits).view(np.float64), np.int64(cos_bits).view(np.float64)
