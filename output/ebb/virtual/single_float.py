"""Single-precision arithmetic as the board's compiler does it, for the rate of SM, XM, HM and TR.

Conversions and divisions round to nearest even, the division without its sticky bit when the last 24 bits of remainder are
exactly half; the multiplication drops the low partial products. Values are (mantissa, exponent): mantissa * 2^exponent, the
mantissa 24 bits wide with its top bit set, or (0, 0). Only values that are not negative occur.
"""

from __future__ import annotations

Single = tuple[int, int]

ZERO: Single = (0, 0)
_TOP = 1 << 23
_OVER = 1 << 24


def _rounded(value: int, exponent: int, drop: int) -> Single:
    """value * 2^exponent with its low `drop` bits rounded away, to nearest, ties to even."""
    if drop <= 0:
        return value << -drop, exponent + drop
    kept = value >> drop
    rest = value & ((1 << drop) - 1)
    half = 1 << (drop - 1)
    if rest > half or (rest == half and kept & 1):
        kept += 1
        if kept == _OVER:
            return _TOP, exponent + drop + 1
    return kept, exponent + drop


def from_int(value: int) -> Single:
    """An unsigned integer, rounded to 24 bits."""
    if value == 0:
        return ZERO
    return _rounded(value, 0, value.bit_length() - 24)


def divide(a: Single, b: Single) -> Single:
    """a / b; b is not zero."""
    if a[0] == 0:
        return ZERO
    shift = 24 if a[0] >= b[0] else 25
    quotient, remainder = divmod(a[0] << shift, b[0])
    # 25 bits: 24 to keep and a guard; what remains is the sticky bit, which the board loses at exactly half of 2^24.
    sticky = remainder not in (0, _TOP)
    value = (quotient << 1) | sticky
    return _rounded(value, a[1] - b[1] - shift - 1, 2)


def multiply(a: Single, b: Single) -> Single:
    """a * b from the upper partial products of the mantissas' bytes."""
    if a[0] == 0 or b[0] == 0:
        return ZERO
    a0, a1, a2 = a[0] >> 16, (a[0] >> 8) & 0xFF, a[0] & 0xFF
    b0, b1, b2 = b[0] >> 16, (b[0] >> 8) & 0xFF, b[0] & 0xFF
    p = (a0 * b0 << 16) + ((a0 * b1 + a1 * b0) << 8) + a0 * b2 + a1 * b1 + a2 * b0 + (a1 * b2 >> 8) + (a2 * b1 >> 8)
    # p has 31 or 32 bits: normalised to 32, the low 8 are rounded away.
    exponent = a[1] + b[1] + 16
    if p < 1 << 31:
        p <<= 1
        exponent -= 1
    return _rounded(p, exponent, 8)


def truncated(value: Single) -> int:
    """The integer part."""
    return value[0] << value[1] if value[1] >= 0 else value[0] >> -value[1]


def constant(value: float) -> Single:
    """A literal of the source, rounded to nearest even."""
    numerator, denominator = value.as_integer_ratio()
    shift = denominator.bit_length() - 1
    return _rounded(numerator, -shift, numerator.bit_length() - 24)


RATE_PER_STEP_PER_MS = constant(85899345.92)
RATE_PER_STEP_PER_S = constant(85899.34592)
