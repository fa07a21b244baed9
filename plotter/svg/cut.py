"""Cutting polylines: by regions (what lies inside, or outside), and into dashes. Order, direction and corner marks stay.

A cut adds points only where a boundary is crossed; it never adds the boundary itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from plotter.svg.path_segments import Bools, Floats, Ints

# Nearer than this a point counts as lying on a boundary: far above rounding, far below a pen.
ON_BOUNDARY_MM = 1e-6


@dataclass(frozen=True, eq=False, slots=True)
class Piece:
    """A polyline `points` (n, 2) mm with `corner` marks (n,); a single point is a dot."""

    points: Floats
    corner: Bools


class Region:
    """A polygonal area in page millimetres, made ready for cutting many polylines."""

    def __init__(self, area: shapely.Geometry) -> None:
        self.area = area
        self.box: tuple[float, float, float, float] = shapely.bounds(area).tolist()
        self._edges: NDArray[np.object_] | None = None
        self._tree: shapely.STRtree | None = None
        self._ends: Floats = np.zeros((0, 2, 2))
        shapely.prepare(area)

    def _ready(self) -> shapely.STRtree:
        if self._tree is None:
            ends = [np.zeros((0, 2, 2))]
            for ring in shapely.get_rings(shapely.get_parts(self.area)):
                at = shapely.get_coordinates(ring)
                ends.append(np.stack((at[:-1], at[1:]), axis=1))
            self._ends = np.concatenate(ends)
            self._tree = shapely.STRtree(shapely.linestrings(self._ends) if len(self._ends) else [])
        return self._tree

    def holds(self, points: Floats, *, boundary: bool) -> Bools:
        """Which of `points` (n, 2) lie inside; what lies on the boundary counts as `boundary` says."""
        inside = shapely.contains_xy(self.area, points[:, 0], points[:, 1])
        unsure = np.flatnonzero(~inside if boundary else inside)
        if len(unsure) and len(self._ready().geometries):
            near = shapely.points(points[unsure])
            edge = self._ready().query(near, predicate="dwithin", distance=ON_BOUNDARY_MM)[0]
            inside[unsure[edge]] = boundary
        return np.asarray(inside)

    def misses(self, points: Floats) -> bool:
        """Whether the bounding boxes show that the region and the polyline have nothing in common."""
        low, high = points.min(axis=0), points.max(axis=0)
        left, top, right, bottom = self.box
        return not (low[0] <= right and high[0] >= left and low[1] <= bottom and high[1] >= top)

    def crossings(self, points: Floats) -> tuple[Ints, Floats]:
        """Segments of the polyline that meet the boundary, and where on them (0 to 1); also where an edge along them ends."""
        tree = self._ready()
        low, high = np.minimum(points[:-1], points[1:]), np.maximum(points[:-1], points[1:])
        # As wide as `holds` sees: a segment beside an edge, as near as that, is cut where the edge ends.
        reach = shapely.box(*(low - ON_BOUNDARY_MM).T, *(high + ON_BOUNDARY_MM).T)
        segment, edge = tree.query(reach)
        return meetings(points, segment, self._ends[edge])


def meetings(points: Floats, segment: Ints, edges: Floats) -> tuple[Ints, Floats]:
    """Where segments of a polyline meet edges, pair by pair: `segment` (m,) and `edges` (m, 2, 2). Gives the segments and the
    place on them, 0 to 1; for an edge along a segment the places of the edge's ends."""
    p, d = points[segment], points[segment + 1] - points[segment]
    q = edges[:, 0]
    e = edges[:, 1] - q
    across = d[:, 0] * e[:, 1] - d[:, 1] * e[:, 0]
    size = np.hypot(d[:, 0], d[:, 1]) * np.hypot(e[:, 0], e[:, 1])
    gap = q - p
    crossed = np.abs(across) > 1e-12 * size
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (gap[:, 0] * e[:, 1] - gap[:, 1] * e[:, 0]) / across
        s = (gap[:, 0] * d[:, 1] - gap[:, 1] * d[:, 0]) / across
    slack = 1e-9
    good = crossed & (s >= -slack) & (s <= 1 + slack) & (t > 0) & (t < 1)
    along_segment, along_t = [segment[good]], [t[good]]
    flat = np.flatnonzero(~crossed & (size > 0))
    for end in (0, 1) if len(flat) else ():
        offset = edges[flat, end] - p[flat]
        t_end = (offset * d[flat]).sum(axis=1) / (d[flat] ** 2).sum(axis=1)
        on = (t_end > 0) & (t_end < 1)
        along_segment.append(segment[flat[on]])
        along_t.append(t_end[on])
    return np.concatenate(along_segment), np.concatenate(along_t)


