"""Outlines to areas: the polygon that rings enclose under a fill rule."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from plotter.svg.path_segments import Bools, Floats

EMPTY: BaseGeometry = shapely.Polygon()


def area_of(rings: Sequence[Floats], rule: str) -> BaseGeometry:
    """What `rings` (each (n, 2), closed by implication) enclose under `nonzero` or `evenodd`."""
    closed = [_closed(ring) for ring in rings if len(ring) > 2]
    if not closed:
        return EMPTY
    if len(closed) == 1 and len(closed[0]) > 3:
        polygon = shapely.Polygon(closed[0])
        if polygon.is_valid:
            return polygon
    noded = shapely.unary_union(shapely.multilinestrings([shapely.linestrings(ring) for ring in closed if len(ring) > 1]))
    faces = list(shapely.get_parts(shapely.polygonize([noded])))
    if not faces:
        return EMPTY
    middle = shapely.get_coordinates(shapely.point_on_surface(faces))
    turns = sum((_winding(ring, middle) for ring in closed), np.zeros(len(faces), np.int64))
    inside = turns % 2 != 0 if rule == "evenodd" else turns != 0
    return shapely.union_all([face for face, good in zip(faces, inside.tolist(), strict=True) if good])


def _closed(ring: Floats) -> Floats:
    return ring if (ring[0] == ring[-1]).all() else np.concatenate((ring, ring[:1]))


def _winding(ring: Floats, points: Floats) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Winding number of a closed ring about each point, by signed crossings of the ray to the right."""
    a, b = ring[:-1], ring[1:]
    turns = np.zeros(len(points), np.int64)
    for i, (x, y) in enumerate(points):
        up: Bools = (a[:, 1] <= y) & (b[:, 1] > y)
        down: Bools = (a[:, 1] > y) & (b[:, 1] <= y)
        side = (b[:, 0] - a[:, 0]) * (y - a[:, 1]) - (x - a[:, 0]) * (b[:, 1] - a[:, 1])
        turns[i] = int((up & (side > 0)).sum()) - int((down & (side < 0)).sum())
    return turns
