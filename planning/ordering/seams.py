"""Where closed strokes start, and how far they are drawn on past their start."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from planning.geometry.stroke import Stroke
from planning.ordering.joining import SHARPEST_SMOOTH_TURN, smooth_at
from planning.ordering.metric import Array, Metric
from planning.ordering.quick import is_closed

Seams = Literal["random", "same", "hidden", "free"]
Ints = NDArray[np.int64]

# Corners this near to the sharpest one hide a seam as well.
AS_SHARP = np.radians(5)
# The start is moved among at most so many vertices of a stroke: beyond that a finer choice saves next to nothing.
MOST_PLACES = 48


def places(stroke: Stroke, seams: Seams, rng: np.random.Generator) -> Ints:
    """The vertices at which a closed stroke may start, rising. An open stroke has its first only."""
    count = len(stroke.points_mm) - 1
    if not is_closed(stroke) or seams == "same" or count < 2:
        return np.zeros(1, dtype=np.int64)
    if seams == "random":
        return rng.integers(count, size=1)
    chosen = _sharpest(stroke) if seams == "hidden" else np.arange(count)
    return chosen[:: -(-len(chosen) // MOST_PLACES)]


def _sharpest(stroke: Stroke) -> Ints:
    """The sharpest corners; every vertex when there is no corner."""
    points = stroke.points_mm[:-1]
    if stroke.corners is not None and not stroke.corners[1:-1].any() and _smooth_seam(stroke):
        return np.arange(len(points))
    before, after = points - np.roll(points, 1, axis=0), np.roll(points, -1, axis=0) - points
    turn = np.abs(np.arctan2(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0], (before * after).sum(axis=1)))
    if stroke.corners is None:
        corner = turn > SHARPEST_SMOOTH_TURN
    else:
        corner = stroke.corners[:-1].copy()
        corner[0] = not _smooth_seam(stroke)
    if not corner.any():
        return np.arange(len(points))
    return np.flatnonzero(corner & (turn >= turn[corner].max() - AS_SHARP))


def _smooth_seam(stroke: Stroke) -> bool:
    """Whether a closed stroke runs on smoothly over its first point."""
    assert stroke.corners is not None
    around = [-3, -2, 0, 1, 2] if len(stroke.points_mm) > 4 else [-2, 0, 1]
    return smooth_at(stroke.points_mm[around], stroke.corners[around], len(around) // 2)


def start_at(stroke: Stroke, vertex: int) -> Stroke:
    """The same closed stroke begun at another of its vertices. The old seam stays a corner only if the path turns there."""
    if vertex == 0:
        return stroke
    points = np.concatenate((stroke.points_mm[vertex:], stroke.points_mm[1 : vertex + 1]))
    if stroke.corners is None:
        return Stroke(points, None, stroke.color)
    corners = np.concatenate((stroke.corners[vertex:], stroke.corners[1 : vertex + 1]))
    corners[len(stroke.points_mm) - 1 - vertex] = not _smooth_seam(stroke)
    corners[[0, -1]] = True
    return Stroke(points, corners, stroke.color)


def overdraw(stroke: Stroke, length_mm: float) -> Stroke:
    """A closed stroke drawn on for `length_mm` beyond its start, once round at the most. Others are returned as they are."""
    if length_mm <= 0 or not is_closed(stroke):
        return stroke
    points = stroke.points_mm
    run = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))))
    length_mm = min(length_mm, float(run[-1]))
    last = int(np.searchsorted(run, length_mm, side="left"))  # the vertex at or after the end
    begin, end = run[last - 1], run[last]
    tip = points[last - 1] + (length_mm - begin) / (end - begin) * (points[last] - points[last - 1])
    longer = np.concatenate((points, points[1:last], tip[None]))
    if stroke.corners is None:
        return Stroke(longer, None, stroke.color)
    corners = np.concatenate((stroke.corners, stroke.corners[1:last], [True]))
    corners[len(points) - 1] = not _smooth_seam(stroke)
    return Stroke(longer, corners, stroke.color)


class Choices:
    """The vertices at which strokes may start, side by side: of those only that have a choice, rows sorted by stroke."""

    def __init__(self, strokes: list[Stroke], seams: Seams, rng: np.random.Generator) -> None:
        options = [places(stroke, seams, rng) for stroke in strokes]
        self.chosen = np.array([option[0] for option in options], dtype=np.int64)  # (n,) a vertex for each stroke
        several = [k for k, option in enumerate(options) if len(option) > 1]
        self.stroke = np.repeat(np.array(several, dtype=np.int64), [len(options[k]) for k in several])
        self.vertex = np.concatenate([options[k] for k in several]) if several else np.zeros(0, dtype=np.int64)
        self.points_mm = np.concatenate([strokes[k].points_mm[options[k]] for k in several]) if several else np.zeros((0, 2))

    def relax(self, from_mm: Array, to_mm: Array, moving: NDArray[np.bool_], metric: Metric) -> tuple[Ints, Array]:
        """Move the `moving` strokes' starts to where coming from `from_mm` and going on to `to_mm` (n, 2) costs least.

        Returns the strokes that had a choice and where (k, 2) each starts now.
        """
        rows = np.flatnonzero(moving[self.stroke])
        stroke, points = self.stroke[rows], self.points_mm[rows]
        cost = metric(from_mm[stroke], points) + metric(points, to_mm[stroke])
        starts = np.flatnonzero(np.diff(stroke, prepend=-1))
        least = np.repeat(np.minimum.reduceat(cost, starts), np.diff(np.append(starts, len(rows)))) if len(rows) else cost
        lowest = np.flatnonzero(cost == least)
        best = lowest[np.flatnonzero(np.diff(stroke[lowest], prepend=-1))]
        self.chosen[stroke[best]] = self.vertex[rows[best]]
        return stroke[best], points[best]
