"""What a pen-up travel costs: a distance, or the time of the slower motor up to a factor."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Cost of travelling from each of (n, 2) points to each of (n, 2) points, (n,). It must be symmetric and zero for no travel.
Metric = Callable[[Array, Array], Array]


def euclidean(from_mm: Array, to_mm: Array) -> Array:
    """Straight distance, (n,) in millimetres."""
    step = to_mm - from_mm
    return np.asarray(np.sqrt(step[..., 0] ** 2 + step[..., 1] ** 2))


def slowest_motor(steps_per_mm: NDArray[np.float64]) -> Metric:
    """The metric of a machine whose every motor has the same top speed: the steps of the motor that turns furthest.

    `steps_per_mm` is (2, 2), as in `Kinematics`. For CoreXY this is the sum of the axes' distances, for a cartesian machine the
    greater of them.
    """
    matrix = np.asarray(steps_per_mm, dtype=np.float64)

    def metric(from_mm: Array, to_mm: Array) -> Array:
        return np.asarray(np.abs((to_mm - from_mm) @ matrix.T).max(axis=-1))

    return metric
