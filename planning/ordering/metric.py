"""What a pen-up travel costs: a distance, the steps of the motor that turns furthest, or seconds."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from planning.motion.limits import Kinematics, Limits
from planning.motion.travel import closed_form

Array = NDArray[np.float64]

# Cost of travelling from each of (n, 2) points to each of (n, 2) points, (n,). It must be symmetric and zero for no travel.
Metric = Callable[[Array, Array], Array]

# How far the table of travel times reaches, beyond any machine, and how many entries it has.
LONGEST_MM = 20_000.0
TABLE = 8192
# So many times are looked up at once: bounds the memory.
BLOCK = 1 << 16


def euclidean(from_mm: Array, to_mm: Array) -> Array:
    """Straight distance, (n,) in millimetres."""
    step = to_mm - from_mm
    return np.asarray(np.sqrt(step[..., 0] ** 2 + step[..., 1] ** 2))


def slowest_motor(steps_per_mm: NDArray[np.float64]) -> Metric:
    """The metric of a machine whose every motor has the same top speed: the steps of the motor that turns furthest.

    `steps_per_mm` is (2, 2), as in `Kinematics`. For CoreXY this is the sum of the axes' distances, for a cartesian machine the
    greater of them.
    """
    (ax, ay), (bx, by) = np.asarray(steps_per_mm, dtype=np.float64).tolist()

    def metric(from_mm: Array, to_mm: Array) -> Array:
        step = to_mm - from_mm
        x, y = step[..., 0], step[..., 1]
        return np.asarray(np.maximum(np.abs(ax * x + ay * y), np.abs(bx * x + by * y)))

    return metric


def travel_time(kinematics: Kinematics, limits: Limits) -> Metric:
    """The seconds of a travel from rest to rest within `limits` of each motor's own belt, as `planning.motion.travel` makes it.

    A short travel takes longer than its share of the way. It is the motor's that turns furthest: a table of its time, even in
    the root of its way, makes it quick.
    """
    row = np.linalg.norm(kinematics.steps_per_mm, axis=1)
    belt_mm = slowest_motor(kinematics.steps_per_mm / row[:, None])
    speed_mm_s = min(limits.speed_mm_s, float((kinematics.max_step_rate / row).min()))
    roots = np.linspace(0.0, math.sqrt(LONGEST_MM), TABLE)
    phases = [closed_form(way_mm, speed_mm_s, limits.acceleration_mm_s2, limits.jerk_mm_s3) for way_mm in (roots**2).tolist()]
    seconds = np.array([4 * jerk + 2 * steady + cruise for jerk, steady, cruise in phases])
    slope, last = np.diff(seconds), TABLE - 2
    per_root = (TABLE - 1) / roots[-1]

    def looked_up(from_mm: Array, to_mm: Array) -> Array:
        at = np.sqrt(belt_mm(from_mm, to_mm)) * per_root
        i = np.minimum(at.astype(np.int64), last)
        return np.asarray(seconds[i] + (at - i) * slope[i])

    def metric(from_mm: Array, to_mm: Array) -> Array:
        if len(from_mm) <= BLOCK or len(to_mm) != len(from_mm):
            return looked_up(from_mm, to_mm)
        parts = [slice(k, k + BLOCK) for k in range(0, len(from_mm), BLOCK)]
        return np.concatenate([looked_up(from_mm[part], to_mm[part]) for part in parts])

    return metric
