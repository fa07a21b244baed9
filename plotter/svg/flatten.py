"""Segments to polylines in page millimetres, within a chord tolerance, with marks at true corners.

Bounds. For a parametric curve cut into n equal steps the chord error is at most max|B''| / (8 n^2). A cubic's |B''| is at most
6 max|second difference of its controls|, a quadratic's is 2 of them: n^2 = 0.75 D / tol and 0.25 D / tol. An ellipse with
longest half axis r in equal steps h of its angle errs by r (1 - cos(h/2)): h = 2 acos(1 - tol / r).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plotter.svg.path_segments import ARC, CUBIC, LINE, QUADRATIC, Bools, Floats, Ints, Segments

# A join counts as smooth below this angle: files written with two or three decimals turn by about this much where curves join.
SMOOTH_JOIN_RAD = np.radians(1.0)
# Shorter than this a segment is nothing, and a closing line is a rounding error. Far below any plotter's step.
NOTHING_MM = 1e-9
ROUNDING_MM = 1e-4

# A thousand kilometres: what is larger is a mistake, and its curves would take all points there are.
FARTHEST_MM = 1e9

_EVALUATED_AT_ONCE = 200_000
_ENDLESS = 2.0**40


@dataclass(frozen=True, eq=False, slots=True)
class Polylines:
    """Polylines of many subpaths: `points` (N, 2) mm, `corner` (N,), `offset` (k + 1,) into both, and for each polyline its
    `path` (k,), whether it was `closed` by a close command (k,), and whether it is a `dot` (k,), drawn but without length."""

    points: Floats
    corner: Bools
    offset: Ints
    path: Ints
    closed: Bools
    dot: Bools


def flatten(segments: Segments, matrix: Floats, tolerance_mm: float | Floats, point_budget: int) -> Polylines:
    """Polylines of `segments`; `matrix` (paths, 6) maps each path's units to page millimetres;
    `tolerance_mm` is one for all or (paths,).

    Raises BeyondNumbers where a segment is beyond reason, and PointBudget, before anything is allocated, where more than
    `point_budget` points would be made.
    """
    paths = len(matrix)
    if paths > 1 and (matrix == matrix[0]).all():
        matrix = matrix[:1]
    mapped = _to_page(segments, matrix)
    keep = mapped.extent > np.where(segments.closing, ROUNDING_MM, NOTHING_MM)
    snapped = np.zeros(len(segments.path), bool)
    snapped[segments.subpath[segments.closing & ~keep]] = True
    used = np.zeros(len(segments.path), bool)
    used[segments.subpath[keep]] = True
    dot = segments.drawn & ~used
    wanted = used | dot
    each_tolerance_mm = np.broadcast_to(tolerance_mm, paths)[segments.path[segments.subpath]]
    pieces = _pieces(mapped, segments.kind, keep, each_tolerance_mm)
    beyond = np.flatnonzero(~(mapped.extent < FARTHEST_MM))
    if len(beyond):
        raise BeyondNumbers(int(segments.path[segments.subpath[beyond[0]]]))
    total = int(pieces.sum(dtype=np.float64)) + int(wanted.sum())
    if total > point_budget:
        raise PointBudget(total)

    rank = np.cumsum(wanted) - 1
    sub = rank[segments.subpath[keep]]
    count = np.ones(int(wanted.sum()), np.int64)
    np.add.at(count, sub, pieces)
    offset = np.concatenate(([0], np.cumsum(count)))
    out = np.empty((total, 2))
    out[offset[:-1]] = _map(segments.start[wanted], _of_each(matrix, segments.path[wanted]))
    last = np.cumsum(pieces) + sub
    kind, points = (segments.kind, mapped.points) if keep.all() else (segments.kind[keep], mapped.points[keep])
    _write_curves(out, kind, points, mapped.arcs(keep), last, pieces)
    out[last] = points[:, 3]
    closed = segments.closed[wanted]
    ends = offset[1:] - 1
    shut = snapped[wanted] & (ends > offset[:-1])
    out[ends[shut]] = out[offset[:-1][shut]]

    corner = np.zeros(total, bool)
    corner[offset[:-1]] = corner[ends] = True
    if len(sub) > 1:
        arriving, leaving = _tangents(points, mapped.arcs(keep))
        joined = sub[1:] == sub[:-1]
        corner[last[:-1][joined]] = _turns(arriving[:-1][joined], leaving[1:][joined])
    return Polylines(out, corner, offset, segments.path[wanted], closed, dot[wanted])


class BeyondNumbers(Exception):
    """A segment is longer than FARTHEST_MM, or not finite; `args[0]` is its path."""


class PointBudget(Exception):
    """More points than the budget; `args[0]` is how many."""


@dataclass(frozen=True, eq=False, slots=True)
class _Arcs:
    """Arcs of the kept segments: their place among those, and their form in millimetres."""

    row: Ints
    centre: Floats
    axis_u: Floats
    axis_v: Floats
    angle: Floats
    sweep: Floats


@dataclass(frozen=True, eq=False, slots=True)
class _Mapped:
    points: Floats
    extent: Floats
    arc_rows: Ints
    centre: Floats
    axis_u: Floats
    axis_v: Floats
    angle: Floats
    sweep: Floats

    def arcs(self, keep: Bools) -> _Arcs:
        used = keep[self.arc_rows]
        place = (np.cumsum(keep) - 1)[self.arc_rows[used]]
        return _Arcs(place, self.centre[used], self.axis_u[used], self.axis_v[used], self.angle[used], self.sweep[used])


def _map(points: Floats, matrix: Floats, *, linear: bool = False) -> Floats:
    """(n, 2) points through (n, 6) matrices; without the translation where `linear`."""
    x = matrix[:, 0] * points[:, 0] + matrix[:, 2] * points[:, 1]
    y = matrix[:, 1] * points[:, 0] + matrix[:, 3] * points[:, 1]
    return np.stack((x, y) if linear else (x + matrix[:, 4], y + matrix[:, 5]), axis=1)


def _to_page(segments: Segments, matrix: Floats) -> _Mapped:
    m = _of_each(matrix, segments.path[segments.subpath])
    points = np.empty_like(segments.points)
    points[:, 0] = points[:, 1] = _map(segments.points[:, 0], m)
    points[:, 3] = points[:, 2] = _map(segments.points[:, 3], m)
    # An arc whose ends meet is nothing only when it has no radius, and such arcs are lines by now.
    extent = _greater(points[:, 3] - points[:, 0])
    curve = np.flatnonzero((segments.kind == CUBIC) | (segments.kind == QUADRATIC))
    if len(curve):
        m_curve = _of_each(m, curve)
        points[curve, 1] = _map(segments.points[curve, 1], m_curve)
        points[curve, 2] = _map(segments.points[curve, 2], m_curve)
        quadratic = curve[segments.kind[curve] == QUADRATIC]
        points[quadratic, 2] = points[quadratic, 1]
        for i in (1, 2):
            extent[curve] = np.maximum(extent[curve], _greater(points[curve, i] - points[curve, 0]))
    arc = np.flatnonzero(segments.kind == ARC)
    m_arc = _of_each(m, arc)
    u, v = _map(segments.axis_u, m_arc, linear=True), _map(segments.axis_v, m_arc, linear=True)
    extent[arc] = np.maximum(_greater(u), _greater(v)) * np.minimum(1, np.abs(segments.sweep))
    return _Mapped(points, extent, arc, _map(segments.centre, m_arc), u, v, segments.angle, segments.sweep)


def _of_each(matrix: Floats, rows: Ints) -> Floats:
    """`matrix[rows]`; one that all have in common is not copied for each of a million."""
    return matrix if len(matrix) == 1 else matrix[rows]


def _greater(vectors: Floats) -> Floats:
    """The greater of |x| and |y| of (n, 2): by column, which numpy takes in much faster than by row."""
    size = np.abs(vectors)
    return np.asarray(np.maximum(size[:, 0], size[:, 1]))


def _pieces(mapped: _Mapped, kind: NDArray[np.uint8], keep: Bools, tolerance_mm: Floats) -> Ints:
    """Into how many equal steps each kept segment is cut."""
    need = np.ones(len(kind))
    p = mapped.points
    rows = np.flatnonzero(kind == CUBIC)
    if len(rows):
        bend = np.zeros(len(rows))
        for i in (0, 1):
            difference = p[rows, i] - 2 * p[rows, i + 1] + p[rows, i + 2]
            bend = np.maximum(bend, np.hypot(difference[:, 0], difference[:, 1]))
        need[rows] = np.sqrt(0.75 / tolerance_mm[rows] * bend)
    rows = np.flatnonzero(kind == QUADRATIC)
    bend2 = p[rows, 0] - 2 * p[rows, 1] + p[rows, 3]
    need[rows] = np.sqrt(0.25 / tolerance_mm[rows] * np.hypot(bend2[:, 0], bend2[:, 1]))
    if len(mapped.arc_rows):
        r = longest_half_axis(mapped.axis_u, mapped.axis_v)
        need[mapped.arc_rows] = _arc_need(mapped.sweep, r, tolerance_mm[mapped.arc_rows])
    return _whole(need[keep])


def _whole(need: Floats) -> Ints:
    need = np.ceil(need * (1 - 1e-12))
    return np.clip(np.where(np.isnan(need), _ENDLESS, need), 1, _ENDLESS).astype(np.int64)


def arc_steps(sweep: Floats, half_axis_mm: Floats, tolerance_mm: Floats) -> Ints:
    """Into how many equal steps arcs are cut: of `sweep` radians each, (n,), of ellipses with this longest half axis (n,)."""
    return _whole(_arc_need(sweep, half_axis_mm, tolerance_mm))


def _arc_need(sweep: Floats, half_axis_mm: Floats, tolerance_mm: Floats) -> Floats:
    # 2 acos(1 - x) as 4 asin(sqrt(x / 2)), which stays exact where the arc is so flat that 1 - x would be 1.
    step = 4 * np.arcsin(np.sqrt(np.minimum(tolerance_mm / np.maximum(half_axis_mm, NOTHING_MM) / 2, 0.5)))
    return np.asarray(np.abs(sweep) / np.minimum(step, np.pi / 4))


def longest_half_axis(u: Floats, v: Floats) -> Floats:
    """Greatest singular value of the maps whose columns are u and v."""
    sum_ = (u**2).sum(axis=1) + (v**2).sum(axis=1)
    cross = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    gap = np.sqrt(np.maximum((sum_ - 2 * cross) * (sum_ + 2 * cross), 0.0))
    return np.asarray(np.sqrt((sum_ + gap) / 2))


def _write_curves(out: Floats, kind: NDArray[np.uint8], points: Floats, arcs: _Arcs, last: Ints, pieces: Ints) -> None:
    """The inner points of curves; `last` is where each segment's end goes."""
    for curve in (CUBIC, QUADRATIC):
        rows = np.flatnonzero((kind == curve) & (pieces > 1))
        for chosen in _batches(rows, pieces):
            p = points[chosen]
            if curve == CUBIC:
                c1 = 3 * (p[:, 1] - p[:, 0])
                c2 = 3 * (p[:, 0] - 2 * p[:, 1] + p[:, 2])
                c3 = p[:, 3] - p[:, 0] + 3 * (p[:, 1] - p[:, 2])
            else:
                c1 = 2 * (p[:, 1] - p[:, 0])
                c2 = p[:, 0] - 2 * p[:, 1] + p[:, 3]
                c3 = None
            row, place, t = _steps(last[chosen], pieces[chosen])
            for axis in (0, 1):
                value = c2[row, axis] if c3 is None else c3[row, axis] * t + c2[row, axis]
                out[place, axis] = (value * t + c1[row, axis]) * t + p[row, 0, axis]
    long_arc = pieces[arcs.row] > 1
    order = np.full(len(kind), -1)
    order[arcs.row] = np.arange(len(arcs.row))
    for chosen in _batches(arcs.row[long_arc], pieces):
        mine = order[chosen]
        row, place, t = _steps(last[chosen], pieces[chosen])
        theta = arcs.angle[mine][row] + arcs.sweep[mine][row] * t
        cos, sin = np.cos(theta), np.sin(theta)
        for axis in (0, 1):
            out[place, axis] = (
                arcs.centre[mine, axis][row] + arcs.axis_u[mine, axis][row] * cos + arcs.axis_v[mine, axis][row] * sin
            )


