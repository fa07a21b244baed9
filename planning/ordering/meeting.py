"""Closed strokes begin where another stroke ends on them, so that the two can be drawn in one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planning.geometry.stroke import Stroke
from planning.motion.late import tree_of
from planning.ordering.quick import is_closed, is_dot
from planning.ordering.seams import start_at


def begin_where_met(strokes: Sequence[Stroke], tolerance_mm: float) -> list[Stroke]:
    """The strokes, closed ones begun at the vertex that an open stroke's end is nearest to, if any is within the tolerance.

    A ring and what ends on it are one stroke when the ring begins there; begun elsewhere they are two.
    """
    result = list(strokes)
    closed = [k for k, stroke in enumerate(strokes) if is_closed(stroke) and not is_dot(stroke)]
    ends = [stroke.points_mm[[0, -1]] for stroke in strokes if not is_closed(stroke) and not is_dot(stroke)]
    if not closed or not ends or tolerance_mm < 0:
        return result
    sizes = np.array([len(strokes[k].points_mm) - 1 for k in closed], dtype=np.int64)
    vertices = np.concatenate([strokes[k].points_mm[:-1] for k in closed])
    # The bound of the query is exclusive.
    distance = np.asarray(
        tree_of(np.concatenate(ends)).query(vertices, distance_upper_bound=np.nextafter(tolerance_mm, np.inf))[0]
    )
    starts = np.cumsum(sizes) - sizes
    least = np.minimum.reduceat(distance, starts)
    for k, start, size, nearest in zip(closed, starts.tolist(), sizes.tolist(), least.tolist(), strict=True):
        if nearest <= tolerance_mm and distance[start] > nearest:
            result[k] = start_at(strokes[k], int(np.argmin(distance[start : start + size])))
    return result
