"""Where markers stand on an outline, and how they are turned (SVG 2, 11.6 and 13.8)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from plotter.svg.flatten import tangents
from plotter.svg.path_segments import Floats, Segments


@dataclass(frozen=True, slots=True)
class Vertex:
    """A vertex in user units, and the direction of the path through it, in radians."""

    x: float
    y: float
    angle: float


def vertices(segments: Segments) -> list[Vertex]:
    """The vertices of one path, its closing lines included, in order."""
    arriving, leaving = tangents(segments)
    found: list[Vertex] = []
    for k in range(len(segments.start)):
        rows = np.flatnonzero(segments.subpath == k)
        first = segments.start[k]
        if not len(rows):
            found.append(Vertex(float(first[0]), float(first[1]), 0.0))
            continue
        into, out = _settled(arriving[rows], backwards=False), _settled(leaving[rows], backwards=True)
        closed = bool(segments.closed[k])
        found.append(Vertex(float(first[0]), float(first[1]), _angle(into[-1] if closed else None, out[0])))
        for i, row in enumerate(rows.tolist()):
            x, y = segments.points[row, 3].tolist()
            onward = out[i + 1] if i + 1 < len(rows) else out[0] if closed else None
            found.append(Vertex(x, y, _angle(into[i], onward)))
    return found


def _settled(direction: Floats, *, backwards: bool) -> Floats:
    """Directions of segments without length taken from the neighbour: the one before, or the one after."""
    direction = direction.copy()
    order = range(len(direction) - 2, -1, -1) if backwards else range(1, len(direction))
    for i in order:
        if not direction[i].any():
            direction[i] = direction[i + 1 if backwards else i - 1]
    return direction


def _angle(before: Floats | None, after: Floats | None) -> float:
    """Direction at a vertex: halfway between arriving and leaving."""
    known = [one / math.hypot(*one) for one in (before, after) if one is not None and one.any()]
    if not known:
        return 0.0
    x, y = np.sum(known, axis=0).tolist()
    if len(known) == 2 and math.hypot(x, y) < 1e-12:
        x, y = -known[0][1], known[0][0]
    return math.atan2(y, x)
