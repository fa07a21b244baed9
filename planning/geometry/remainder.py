"""What is left of a stroke that was interrupted."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planning.geometry.stroke import Stroke

# The pen was followed along its motion, which is shorter than the stroke by what it cuts off at every corner: the place is
# looked for this near (mm), and further on by this part of the length that is drawn.
_SEARCH_MM, _CUT = 3.0, 0.1
# Of places that are as near as this to each other's distance (mm) the length drawn says which: whole steps, and the tolerance.
_ALIKE_MM = 0.02
# So much is drawn again, so that no gap is left.
OVERLAP_MM = 0.1


def remainder(
    stroke: Stroke, drawn_mm: float, position_mm: NDArray[np.float64] | None, overlap_mm: float = OVERLAP_MM
) -> Stroke | None:
    """The rest of `stroke` from where the pen left it, begun `overlap_mm` earlier; None when nothing is left.

    `drawn_mm` is the length drawn as counted along the motion; `position_mm` (2,) is where the pen stood, None when only the
    length is known. The place is the point of the stroke nearest to `position_mm` whose length is at most 3 mm less than
    `drawn_mm`, or 3 mm and a tenth more; where the stroke passes there several times, the pass whose length is nearest to it.
    """
    points = stroke.points_mm
    run = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))))
    if run[-1] == 0.0:
        return stroke if drawn_mm <= 0 else None
    at_mm = min(max(drawn_mm, 0.0), float(run[-1]))
    if position_mm is not None:
        at_mm = _nearest(points, run, at_mm, position_mm)
    if at_mm >= run[-1] - 1e-9:
        return None
    at_mm = max(at_mm - overlap_mm, 0.0)
    after = int(np.searchsorted(run, at_mm, side="right"))
    share = (at_mm - run[after - 1]) / (run[after] - run[after - 1])
    tip = points[after - 1] + share * (points[after] - points[after - 1])
    corners = None if stroke.corners is None else np.concatenate(([True], stroke.corners[after:]))
    return Stroke(np.concatenate((tip[None], points[after:])), corners, stroke.color)


def _nearest(points: NDArray[np.float64], run: NDArray[np.float64], at_mm: float, position_mm: NDArray[np.float64]) -> float:
    """The length along the stroke of its point nearest to `position_mm`, among those near `at_mm`."""
    step, length = np.diff(points, axis=0), np.diff(run)
    near = (run[1:] >= at_mm - _SEARCH_MM) & (run[:-1] <= (1.0 + _CUT) * at_mm + _SEARCH_MM) & (length > 0)
    start, step, length, run = points[:-1][near], step[near], length[near], run[:-1][near]
    share = np.clip(((position_mm - start) * step).sum(axis=1) / length**2, 0.0, 1.0)
    distance = np.hypot(*(start + share[:, None] * step - position_mm).T)
    # A pass is nearest within a segment, or at an end of one whose neighbour there is no nearer.
    apart = np.concatenate(([np.inf], distance, [np.inf]))
    nearest = ((share > 0.0) | (distance <= apart[:-2])) & ((share < 1.0) | (distance <= apart[2:]))
    along = (run + share * length)[nearest & (distance <= distance.min() + _ALIKE_MM)]
    return float(along[np.abs(along - at_mm).argmin()])
