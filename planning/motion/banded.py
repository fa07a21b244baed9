"""The tube's least squares: weighted jerk, acceleration, and distance to the path, as one symmetric banded system for all
blocks.

Unknowns are the control points, x and y interleaved. Terms of one row touch 3 or 4 neighbouring control points, so the matrix
has 7 bands above its diagonal; blocks share no term, so that they are solved together and stay independent.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planning.motion.late import solveh_banded
from planning.motion.spline import Array, Ints, Layout

BANDS = 7
# Weight of a control point that is given, over the largest weight beside it.
FIXED = 1e9


@dataclass(frozen=True, eq=False, slots=True)
class Anchors:
    """Places the fit must pass near at a given time: rows (m,), basis (4, m), target (m, 2), and 2 x 2 metrics (m, 3) as xx,

    xy, yy.
    """

    row: Ints
    basis: Array
    target: Array
    metric: Array


@dataclass(frozen=True, eq=False, slots=True)
class Fixed:
    """Given control points: rows (m,), values (m, 2)."""

    row: Ints
    value: Array


def solve(
    lay: Layout,
    jerk_weight: Array,
    acceleration_weight: Array,
    metric: tuple[Array, Array, Array],
    target: Array,
    anchors: Anchors,
    anchor_weight: Array,
    fixed: Fixed,
) -> Array:
    """Control points (M, 2) that minimise the weighted sum of squares. All weights (M,), 0 where a row has no knot or interval.

    `metric` is (xx, xy, yy) of the position term at each knot, `target` (M, 2) the path's points there.
    """
    m = len(jerk_weight)
    band = np.zeros((BANDS + 1, m, 2))
    right = np.zeros((m, 2))
    xx, xy, yy = metric
    # Entry (row a, row b) of the upper form is at band[7 - distance, column b]; the column of control point k + b is row k
    # moved by b.
    for a in range(4):
        for b in range(a, 4):
            both = jerk_weight * (lay.jerk[a] * lay.jerk[b])
            if b < 3:
                both += acceleration_weight * (lay.acceleration[a] * lay.acceleration[b])
                share = lay.value[a] * lay.value[b]
                part_x, part_y, cross = both + share * xx, both + share * yy, share * xy
            else:
                part_x = part_y = both
                cross = None
            level = BANDS - 2 * (b - a)
            end = m - b
            band[level, b:, 0] += part_x[:end]
            band[level, b:, 1] += part_y[:end]
            if cross is not None:
                band[level - 1, b:, 1] += cross[:end]
                if b > a:
                    band[level + 1, b:, 0] += cross[:end]
    pull_x = xx * target[:, 0] + xy * target[:, 1]
    pull_y = xy * target[:, 0] + yy * target[:, 1]
    for a in range(3):
        right[a:, 0] += (lay.value[a] * pull_x)[: m - a]
        right[a:, 1] += (lay.value[a] * pull_y)[: m - a]
    add_anchors(band, right, anchors, anchor_weight)
    heavy = FIXED * band[BANDS].max()
    band[BANDS, fixed.row] += heavy
    right[fixed.row] += heavy * fixed.value
    flat = solveh_banded(
        band.reshape(BANDS + 1, 2 * m), right.reshape(2 * m), overwrite_ab=True, overwrite_b=True, check_finite=False
    )
    control = flat.reshape(m, 2)
    control[fixed.row] = fixed.value
    return np.asarray(control)


def add_anchors(band: Array, right: Array, anchors: Anchors, weight: Array) -> None:
    if not len(anchors.row):
        return
    xx, xy, yy = (anchors.metric * weight[:, None]).T
    pull_x = xx * anchors.target[:, 0] + xy * anchors.target[:, 1]
    pull_y = xy * anchors.target[:, 0] + yy * anchors.target[:, 1]
    flat_band, flat_right = band.reshape(-1), right.reshape(-1)
    width = 2 * len(right)
    for a in range(4):
        column = 2 * (anchors.row + a)
        np.add.at(flat_right, column, anchors.basis[a] * pull_x)
        np.add.at(flat_right, column + 1, anchors.basis[a] * pull_y)
        for b in range(a, 4):
            share = anchors.basis[a] * anchors.basis[b]
            level = (BANDS - 2 * (b - a)) * width + 2 * (anchors.row + b)
            np.add.at(flat_band, level, share * xx)
            np.add.at(flat_band, level + 1, share * yy)
            np.add.at(flat_band, level - width + 1, share * xy)
            if b > a:
                np.add.at(flat_band, level + width, share * xy)
