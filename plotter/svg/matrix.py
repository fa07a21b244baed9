"""Affine maps as SVG writes them: (a, b, c, d, e, f) sends (x, y) to (a x + c y + e, b x + d y + f)."""

from __future__ import annotations

import math
import re

Matrix = tuple[float, float, float, float, float, float]

IDENTITY: Matrix = (1.0, 0.0, 0.0, 1.0, 0.0, 0.0)

_FUNCTION = re.compile(r"[\s,]*([a-zA-Z]+[XYZ]?)\s*\(([^()]*)\)")
_ARGUMENT = re.compile(r"[\s,]*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([a-zA-Z%]*)")
_ANGLE_DEG = {"": 1.0, "deg": 1.0, "rad": 180 / math.pi, "grad": 0.9, "turn": 360.0}
_LENGTH_PX = {"": 1.0, "px": 1.0, "in": 96.0, "cm": 96 / 2.54, "mm": 96 / 25.4, "q": 96 / 101.6, "pt": 96 / 72, "pc": 16.0}


def multiply(m: Matrix, n: Matrix) -> Matrix:
    """m after n: the map of a child's coordinates through n, then m."""
    a, b, c, d, e, f = m
    p, q, r, s, t, u = n
    return (a * p + c * q, b * p + d * q, a * r + c * s, b * r + d * s, a * t + c * u + e, b * t + d * u + f)


def translation(x: float, y: float) -> Matrix:
    return (1.0, 0.0, 0.0, 1.0, x, y)


def determinant(m: Matrix) -> float:
    return m[0] * m[3] - m[1] * m[2]


def is_singular(m: Matrix) -> bool:
    """Whether the map flattens everything on a line or a point (to double precision)."""
    size = m[0] * m[0] + m[1] * m[1] + m[2] * m[2] + m[3] * m[3]
    return abs(determinant(m)) <= 1e-14 * size or size == 0.0


def inverse(m: Matrix) -> Matrix:
    """The map back. Raises ZeroDivisionError for a singular one."""
    a, b, c, d, e, f = m
    k = 1.0 / determinant(m)
    return (d * k, -b * k, -c * k, a * k, (c * f - d * e) * k, (b * e - a * f) * k)


def apply(m: Matrix, x: float, y: float) -> tuple[float, float]:
    return (m[0] * x + m[2] * y + m[4], m[1] * x + m[3] * y + m[5])


def parse_transform(text: str) -> Matrix | None:
    """The product of a transform list, as attribute or CSS property; None where it breaks the grammar (SVG: then the
    whole list is ignored)."""
    if text.strip() in ("", "none"):
        return IDENTITY
    result = IDENTITY
    at = 0
    for match in _FUNCTION.finditer(text):
        if match.start() != at:
            return None
        step = _function(match[1].lower(), match[2])
        if step is None:
            return None
        result = multiply(result, step)
        at = match.end()
    return result if at and not text[at:].strip(" \t\r\n,") else None


def _arguments(text: str) -> list[tuple[float, str]] | None:
    found: list[tuple[float, str]] = []
    at = 0
    while text[at:].strip():
        match = _ARGUMENT.match(text, at)
        if match is None:
            return None
        found.append((float(match[1]), match[2].lower()))
        at = match.end()
    return found


def _function(name: str, text: str) -> Matrix | None:
    arguments = _arguments(text)
    if arguments is None or not arguments:
        return None
    turns = name.startswith(("rotate", "skew"))
    values = []
    for i, (value, unit) in enumerate(arguments):
        factor = (_ANGLE_DEG if turns and (i == 0 or name.startswith("skew")) else _LENGTH_PX).get(unit)
        if factor is None:
            return None
        values.append(value * factor)
    if not all(map(math.isfinite, values)):
        return None
    return _matrix(name, values)


def _matrix(name: str, v: list[float]) -> Matrix | None:
    """Angles in degrees, lengths in px."""
    n = len(v)
    if name == "matrix" and n == 6:
        return (v[0], v[1], v[2], v[3], v[4], v[5])
    if name == "translate" and n <= 2:
        return translation(v[0], v[1] if n == 2 else 0.0)
    if name == "translatex" and n == 1:
        return translation(v[0], 0.0)
    if name == "translatey" and n == 1:
        return translation(0.0, v[0])
    if name == "scale" and n <= 2:
        return (v[0], 0.0, 0.0, v[-1], 0.0, 0.0)
    if name == "scalex" and n == 1:
        return (v[0], 0.0, 0.0, 1.0, 0.0, 0.0)
    if name == "scaley" and n == 1:
        return (1.0, 0.0, 0.0, v[0], 0.0, 0.0)
    if name == "rotate" and n in (1, 3):
        return _rotation(v)
    if name == "skewx" and n == 1:
        return (1.0, 0.0, math.tan(math.radians(v[0])), 1.0, 0.0, 0.0)
    if name == "skewy" and n == 1:
        return (1.0, math.tan(math.radians(v[0])), 0.0, 1.0, 0.0, 0.0)
    if name == "skew" and n <= 2:
        return (1.0, math.tan(math.radians(v[1] if n == 2 else 0.0)), math.tan(math.radians(v[0])), 1.0, 0.0, 0.0)
    return None


def _rotation(v: list[float]) -> Matrix:
    quarter = v[0] / 90
    if quarter == int(quarter):
        # Quarter turns are exact, so that a rotated square stays one.
        cos, sin = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[int(quarter) % 4]
    else:
        cos, sin = math.cos(math.radians(v[0])), math.sin(math.radians(v[0]))
    turn = (cos, sin, -sin, cos, 0.0, 0.0)
    if len(v) == 1:
        return turn
    return multiply(multiply(translation(v[1], v[2]), turn), translation(-v[1], -v[2]))
