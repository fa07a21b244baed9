"""Cubic B-splines in time on any knots, many side by side in flat arrays.

A block is one spline with K intervals, K + 1 knots and K + 3 control points. Blocks follow each other in flat arrays of their
control points (M rows): knot k and interval k of a block are at its control point k; the last 2 rows of a block have no knot,
the last 3 no interval. With spacings A = h[k-2], B = h[k-1], C = h[k], D = h[k+1] around knot k,
d0 = 3 (c1 - c0) / (A + B + C) and d1 = 3 (c2 - c1) / (B + C + D):

    v_k = (C d0 + B d1) / (B + C)        a_k = 2 (d1 - d0) / (B + C)        q_k = c1 - N0 (c1 - c0) + N2 (c2 - c1)

Acceleration is linear between knots and jerk constant, so both are greatest at knots. Reference: de Boor, A Practical Guide
to Splines.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False, slots=True)
class Layout:
    """Where the blocks lie and when their knots are. `first` (B,) row of each block's first control point, `intervals` (B,);
    `block` (M,) block of each row; `time_s` (M,) time of the knot within its block; `spacing_s` (M,) after it; masks (M,)."""

    first: Ints
    intervals: Ints
    block: Ints
    time_s: Array
    spacing_s: Array
    is_knot: Mask
    is_interval: Mask
    value: Array
    velocity: Array
    acceleration: Array
    jerk: Array
    reach: tuple[Array, Array, Array, Array]

    def knot_values(self, control: Array) -> tuple[Array, Array, Array]:
        """Position, velocity and acceleration (M, 2) at each row's knot; meaningless where `is_knot` is False."""
        c0, c1, c2 = shifted(control, 0), shifted(control, 1), shifted(control, 2)

        def combined(basis: Array) -> Array:
            return np.asarray(basis[0][:, None] * c0 + basis[1][:, None] * c1 + basis[2][:, None] * c2)

        return combined(self.value), combined(self.velocity), combined(self.acceleration)


def shifted(array: Array, by: int) -> Array:
    """Rows moved up by `by`, the last ones repeated."""
    if by == 0:
        return array
    return np.concatenate((array[by:], np.repeat(array[-1:], by, axis=0)))


def layout(spacings_s: Array, intervals: Ints, pad_s: float) -> Layout:
    """Basis coefficients for blocks with `intervals` (B,) knot intervals of lengths `spacings_s` (sum of intervals,).

    Beyond its ends a block's knots are `pad_s` apart.
    """
    rows = intervals + 3
    first = np.cumsum(rows) - rows
    total = int(rows.sum())
    block = np.repeat(np.arange(len(intervals)), rows)
    within = np.arange(total) - first[block]
    is_knot = within <= intervals[block]
    is_interval = within < intervals[block]
    spacing = np.full(total, pad_s)
    spacing[is_interval] = spacings_s
    padded = np.concatenate(([pad_s, pad_s], spacing, [pad_s]))
    A, B, C, D = padded[:-3], padded[1:-2], padded[2:-1], padded[3:]
    left, right, both = A + B + C, B + C + D, B + C
    value0, value2 = C * C / (left * both), B * B / (right * both)
    value = np.stack((value0, 1.0 - value0 - value2, value2))
    velocity0, velocity2 = -3.0 * C / (left * both), 3.0 * B / (right * both)
    velocity = np.stack((velocity0, -velocity0 - velocity2, velocity2))
    acceleration0, acceleration2 = 6.0 / (left * both), 6.0 / (right * both)
    acceleration = np.stack((acceleration0, -acceleration0 - acceleration2, acceleration2))
    following = np.concatenate((acceleration[:, 1:], acceleration[:, -1:]), axis=1)
    jerk = np.stack((-acceleration[0], following[0] - acceleration[1], following[1] - acceleration[2], following[2])) / spacing
    jerk[:, ~is_interval] = 0.0
    clock = np.concatenate(([0.0], np.cumsum(np.where(is_interval, spacing, 0.0))))[:-1]
    time = clock - clock[first][block]
    return Layout(
        first, intervals, block, time, spacing, is_knot, is_interval, value, velocity, acceleration, jerk, (A, B, C, D)
    )


def control_of_state(
    lay: Layout, row: Ints, position: Array, velocity: Array, acceleration: Array
) -> tuple[Array, Array, Array]:
    """The three control points (each (m, 2)) that give these states at the knots of `row` (m,)."""
    A, B, C, D = (r[row][:, None] for r in lay.reach)
    d0, d1 = velocity - acceleration * B / 2.0, velocity + acceleration * C / 2.0
    step0, step1 = d0 * (A + B + C) / 3.0, d1 * (B + C + D) / 3.0
    middle = position + lay.value[0][row][:, None] * step0 - lay.value[2][row][:, None] * step1
    return middle - step0, middle, middle + step1


def basis_at(lay: Layout, row: Ints, after_s: Array) -> Array:
    """Weights (4, m) of the control points row .. row + 3 for the position `after_s` into interval `row`."""
    t = after_s
    out = np.zeros((4, len(row)))
    out[:3] += lay.value[:, row] + t * lay.velocity[:, row] + 0.5 * t * t * lay.acceleration[:, row]
    out += t**3 / 6.0 * lay.jerk[:, row]
    return out
