"""stroke-dasharray and stroke-dashoffset of a style, in user units (SVG 2, 13.5.6)."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from plotter.svg.lengths import Frame, parse_length
from plotter.svg.matrix import Matrix
from plotter.svg.path_segments import Floats
from plotter.svg.style import Style

_SEPARATOR = re.compile(r"[\s,]+")


@dataclass(frozen=True, slots=True)
class Dashes:
    """Dashes and gaps (an even number of them), where the pattern begins, and the author's path length or None."""

    pattern: tuple[float, ...]
    offset: float
    path_length: float | None


def dashes_of(style: Style, frame: Frame, path_length: str | None) -> Dashes | None:
    """None where the stroke is solid: none given, a negative or wrong value, or all zero. Raises NotFinite."""
    text = style.inherited.get("stroke-dasharray", "none")
    if text == "none" or style.stroke is None:
        return None
    lengths = [parse_length(part, frame, frame.diagonal) for part in _SEPARATOR.split(text.strip()) if part]
    pattern = [length for length in lengths if length is not None]
    if len(pattern) != len(lengths) or min(pattern, default=-1.0) < 0 or sum(pattern) <= 0:
        return None
    if len(pattern) % 2:
        pattern *= 2
    offset = parse_length(style.inherited.get("stroke-dashoffset"), frame, frame.diagonal) or 0.0
    author = parse_length(path_length, frame)
    return Dashes(tuple(pattern), offset, author if author is not None and author > 0 else None)


def user_lengths(points_mm: Floats, matrix: Matrix) -> Floats:
    """Length along a polyline at each of its points, in the user units that `matrix` maps to millimetres."""
    a, b, c, d, _, _ = matrix
    k = 1.0 / (a * d - b * c)
    step = np.diff(points_mm, axis=0)
    user = np.hypot((d * step[:, 0] - c * step[:, 1]) * k, (a * step[:, 1] - b * step[:, 0]) * k)
    return np.concatenate(([0.0], np.cumsum(user)))