def cut(piece: Piece, region: Region, *, inside: bool, boundary: bool) -> list[Piece]:
    """The parts of `piece` inside (or outside) `region`; `boundary` says whether what runs along its boundary is kept."""
    points = piece.points
    if region.misses(points):
        return [] if inside else [piece]
    # What counts as inside: for a part to be kept along the boundary the boundary is in when inside is kept, else out.
    boundary_in = boundary if inside else not boundary
    if len(points) == 1:
        return [piece] if bool(region.holds(points, boundary=boundary_in)[0]) == inside else []
    segment, t = region.crossings(points)
    # Without a crossing inside a segment a vertex may still lie on the boundary, so every part is asked.
    split, corner = divide(piece, segment, t) if len(segment) else (points, piece.corner)
    keep = region.holds((split[:-1] + split[1:]) / 2, boundary=boundary_in) == inside
    return runs(split, corner, keep)


def divide(piece: Piece, segment: Ints, t: Floats) -> tuple[Floats, Bools]:
    """The polyline with the crossings as points of their own, not marked as corners."""
    points = piece.points
    order = np.lexsort((t, segment))
    segment, t = segment[order], t[order]
    new = points[segment] + t[:, None] * (points[segment + 1] - points[segment])
    split = np.insert(points, segment + 1, new, axis=0)
    corner = np.insert(piece.corner, segment + 1, False)
    apart = np.append(True, np.abs(np.diff(split, axis=0)).max(axis=1) > ON_BOUNDARY_MM / 10)
    apart[-1] = True
    original = np.insert(np.ones(len(points), bool), segment + 1, False)
    # Of points that coincide the polyline's own are kept, so that nothing moves.
    apart |= original
    return split[apart], corner[apart]


def runs(points: Floats, corner: Bools, keep: Bools) -> list[Piece]:
    """Stretches of kept segments; a closed polyline whose seam is kept is not cut there."""
    if keep.all():
        return [Piece(points, corner)]
    edge = np.diff(np.concatenate(([False], keep, [False])).astype(np.int8))
    begins, ends = np.flatnonzero(edge == 1), np.flatnonzero(edge == -1)
    pieces = [_piece(points[a : b + 1], corner[a : b + 1]) for a, b in zip(begins, ends, strict=True)]
    if len(pieces) > 1 and keep[0] and keep[-1] and (points[0] == points[-1]).all():
        tail, head = pieces.pop(), pieces[0]
        joint = np.concatenate((tail.corner[:-1], head.corner))
        joint[len(tail.corner) - 1] = True
        pieces[0] = _piece(np.concatenate((tail.points[:-1], head.points)), joint)
    return [piece for piece in pieces if np.abs(piece.points - piece.points[0]).max() > ON_BOUNDARY_MM]


def _piece(points: Floats, corner: Bools) -> Piece:
    corner = corner.copy()
    corner[0] = corner[-1] = True
    return Piece(points, corner)


def dash(piece: Piece, position: Floats, pattern: Floats, offset: float, *, dots: bool) -> list[Piece]:
    """The dashes of `piece`. `position` (n,) is the length along it at each point, `pattern` (even length) dashes and gaps in
    the same unit, `offset` where in the pattern the piece begins. Dashes without length become dots where `dots`."""
    total = float(position[-1])
    begin, end = _intervals(total, pattern, offset)
    if not dots:
        lasting = end > begin
        begin, end = begin[lasting], end[lasting]
    # A flattened curve may repeat a point's position only where it stands still, so the position rises and can be inverted.
    first = np.searchsorted(position, begin, "right")
    last = np.searchsorted(position, end, "left")
    ends = np.stack([np.interp(np.concatenate((begin, end)), position, piece.points[:, axis]) for axis in (0, 1)], axis=1)
    inner = np.maximum(last - first, 0)
    is_dot = end <= begin
    inner[is_dot] = 0
    count = np.where(is_dot, 1, inner + 2)
    stop = np.cumsum(count)
    start = stop - count
    points, corner = np.empty((int(count.sum()), 2)), np.ones(int(count.sum()), bool)
    points[stop - 1] = ends[len(begin) :]
    points[start] = ends[: len(begin)]
    row = np.repeat(np.arange(len(begin)), inner)
    step = np.arange(len(row)) - np.repeat(np.cumsum(inner) - inner, inner)
    points[start[row] + 1 + step] = piece.points[first[row] + step]
    corner[start[row] + 1 + step] = piece.corner[first[row] + step]
    return [Piece(points[a:b], corner[a:b]) for a, b in zip(start.tolist(), stop.tolist(), strict=True)]


def dash_count(total: float, pattern: Floats) -> float:
    """About how many dashes a length takes."""
    return total / float(pattern.sum()) * (len(pattern) / 2) + 1


def _intervals(total: float, pattern: Floats, offset: float) -> tuple[Floats, Floats]:
    period = float(pattern.sum())
    offset = offset % period
    edges = np.concatenate(([0.0], np.cumsum(pattern)))
    repeats = int(np.ceil((total + offset) / period)) + 1
    base = np.arange(repeats)[:, None] * period - offset
    begin, end = (base + edges[:-1:2]).ravel(), (base + edges[1::2]).ravel()
    begin_cut, end_cut = np.maximum(begin, 0.0), np.minimum(end, total)
    real = (begin_cut < end_cut) | ((begin == end) & (begin >= 0) & (begin <= total))
    return begin_cut[real], end_cut[real]
