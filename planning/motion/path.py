"""Stroke paths made ready for planning: many polylines side by side in flat arrays, judged smooth or sharp at each vertex.

All functions here work on a `PathSet`, so that a batch of short strokes costs as few numpy calls as one long stroke. Path
coordinate `s` (mm) is chord length along the polyline; paths follow each other on one axis with a gap between them, so one
`searchsorted` serves all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]

# A bend that turns more than this at one vertex is a corner, whatever its size.
SMOOTH_TURN_RAD = 0.7
# A vertex that the drawing itself calls smooth may turn this much before it is a corner all the same.
HINTED_SMOOTH_TURN_RAD = 1.1
# A smooth curve through the vertices may leave the polyline by this part of the tolerance.
SMOOTH_BULGE = 0.3
HINTED_SMOOTH_BULGE = 0.6
# Between the paths of a set, so that no search can find a neighbour.
GAP_MM = 16.0
THINNING_SLICE = 4096


@dataclass(frozen=True, eq=False, slots=True)
class PathSet:
    """Polylines in flat arrays: N vertices of B paths, N - 1 segments of which those joining two paths are void.

    `point_mm` (N, 2); `s_mm` (N,) increasing; `path` (N,) index of the path; `first`, `last` (B,) its vertices; `turn_rad`
    (N,) signed; `sharp` (N,) corners inside a path; `length_mm` (N - 1,); `tangent_in`, `tangent_out` (N - 1, 2) of the C1
    curve at both ends of each segment; `bulge_mm` (N - 1,) how far that curve leaves the segment; `curvature` (N,) per mm, 0
    at corners and ends.
    """

    point_mm: Array
    s_mm: Array
    path: Ints
    first: Ints
    last: Ints
    turn_rad: Array
    sharp: Mask
    length_mm: Array
    tangent_in: Array
    tangent_out: Array
    bulge_mm: Array
    curvature: Array

    def segment(self, s_mm: Array, path: Ints) -> Ints:
        """The segment of `path` that holds each s, clipped to the path's own."""
        found = np.searchsorted(self.s_mm, s_mm, side="right") - 1
        return np.clip(found, self.first[path], self.last[path] - 1)

    def curve(self, s_mm: Array, path: Ints) -> tuple[Array, Array]:
        """Point and unit tangent (each (m, 2)) of the C1 curve at s (cubic Hermite over each segment)."""
        i = self.segment(s_mm, path)
        length = self.length_mm[i][:, None]
        x = np.clip((s_mm - self.s_mm[i]) / self.length_mm[i], 0.0, 1.0)[:, None]
        chord = self.point_mm[i + 1] - self.point_mm[i]
        t_in, t_out = self.tangent_in[i] * length, self.tangent_out[i] * length
        # P = p0 + x t_in + x^2 (3 chord - 2 t_in - t_out) + x^3 (t_in + t_out - 2 chord)
        c2 = 3.0 * chord - 2.0 * t_in - t_out
        c3 = t_in + t_out - 2.0 * chord
        point = self.point_mm[i] + x * (t_in + x * (c2 + x * c3))
        slope = t_in + x * (2.0 * c2 + 3.0 * x * c3)
        norm = np.hypot(slope[:, 0], slope[:, 1])[:, None]
        unit = np.where(norm > 0.1 * length, slope / np.maximum(norm, 1e-300), chord / length)
        return point, unit

    def polyline(self, s_mm: Array) -> Array:
        """Points of the polylines themselves at s (m, 2)."""
        return np.stack(
            [np.interp(s_mm, self.s_mm, self.point_mm[:, 0]), np.interp(s_mm, self.s_mm, self.point_mm[:, 1])], axis=-1
        )


def thinning_mm(tolerance_mm: float) -> float:
    """How far the thinned polyline may leave the one given: too little for a pen to show, enough to drop dense vertices."""
    return float(np.clip(0.05 * tolerance_mm, 0.0002, 0.0025))


def thinned(points_mm: Array, within_mm: float) -> Ints:
    """Indices of the vertices worth planning: first, last, and those that keep the polyline `within_mm`, in order of travel.

    Douglas-Peucker, which looks at distance alone: where it would drop a path that runs back and forth along its chord, that
    stretch keeps all vertices that are further than `within_mm` apart. In slices, so that the cost stays linear.
    """
    n = len(points_mm)
    if n < 3:
        return np.arange(n)
    parts = []
    for start in range(0, n - 1, THINNING_SLICE):
        index = np.arange(start, min(n, start + THINNING_SLICE + 1))
        # The index rides along as the third coordinate, which Douglas-Peucker does not look at.
        line = shapely.linestrings(np.column_stack((points_mm[index], index)))
        thin = shapely.simplify(line, within_mm, preserve_topology=False)
        parts.append(np.rint(shapely.get_coordinates(thin, include_z=True)[:, 2]).astype(np.int64))
    kept = np.unique(np.concatenate(parts))
    folded = _folded(points_mm, kept, within_mm)
    if folded.any():
        along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(points_mm, axis=0).T))))
        segment = np.clip(np.searchsorted(kept, np.arange(n), side="right") - 1, 0, len(kept) - 2)
        moved = np.concatenate(([True], np.diff(np.floor(along / within_mm)) > 0.0))
        kept = np.union1d(kept, np.flatnonzero(folded[segment] & moved))
    return _without_equal_neighbours(points_mm, kept)


