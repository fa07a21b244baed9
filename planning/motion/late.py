"""What is needed of scipy, loaded when it is first called for: nowhere else is it imported.

It takes a quarter of a second to be loaded, a sixth of what passes from the command to the first motion. To read a drawing, to
check it and to raise the pen nothing of it is needed; so it is loaded while the pen is on its way up, and all waits for that.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


def solveh_banded(band: Array, right: Array, **options: Any) -> Array:
    """`scipy.linalg.solveh_banded`: a symmetric positive definite banded system. Raises LinAlgError for any other."""
    from scipy.linalg import solveh_banded

    return np.asarray(solveh_banded(band, right, **options))


def tree_of(points_mm: Array) -> cKDTree:
    """A tree that finds the nearest of `points_mm` (n, 2)."""
    from scipy.spatial import cKDTree

    return cKDTree(points_mm)


def hanging_together(one: Ints, other: Ints, count: int) -> Ints:
    """A number for each of `count` nodes, (count,), the same for those between which there is a way along the edges from
    `one` (k,) to `other` (k,)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(one), dtype=np.int8), (one, other)), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)
