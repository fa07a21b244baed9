"""What is left of an interrupted stroke: no gap, a small overlap, and the right one of two places that lie close."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planning.geometry.remainder import OVERLAP_MM, remainder
from planning.geometry.stroke import Stroke

LINE = Stroke(np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 5.0]]), np.array([True, True, True]))


def test_the_rest_begins_a_little_before_the_place() -> None:
    rest = remainder(LINE, 4.0, np.array([4.02, 0.01]))
    assert rest is not None
    np.testing.assert_allclose(rest.points_mm, [[4.02 - OVERLAP_MM, 0], [10, 0], [10, 5]])
    assert rest.corners is not None
    assert rest.corners.tolist() == [True, True, True]


def test_nothing_is_left_at_the_end() -> None:
    assert remainder(LINE, 15.0, np.array([10.0, 5.0])) is None


def test_a_dot_is_left_until_it_is_drawn() -> None:
    dot = Stroke(np.array([[1.0, 1.0]]))
    assert remainder(dot, 0.0, None) is dot
    assert remainder(dot, 0.1, None) is None


def test_a_path_that_crosses_itself_is_taken_up_on_the_right_pass() -> None:
    """There and back along the same line: the length drawn says which pass it was."""
    there_and_back = Stroke(np.array([[0.0, 0.0], [20.0, 0.0], [0.0, 0.0]]))
    first = remainder(there_and_back, 5.0, np.array([5.0, 0.0]))
    second = remainder(there_and_back, 35.0, np.array([5.0, 0.0]))
    assert first is not None
    assert second is not None
    assert first.length_mm == pytest.approx(35.0 + OVERLAP_MM)
    assert second.length_mm == pytest.approx(5.0 + OVERLAP_MM)


@given(st.floats(0.0, 2 * np.pi), st.floats(1.0, 2.2), st.integers(0, 2**32 - 1))
def test_of_a_short_line_there_and_back_it_is_the_pass_that_was_drawn(angle: float, drawn_mm: float, seed: int) -> None:
    """Both passes are within the search; whole steps make either of them the nearer one by a hair."""
    start = np.random.default_rng(seed).uniform(10, 90, 2)
    way = np.array([np.cos(angle), np.sin(angle)])
    there_and_back = Stroke(np.array([start, start + 2.4 * way, start + 0.001]))
    rest = remainder(there_and_back, drawn_mm, np.rint((start + drawn_mm * way) * 80) / 80)
    assert rest is not None
    assert rest.length_mm == pytest.approx(4.8 - drawn_mm + OVERLAP_MM, abs=0.02)


@pytest.mark.parametrize("legs", [61, 601])
def test_the_place_is_found_however_much_was_cut_off_at_corners(legs: int) -> None:
    """A motion loses a little at every corner, so that its length falls behind the stroke's without bound."""
    points = np.array([(2.0 * (k % 2), 0.3 * k) for k in range(legs)])
    zigzag = Stroke(points)
    leg_mm = float(np.hypot(2.0, 0.3))
    for share in (0.3, 0.95):
        corner = int(share * (legs - 1))
        position = points[corner] + 0.4 * (points[corner + 1] - points[corner])
        true_mm = (corner + 0.4) * leg_mm
        rest = remainder(zigzag, true_mm - 0.027 * corner, position)
        assert rest is not None
        assert zigzag.length_mm - rest.length_mm == pytest.approx(true_mm - OVERLAP_MM, abs=1e-6)


@given(st.integers(0, 2**32 - 1), st.floats(0.0, 1.0))
def test_drawn_and_rest_are_the_whole(seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    stroke = Stroke(np.cumsum(rng.normal(0, 2, (rng.integers(2, 20), 2)), axis=0))
    drawn_mm = share * stroke.length_mm
    rest = remainder(stroke, drawn_mm, None)
    left_mm = 0.0 if rest is None else rest.length_mm
    assert left_mm == pytest.approx(min(stroke.length_mm - drawn_mm + OVERLAP_MM, stroke.length_mm), abs=OVERLAP_MM + 1e-6)
    if rest is not None:
        np.testing.assert_array_equal(rest.points_mm[-1], stroke.points_mm[-1])