def _batches(rows: Ints, pieces: Ints) -> list[Ints]:
    """Rows in groups that make about so many points each."""
    if not len(rows):
        return []
    groups = np.cumsum(pieces[rows]) // _EVALUATED_AT_ONCE
    return np.split(rows, np.flatnonzero(np.diff(groups)) + 1)


def _steps(last: Ints, pieces: Ints) -> tuple[Ints, Ints, Floats]:
    """For every inner point: its segment's row, its place in the output and its parameter."""
    inner = pieces - 1
    row = np.repeat(np.arange(len(inner)), inner)
    step = np.arange(len(row)) - np.repeat(np.cumsum(inner) - inner, inner) + 1
    return row, (last - pieces)[row] + step, step / pieces[row]


def tangents(segments: Segments) -> tuple[Floats, Floats]:
    """Directions (not normalised) in which each segment arrives at its end and leaves its start, in user units; zero for a
    segment without length."""
    points = segments.points.copy()
    straight = (segments.kind == LINE) | (segments.kind == ARC)
    points[straight, 1], points[straight, 2] = points[straight, 0], points[straight, 3]
    quadratic = segments.kind == QUADRATIC
    points[quadratic, 2] = points[quadratic, 1]
    rows = np.flatnonzero(segments.kind == ARC)
    arcs = _Arcs(rows, segments.centre, segments.axis_u, segments.axis_v, segments.angle, segments.sweep)
    return _tangents(points, arcs)


