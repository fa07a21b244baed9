"""Very many ellipses to polylines, all those of as many points at once: of one circle's points only place and size differ.

The same polylines, but for rounding, as `flatten` makes of an ellipse's four arcs: as many steps to each quarter, begun on the
right and going on downwards, closed, with no corner but the ends.
"""

from __future__ import annotations

import numpy as np

from plotter.svg.flatten import FARTHEST_MM, NOTHING_MM, Polylines, arc_steps, longest_half_axis
from plotter.svg.path_segments import Bools, Floats, Ints

_QUARTER = np.pi / 2


def usual(ellipses: Floats, matrix: Floats) -> Bools:
    """Which of `ellipses`, rows of centre and radii (n, 4), are of a size that somebody draws; `flatten` judges the others.

    `matrix` (n, 6) maps the units of each to page millimetres.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        centre, u, v = _mapped(ellipses, matrix)
        size = np.minimum(np.abs(u).max(axis=1), np.abs(v).max(axis=1))
        far = np.abs(centre).max(axis=1) + np.abs(u).max(axis=1) + np.abs(v).max(axis=1)
        return np.asarray((size > 2 * NOTHING_MM) & (far < FARTHEST_MM / 2))


def point_counts(ellipses: Floats, matrix: Floats, tolerance_mm: Floats) -> Ints:
    """How many points each polyline has, (n,); for `tolerance_mm` (n,)."""
    _, u, v = _mapped(ellipses, matrix)
    return 4 * arc_steps(np.full(len(ellipses), _QUARTER), longest_half_axis(u, v), tolerance_mm) + 1


def flatten_ellipses(ellipses: Floats, matrix: Floats, tolerance_mm: Floats) -> Polylines:
    """A polyline for each of the `usual` ones; `path` counts them."""
    centre, u, v = _mapped(ellipses, matrix)
    size = point_counts(ellipses, matrix, tolerance_mm)
    offset = np.concatenate(([0], np.cumsum(size)))
    points = np.empty((offset[-1], 2))
    for count in np.unique(size).tolist():
        rows = np.flatnonzero(size == count)
        cos, sin = _round(count)
        at = offset[rows][:, None] + np.arange(count)
        for axis in (0, 1):
            points[at, axis] = centre[rows, axis, None] + u[rows, axis, None] * cos + v[rows, axis, None] * sin
    corner = np.zeros(len(points), bool)
    corner[offset[:-1]] = corner[offset[1:] - 1] = True
    every = len(ellipses)
    return Polylines(points, corner, offset, np.arange(every), np.ones(every, bool), np.zeros(every, bool))


def _round(count: int) -> tuple[Floats, Floats]:
    """Cosines and sines of the points of an ellipse of so many, exact at its quarters and the same at both ends."""
    turn = np.linspace(0.0, 4 * _QUARTER, count)
    cos, sin = np.cos(turn), np.sin(turn)
    quarter = (count - 1) // 4
    cos[::quarter], sin[::quarter] = (1.0, 0.0, -1.0, 0.0, 1.0), (0.0, 1.0, 0.0, -1.0, 0.0)
    return cos, sin


def _mapped(ellipses: Floats, matrix: Floats) -> tuple[Floats, Floats, Floats]:
    """Centres and both half axes in page millimetres, each (n, 2)."""
    x, y, rx, ry = ellipses.T
    a, b, c, d, e, f = matrix.T
    centre = np.stack((a * x + c * y + e, b * x + d * y + f), axis=1)
    return centre, np.stack((a * rx, b * rx), axis=1), np.stack((c * ry, d * ry), axis=1)
