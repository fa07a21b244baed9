"""Strokes whose ends meet become one stroke."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planning.geometry.stroke import Mask, Stroke
from planning.ordering.junctions import junctions, pair_ends, pair_near, trails
from planning.ordering.metric import Array
from planning.ordering.quick import is_closed, is_dot

# A join is smooth when it turns hardly more than the curve does on either side of it, and never when it turns more than this.
SHARPEST_SMOOTH_TURN = np.radians(30)
STRAIGHT_ENOUGH = np.radians(0.5)


def join_strokes(strokes: Sequence[Stroke], tolerance_mm: float) -> list[Stroke]:
    """Strokes of one colour with their ends joined, in the order of the first stroke of each.

    Ends at most `tolerance_mm` apart are joined by a straight link of that length and no point is moved. A stroke that
    comes back to its start within the tolerance is closed, unless it is hardly longer than the tolerance itself. Dots stay
    as they are.
    """
    lines = [k for k, stroke in enumerate(strokes) if not is_dot(stroke)]
    if tolerance_mm < 0 or not lines:
        return list(strokes)
    ends_mm = np.array([strokes[k].points_mm[[0, -1]] for k in lines]).reshape(-1, 2)
    tangents = np.array([tangent for k in lines for tangent in _tangents(strokes[k].points_mm)])
    mate = pair_ends(junctions(ends_mm, tolerance_mm), tangents)
    _open_specks(mate, [strokes[k] for k in lines], tolerance_mm)
    pair_near(ends_mm, mate, tolerance_mm)
    joined = {}
    for trail in trails(mate):
        parts = [strokes[lines[node >> 1]] if node % 2 == 0 else strokes[lines[node >> 1]].reversed() for node in trail]
        joined[min(lines[node >> 1] for node in trail)] = chain(parts, closed=bool(mate[trail[0]] != -1))
    dots = {k: stroke for k, stroke in enumerate(strokes) if is_dot(stroke)}
    return [stroke for _, stroke in sorted((joined | dots).items(), key=lambda item: item[0])]


def join_in_turn(strokes: Sequence[Stroke], tolerance_mm: float) -> list[Stroke]:
    """Strokes of one colour in their own order and directions; one that begins where the last ended goes on from it."""
    runs: list[list[Stroke]] = []
    for stroke in strokes:
        gap = np.inf if not runs else _gap_mm(runs[-1][-1], stroke)
        if gap <= tolerance_mm and not is_dot(stroke) and not is_dot(runs[-1][-1]):
            runs[-1].append(stroke)
        else:
            runs.append([stroke])
    return [chain(run, closed=False) for run in runs]


def _gap_mm(left: Stroke, entered: Stroke) -> float:
    (x0, y0), (x1, y1) = left.points_mm[-1].tolist(), entered.points_mm[0].tolist()
    return math.hypot(x1 - x0, y1 - y0)


def _tangents(points_mm: Array) -> tuple[tuple[float, float], tuple[float, float]]:
    """Unit vectors from a stroke's first and last point into it; points that coincide with the end are passed over."""
    if len(points_mm) == 2:
        (x0, y0), (x1, y1) = points_mm.tolist()
        length = math.hypot(x1 - x0, y1 - y0)
        return ((x1 - x0) / length, (y1 - y0) / length), ((x0 - x1) / length, (y0 - y1) / length)
    if (points_mm[0] == points_mm[1]).all() or (points_mm[-1] == points_mm[-2]).all():
        points_mm = points_mm[np.r_[True, (np.diff(points_mm, axis=0) != 0).any(axis=1)]]
    first, last = points_mm[1] - points_mm[0], points_mm[-2] - points_mm[-1]
    (a, b), (c, d) = (first / np.hypot(*first)).tolist(), (last / np.hypot(*last)).tolist()
    return (a, b), (c, d)


def _open_specks(mate: NDArray[np.int64], strokes: Sequence[Stroke], tolerance_mm: float) -> None:
    """Do not close a lone stroke that is too short to be a loop: closing would draw it twice. Changes `mate`."""
    for node in np.flatnonzero(mate == (np.arange(len(mate)) ^ 1)).tolist():
        stroke = strokes[node >> 1]
        if not stroke.is_closed and stroke.length_mm < 4 * tolerance_mm:
            mate[node] = -1


def chain(parts: Sequence[Stroke], *, closed: bool) -> Stroke:
    """One stroke through all parts in turn, back to the first point when `closed`. A point that two parts share is kept once.

    A join is a corner unless the tangents match. Where no part knows its corners, neither does the whole; where some do, the
    vertices of the others count as corners, which keeps them exact.
    """
    if len(parts) == 1 and (not closed or is_closed(parts[0])):
        return parts[0]
    known = any(part.corners is not None for part in parts)
    points = [parts[0].points_mm]
    marks = [_marks(parts[0])]
    for part in parts[1:]:
        shared = bool((points[-1][-1] == part.points_mm[0]).all())
        points.append(part.points_mm[shared:])
        marks.append(_marks(part)[shared:])
        if shared:
            marks[-2] = marks[-2].copy()
    if closed and not (points[0][0] == points[-1][-1]).all():
        points.append(points[0][:1])
        marks.append(np.ones(1, dtype=np.bool_))
    whole = np.concatenate(points)
    if not known:
        return Stroke(whole, None, parts[0].color)
    corners = np.concatenate(marks)
    for at in np.cumsum([len(p) for p in points])[:-1].tolist():
        _judge_joint(whole, corners, at - 1)
        _judge_joint(whole, corners, at)
    corners[[0, -1]] = True
    return Stroke(whole, corners, parts[0].color)


def _marks(stroke: Stroke) -> Mask:
    return np.ones(len(stroke.points_mm), dtype=np.bool_) if stroke.corners is None else stroke.corners


def _judge_joint(points_mm: Array, corners: Mask, at: int) -> None:
    """Clear an inner vertex's corner mark when its turn is what the smooth vertices beside it let expect. Changes `corners`."""
    if 0 < at < len(points_mm) - 1 and corners[at]:
        corners[at] = not smooth_at(points_mm, corners, at)


def smooth_at(points_mm: Array, corners: Mask, at: int) -> bool:
    """Whether the path turns at vertex `at` no more than its smooth neighbours let expect.

    Where chords of one curve meet, the turn is half the sum of the turns before and after it; a neighbour that is a corner
    itself says nothing, and then only a straight path counts as smooth.
    """
    turn = _turn(points_mm, at)
    if abs(turn) <= STRAIGHT_ENOUGH:
        return True
    sides = [k for k in (at - 1, at + 1) if 0 < k < len(points_mm) - 1 and not corners[k]]
    if not sides or abs(turn) > SHARPEST_SMOOTH_TURN:
        return False
    around = [_turn(points_mm, k) for k in sides]
    expected = sum(around) / len(around)
    return bool(abs(turn - expected) <= 0.5 * abs(expected) + STRAIGHT_ENOUGH)


def _turn(points_mm: Array, at: int) -> float:
    """The signed angle by which the path turns at an inner vertex, in radians."""
    (x0, y0), (x1, y1), (x2, y2) = points_mm[at - 1 : at + 2].tolist()
    ux, uy, vx, vy = x1 - x0, y1 - y0, x2 - x1, y2 - y1
    return math.atan2(ux * vy - uy * vx, ux * vx + uy * vy)