def _tangents(points: Floats, arcs: _Arcs) -> tuple[Floats, Floats]:
    """Directions (not normalised) in which each segment arrives at its end and leaves its start."""
    leaving = points[:, 3] - points[:, 0]
    arriving = leaving.copy()
    # Of a line, whose controls are its ends, that is all; of a curve only what is left where controls lie on its ends.
    curve = np.flatnonzero(_differ(points[:, 1], points[:, 0]) | _differ(points[:, 2], points[:, 3]))
    if len(curve):
        p = points if len(curve) == len(points) else points[curve]
        out, into = p[:, 1] - p[:, 0], p[:, 3] - p[:, 2]
        for i in (2, 3):
            stuck = _greater(out) <= NOTHING_MM
            out[stuck] = p[stuck, i] - p[stuck, 0]
        for i in (1, 0):
            stuck = _greater(into) <= NOTHING_MM
            into[stuck] = p[stuck, 3] - p[stuck, i]
        leaving[curve], arriving[curve] = out, into
    if len(arcs.row):
        way = np.sign(arcs.sweep)[:, None]
        for theta, target in ((arcs.angle, leaving), (arcs.angle + arcs.sweep, arriving)):
            target[arcs.row] = way * (arcs.axis_v * np.cos(theta)[:, None] - arcs.axis_u * np.sin(theta)[:, None])
    return arriving, leaving


def _differ(one: Floats, other: Floats) -> Bools:
    return np.asarray((one[:, 0] != other[:, 0]) | (one[:, 1] != other[:, 1]))


def _turns(before: Floats, after: Floats) -> Bools:
    cross = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    along = before[:, 0] * after[:, 0] + before[:, 1] * after[:, 1]
    return np.asarray(np.abs(np.arctan2(cross, along)) > SMOOTH_JOIN_RAD)