def _folded(points_mm: Array, kept: Ints, within_mm: float) -> Mask:
    """Which kept segments stand for vertices that go back along them by more than `within_mm`."""
    if len(kept) == len(points_mm):
        return np.zeros(len(kept) - 1, dtype=np.bool_)
    segment = np.clip(np.searchsorted(kept, np.arange(len(points_mm)), side="right") - 1, 0, len(kept) - 2)
    start, chord = points_mm[kept[:-1]][segment], np.diff(points_mm[kept], axis=0)[segment]
    length = np.hypot(chord[:, 0], chord[:, 1])
    offset = points_mm - start
    along = (offset * chord).sum(axis=1) / np.maximum(length, 1e-12)
    # One running maximum for all segments: each is lifted above whatever the ones before it can reach.
    lift = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(points_mm[kept], axis=0).T) + 4.0 * within_mm)))[segment]
    back = np.maximum.accumulate(along + lift) - (along + lift)
    out = np.zeros(len(kept) - 1, dtype=np.bool_)
    out[segment[(back > within_mm) & (length > 0.0)]] = True
    return out


def _without_equal_neighbours(points_mm: Array, kept: Ints) -> Ints:
    while len(kept) > 1:
        same = np.flatnonzero((np.diff(points_mm[kept], axis=0) == 0.0).all(axis=1))
        if not len(same):
            break
        # Of two equal neighbours the first goes, but never the stroke's own first vertex.
        kept = np.delete(kept, np.where(same == 0, 1, same))
    return kept


def path_set(points: Sequence[Array], corners: Sequence[Mask | None], tolerance_mm: float) -> PathSet:
    """Lay the polylines (each (n, 2), n >= 2, no two neighbours equal) side by side and judge their vertices. O(vertices)."""
    counts = np.array([len(p) for p in points], dtype=np.int64)
    last = np.cumsum(counts) - 1
    first = last - counts + 1
    point = np.concatenate(points)
    path = np.repeat(np.arange(len(points)), counts)
    chord = np.diff(point, axis=0)
    length = np.hypot(chord[:, 0], chord[:, 1])
    void = np.zeros(len(length), dtype=np.bool_)
    void[last[:-1]] = True
    length[void] = GAP_MM
    s = np.concatenate(([0.0], np.cumsum(length)))
    unit = chord / length[:, None]

    end = np.zeros(len(point), dtype=np.bool_)
    end[first] = end[last] = True
    turn = np.zeros(len(point))
    a, b = unit[:-1], unit[1:]
    turn[1:-1] = np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], (a * b).sum(axis=1))
    turn[end] = 0.0
    before, after = np.ones(len(point)), np.ones(len(point))
    before[1:], after[:-1] = length, length
    bulge = np.abs(turn) * before * after / (8.0 * (before + after))
    hint = np.concatenate([np.zeros(len(p), dtype=np.int8) if c is None else np.where(c, 1, -1).astype(np.int8)
                           for p, c in zip(points, corners, strict=True)])  # fmt: skip
    smooth = (np.abs(turn) < SMOOTH_TURN_RAD) & (bulge < SMOOTH_BULGE * tolerance_mm)
    smooth |= (hint < 0) & (np.abs(turn) < HINTED_SMOOTH_TURN_RAD) & (bulge < HINTED_SMOOTH_BULGE * tolerance_mm)
    sharp = ~smooth & ~end

    # The longer neighbour leads, so that a straight leg stays straight next to a short one.
    share = (before / (before + after))[:, None]
    mean = np.zeros_like(point)
    mean[1:-1] = unit[:-1] * share[1:-1] + unit[1:] * (1.0 - share[1:-1])
    norm = np.hypot(mean[:, 0], mean[:, 1])
    use = smooth & ~end & (norm > 1e-3)
    mean[use] /= norm[use][:, None]
    tangent_in = np.where(use[:-1, None], mean[:-1], unit)
    tangent_out = np.where(use[1:, None], mean[1:], unit)
    cross_in = np.abs(unit[:, 0] * tangent_in[:, 1] - unit[:, 1] * tangent_in[:, 0])
    cross_out = np.abs(unit[:, 0] * tangent_out[:, 1] - unit[:, 1] * tangent_out[:, 0])
    curvature = np.where(sharp | end, 0.0, 2.0 * np.abs(turn) / (before + after))
    return PathSet(point, s, path, first, last, turn, sharp, length, tangent_in, tangent_out,
                   length * (cross_in + cross_out) / 8.0, curvature)  # fmt: skip
