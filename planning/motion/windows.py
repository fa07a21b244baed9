"""What is highest, or even, in a window around every place of a row of values.

In numpy alone: the library that has these filters takes longer to be loaded than the first stroke takes to be planned.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from planning.motion.path import Array

Row = TypeVar("Row", Array, NDArray[np.bool_])


def highest_around(values: Row, width: int) -> Row:
    """The greatest of the `width` (odd) values around each, fewer at the ends. n log width."""
    # What lies beyond an end is that end's value again, which every window that reaches so far holds anyway.
    reach = min(width // 2, len(values) - 1)
    high = np.concatenate((np.repeat(values[:1], reach), values, np.repeat(values[-1:], reach)))
    covered = 1  # high[i] is the greatest of so many values
    while covered < 2 * reach + 1:
        step = min(covered, 2 * reach + 1 - covered)
        high = np.maximum(high[:-step], high[step:])
        covered += step
    return high


def even_over_three(values: Array) -> Array:
    """The mean of each value and its two neighbours; beyond an end is that end's value again. One running sum."""
    around = np.concatenate((values[:1], values, values[-1:]))
    return np.cumsum(np.concatenate((around[:3].sum(keepdims=True), around[3:] - around[:-3]))) / 3.0
