"""Strokes side by side in arrays are the strokes that they are made of."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planning.geometry.stroke import Stroke
from planning.geometry.strokes import Strokes, all_points_mm, by_color, chosen, ends_mm, lengths_mm, sizes, together

PALETTE = ("#ff0000", None, "#0000ff")


def arrays(count: int, seed: int) -> Strokes:
    rng = np.random.default_rng(seed)
    size = rng.integers(1, 6, count)
    total = int(size.sum())
    corners = rng.random(total) < 0.5
    return Strokes(
        rng.uniform(0, 200, (total, 2)), corners, np.concatenate(([0], np.cumsum(size))), rng.integers(0, 3, count), PALETTE
    )


def same(one: Sequence[Stroke], other: Sequence[Stroke]) -> bool:
    return len(one) == len(other) and all(
        np.array_equal(a.points_mm, b.points_mm) and np.array_equal(a.corners, b.corners) and a.color == b.color  # type: ignore[arg-type]
        for a, b in zip(one, other, strict=True)
    )


@given(st.integers(0, 30), st.integers(0, 1000))
def test_what_is_asked_of_all_is_what_each_one_says(count: int, seed: int) -> None:
    strokes = arrays(count, seed)
    each = [strokes[i] for i in range(count)]
    assert same(list(strokes), each)
    assert sizes(strokes).tolist() == sizes(each).tolist() == [len(stroke.points_mm) for stroke in each]
    assert np.array_equal(ends_mm(strokes), ends_mm(each))
    assert np.array_equal(all_points_mm(strokes), all_points_mm(each))
    assert lengths_mm(strokes) == pytest.approx([stroke.length_mm for stroke in each])
    assert lengths_mm(each) == pytest.approx([stroke.length_mm for stroke in each])
    groups, groups_of_each = by_color(strokes), by_color(each)
    assert len(groups) == len(groups_of_each)
    assert all(same(one, other) for one, other in zip(groups, groups_of_each, strict=True))
    assert strokes.colors == tuple(dict.fromkeys(stroke.color for stroke in each))


@given(st.integers(1, 30), st.integers(0, 1000), st.data())
def test_parts_are_parts_of_the_list(count: int, seed: int, data: st.DataObject) -> None:
    strokes = arrays(count, seed)
    each = list(strokes)
    cut = slice(
        *(data.draw(st.none() | st.integers(-count - 1, count + 1)) for _ in range(2)), data.draw(st.sampled_from([1, 2, -1]))
    )
    assert same(strokes[cut], each[cut])
    rows = np.array(data.draw(st.lists(st.integers(0, count - 1), max_size=10)), dtype=np.int64)
    assert same(chosen(strokes, rows), chosen(each, rows))
    at = data.draw(st.integers(0, count))
    assert same(together([strokes[:at], strokes[at:]]), each)
    assert same(together([strokes[:at], each[at:]]), each)
    assert same(strokes[-1:], [strokes[-1]])


def test_strokes_that_do_not_fit_are_refused() -> None:
    points, corners, color = np.zeros((3, 2)), np.zeros(3, dtype=bool), np.zeros(2, dtype=np.int64)
    for offset in ([0, 1], [0, 3, 3], [0, 1, 2], [1, 2, 3]):
        with pytest.raises(ValueError, match="offset"):
            Strokes(points, corners, np.array(offset), color, PALETTE)
    with pytest.raises(ValueError, match="do not match"):
        Strokes(points, corners[:2], np.array([0, 1, 3]), color, PALETTE)
    with pytest.raises(ValueError, match="finite"):
        Strokes(np.full((3, 2), np.nan), corners, np.array([0, 1, 3]), color, PALETTE)
    with pytest.raises(IndexError):
        arrays(3, 1)[3]
