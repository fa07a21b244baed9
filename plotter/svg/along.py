"""A path as something to walk along: position and direction by distance, for text on a path."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from plotter.svg.matrix import IDENTITY, Matrix
from plotter.svg.path_segments import ARC, LINE, QUADRATIC, Floats, resolve
from plotter.svg.path_tokens import parse_paths

_FLAT = 0.5
_DEEPEST = 12
_DENSE = 16
_ARC_STEPS = 257


@dataclass(frozen=True, eq=False, slots=True)
class Track:
    """Points of a path in user units and the distance at each. Gaps between subpaths count as no distance."""

    points: Floats
    distance: Floats

    @property
    def length(self) -> float:
        return float(self.distance[-1])

    def at(self, distance: float) -> tuple[float, float, float] | None:
        """x, y and direction (radians) at a distance; None beyond either end."""
        if not 0 <= distance <= self.length:
            return None
        i = min(max(int(np.searchsorted(self.distance, distance, "right")), 1), len(self.distance) - 1)
        while i > 1 and self.distance[i] == self.distance[i - 1]:
            i -= 1
        (x0, y0), (x1, y1) = self.points[i - 1].tolist(), self.points[i].tolist()
        span = float(self.distance[i] - self.distance[i - 1])
        share = (distance - float(self.distance[i - 1])) / span if span else 0.0
        return x0 + share * (x1 - x0), y0 + share * (y1 - y0), math.atan2(y1 - y0, x1 - x0)


def track_of(data: str, matrix: Matrix = IDENTITY) -> Track | None:
    """The track along path data, or None where it is empty or not finite.

    Distance along Bezier curves is measured as browsers do, by chords of pieces that are flat within half a unit, and runs
    evenly with the parameter inside a piece: text then stands where its author saw it.
    """
    commands, _ = parse_paths([data])
    if not len(commands.code) or not np.isfinite(commands.numbers).all():
        return None
    segments = resolve(commands)
    points: list[Floats] = []
    steps: list[Floats] = []
    arc = 0
    previous = -1
    for i, kind in enumerate(segments.kind.tolist()):
        p = segments.points[i]
        if kind == ARC:
            theta = segments.angle[arc] + segments.sweep[arc] * np.linspace(0.0, 1.0, _ARC_STEPS)
            u, v = segments.axis_u[arc], segments.axis_v[arc]
            dense = segments.centre[arc] + np.cos(theta)[:, None] * u + np.sin(theta)[:, None] * v
            length = np.hypot(*np.diff(dense, axis=0).T)
            arc += 1
        elif kind == LINE:
            dense = p[[0, 3]]
            length = np.hypot(*np.diff(dense, axis=0).T)
        else:
            dense, length = _bezier(_controls(p, kind))
        joined = segments.subpath[i] == previous
        points.append(dense[1:] if joined else dense)
        steps.append(length if joined else np.append(0.0, length))
        previous = segments.subpath[i]
    if not points:
        return None
    every = np.concatenate(points)
    a, b, c, d, e, f = matrix
    mapped = np.stack((a * every[:, 0] + c * every[:, 1] + e, b * every[:, 0] + d * every[:, 1] + f), axis=1)
    # The element's own transform is taken to scale evenly.
    return Track(mapped, np.cumsum(np.concatenate(steps)) * math.sqrt(abs(a * d - b * c)))


def _controls(p: Floats, kind: int) -> Floats:
    """Cubic controls (4, 2); a quadratic is raised."""
    if kind == QUADRATIC:
        return np.stack((p[0], (p[0] + 2 * p[1]) / 3, (p[3] + 2 * p[1]) / 3, p[3]))
    return p


def _bezier(p: Floats) -> tuple[Floats, Floats]:
    """Dense points of a cubic, and the measured distance of each step between them."""
    cuts = [0.0, *_flat_pieces(p, 0.0, 1.0, 0)]
    t = np.concatenate([[0.0], *(np.linspace(a, b, _DENSE + 1)[1:] for a, b in pairwise(cuts))])
    chord = np.hypot(*np.diff(_at(p, np.array(cuts)), axis=0).T)
    return _at(p, t), np.repeat(chord / _DENSE, _DENSE)


def _flat_pieces(p: Floats, begin: float, end: float, depth: int) -> list[float]:
    """Parameters where the pieces end: a piece is flat where its controls lie near the thirds of its chord."""
    near = np.abs(np.stack((p[1] - (2 * p[0] + p[3]) / 3, p[2] - (p[0] + 2 * p[3]) / 3))).max()
    if near <= _FLAT or depth >= _DEEPEST:
        return [end]
    middle = (begin + end) / 2
    ab, bc, cd = (p[0] + p[1]) / 2, (p[1] + p[2]) / 2, (p[2] + p[3]) / 2
    abc, bcd = (ab + bc) / 2, (bc + cd) / 2
    centre = (abc + bcd) / 2
    return [
        *_flat_pieces(np.stack((p[0], ab, abc, centre)), begin, middle, depth + 1),
        *_flat_pieces(np.stack((centre, bcd, cd, p[3])), middle, end, depth + 1),
    ]


def _at(p: Floats, t: Floats) -> Floats:
    s = 1 - t[:, None]
    r = t[:, None]
    return np.asarray(s**3 * p[0] + 3 * s**2 * r * p[1] + 3 * s * r**2 * p[2] + r**3 * p[3])
