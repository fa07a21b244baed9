"""Windows over a row of values, against the library that has them: the same to the bit, or plans would change."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from planning.motion.windows import even_over_three, highest_around

LENGTHS = st.integers(1, 50)
VALUES = st.floats(0.0, 1e6)


@given(arrays(np.float64, LENGTHS, elements=VALUES), st.integers(0, 40))
def test_the_highest_around_each_value(values: np.ndarray, reach: int) -> None:
    assert np.array_equal(highest_around(values, 2 * reach + 1), maximum_filter1d(values, 2 * reach + 1))


@given(arrays(np.bool_, LENGTHS), st.integers(0, 40))
def test_a_margin_around_what_is_marked(marks: np.ndarray, reach: int) -> None:
    wanted = maximum_filter1d(marks.astype(np.int8), 2 * reach + 1, mode="constant") > 0
    assert np.array_equal(highest_around(marks, 2 * reach + 1), wanted)


@given(arrays(np.float64, LENGTHS, elements=VALUES))
def test_the_mean_of_three(values: np.ndarray) -> None:
    assert np.array_equal(even_over_three(values), uniform_filter1d(values, 3))
