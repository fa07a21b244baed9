"""Very many segments on one line are drawn once, without looking at each pair of them."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable, Sequence

import numpy as np
import pytest
import shapely

from planning.geometry.stroke import Stroke
from planning.ordering import duplicates
from planning.ordering.crowds import MANY, SAME_LINE_MM, Crowd, Stretches, find_crowds
from planning.ordering.duplicates import LEAST_GAP_MM, draw_once

Array = np.ndarray

# Pair by pair, 1,000 segments on one line already took 97 to 218 MB, and four times that for twice as many.
COUNT = 5_000
MOST_BYTES = 30_000_000

ORIGIN = np.array([13.7, 41.3])


def clipped(count: int) -> Array:
    """Anywhere on the border of the page, where points beyond it were moved."""
    return np.random.default_rng(1).random((count, 2)) * 300


def of_different_extents(count: int) -> Array:
    """Each a bit shorter or longer than another, in no order."""
    more = np.random.default_rng(2).permutation(count) * 1e-3
    return np.stack((100 - more, 150 + more), axis=1)


def spokes_in_one_direction(count: int) -> Array:
    return np.stack((np.zeros(count), 1 + np.random.default_rng(3).permutation(count) * 200 / count), axis=1)


def tiny_ones_and_then_long_ones(count: int) -> Array:
    """Tiny ones that do not touch, and long ones over all of them."""
    rng, half = np.random.default_rng(4), count // 2
    begin = np.arange(half) * 0.05
    beyond = rng.random((half, 2)) * 10
    return np.concatenate((np.stack((begin, begin + 0.02), axis=1), beyond * [-1, 1] + [0, 0.05 * half]))


CASES = [clipped, of_different_extents, spokes_in_one_direction, tiny_ones_and_then_long_ones]


def on_line(ends: Array, angle: float, decimals: int | None = None) -> list[Stroke]:
    """Strokes from and to these places (n, 2) along a line."""
    points = ORIGIN + ends[:, :, None] * np.array([np.cos(angle), np.sin(angle)])
    return [Stroke(p if decimals is None else p.round(decimals)) for p in points]


def no_crowds(*_: Array) -> list[Crowd]:
    return []


def once_and_peak(strokes: Sequence[Stroke]) -> tuple[list[Stroke], int]:
    tracemalloc.start()
    try:
        return draw_once(strokes), tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def furthest_mm(strokes: Sequence[Stroke], others: Sequence[Stroke]) -> float:
    """How far the strokes get from the others, looked at every 0.5 mm and at their points."""
    points = shapely.get_coordinates(shapely.segmentize([shapely.LineString(s.points_mm) for s in strokes], 0.5))
    tree = shapely.STRtree([shapely.LineString(s.points_mm) for s in others])
    return float(tree.query_nearest(shapely.points(points), return_distance=True, all_matches=False)[1].max())


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize(("angle", "decimals"), [(0.0, None), (np.pi / 2, None), (0.7, None), (2.9, 3)])
def test_a_crowd_on_one_line_is_drawn_once(case: Callable[[int], Array], angle: float, decimals: int | None) -> None:
    ends = case(COUNT)
    strokes = on_line(np.concatenate((ends[:100], ends)), angle, decimals)
    result, peak = once_and_peak(strokes)
    assert peak < MOST_BYTES
    along = np.array([np.cos(angle), np.sin(angle)])
    begin, end = np.sort(np.array([(s.points_mm[[0, -1]] - ORIGIN) @ along for s in result]), axis=1).T
    file_ends = np.array([(s.points_mm - ORIGIN) @ along for s in strokes])
    order = np.argsort(begin)
    begin, end = begin[order], end[order]
    so_far = np.maximum.accumulate(end)
    assert (begin[1:] - so_far[:-1]).max(initial=0.0) <= SAME_LINE_MM, "no gap"
    twice = np.minimum(end[1:], so_far[:-1]) - begin[1:]
    assert twice.max(initial=0.0) < LEAST_GAP_MM, "only where leaving it out is not worth a lift"
    tiny = 0.02 * (COUNT // 2) if case is tiny_ones_and_then_long_ones else 0.0  # a long one goes over all of them
    assert twice[twice > 0].sum() == pytest.approx(tiny, abs=LEAST_GAP_MM)
    assert begin[0] == pytest.approx(file_ends.min(), abs=SAME_LINE_MM)
    assert so_far[-1] == pytest.approx(file_ends.max(), abs=SAME_LINE_MM)
    assert furthest_mm(strokes[:: COUNT // 100], result) <= SAME_LINE_MM


@pytest.mark.parametrize("case", CASES)
def test_crowds_come_out_as_pair_by_pair(case: Callable[[int], Array], monkeypatch: pytest.MonkeyPatch) -> None:
    """As few as can be gone through both ways. What is left is cut in the same places, within what counts as one place."""
    ends = case(120)
    strokes = on_line(np.concatenate((ends[:3, ::-1], ends)), 0.7)  # three of them are there twice
    found = draw_once(strokes)
    assert find_crowds(*np.stack([s.points_mm for s in strokes], axis=1))
    monkeypatch.setattr(duplicates, "find_crowds", no_crowds)
    expected = draw_once(strokes)
    assert len(found) == len(expected)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one.points_mm, other.points_mm, atol=SAME_LINE_MM)


def test_strokes_that_only_end_on_a_crowd_are_let_be() -> None:
    """In from the page, along its border, and back: what leaves the border stays whole."""
    rng = np.random.default_rng(5)
    points = rng.random((1000, 4, 2)) * [300.0, 190.0]
    points[:, 1:3, 1] = 200.0
    strokes = [Stroke(p) for p in points]
    result, peak = once_and_peak(strokes)
    assert peak < MOST_BYTES
    legs = float(np.hypot(*(points[:, ::3] - points[:, 1:3]).reshape(-1, 2).T).sum())
    border = points[:, 1:3, 0].max() - points[:, 1:3, 0].min()
    assert sum(s.length_mm for s in result) == pytest.approx(legs + border, abs=2 * LEAST_GAP_MM)
    assert furthest_mm(strokes[::40], result) <= SAME_LINE_MM


@pytest.mark.parametrize("seed", range(8))
def test_what_lies_beside_a_crowd_goes_only_where_something_near_it_stays(seed: int) -> None:
    """Lines at up to 0.006 mm from a crowd's, and slightly turned, before, among and after its own."""
    rng = np.random.default_rng(seed)
    along = rng.random((300, 2)) * 40
    aside = np.where(rng.random((300, 1)) < 0.6, 0.0, rng.uniform(-0.006, 0.006, (300, 1))) + np.zeros((1, 2))
    aside += np.where(rng.random((300, 1)) < 0.1, rng.uniform(-0.003, 0.003, (300, 2)), 0.0)
    points = np.stack((along, aside), axis=2) @ np.array([[0.6, 0.8], [-0.8, 0.6]])
    strokes = [Stroke(p) for p in points]
    assert find_crowds(points[:, 0], points[:, 1])
    result = draw_once(strokes)
    assert furthest_mm(strokes, result) <= SAME_LINE_MM * 1.001
    assert furthest_mm(result, strokes) <= 1e-9
    drawn = sum(s.length_mm for s in result)
    assert drawn <= 6 * 40, "at most a few lines side by side are left of 4,000 mm"


def test_a_row_of_slivers_does_not_creep_away() -> None:
    """Each goes 0.004 mm further than the one before, which is less than a line that counts: together they do."""
    ends = np.stack((np.zeros(1000), 10 + 0.004 * np.arange(1000)), axis=1)
    strokes = on_line(ends, 0.3)
    result = draw_once(strokes)
    assert furthest_mm(strokes, result) <= SAME_LINE_MM
    assert sum(s.length_mm for s in result) == pytest.approx(13.996, abs=SAME_LINE_MM)


def test_few_on_a_line_are_no_crowd_nor_are_many_side_by_side() -> None:
    few = on_line(clipped(MANY), 0.0)
    dashes = on_line(np.stack((np.arange(500.0), np.arange(500.0) + 0.9), axis=1), 0.0)
    for strokes in (few, dashes):
        assert find_crowds(*np.stack([s.points_mm for s in strokes], axis=1)) == []


def test_pairs_beyond_the_ceiling_are_let_be_and_nothing_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nearly one line, but not of one direction: no crowd, and more pairs than are gone through."""
    rng = np.random.default_rng(6)
    points = np.stack((rng.random((300, 2)) * 40, rng.uniform(-0.006, 0.006, (300, 2))), axis=2)
    strokes = [Stroke(p) for p in points]
    monkeypatch.setattr(duplicates, "find_crowds", no_crowds)
    all_pairs = draw_once(strokes)
    monkeypatch.setattr(duplicates, "AT_A_TIME", 500)
    assert [s.points_mm.tolist() for s in draw_once(strokes)] == [s.points_mm.tolist() for s in all_pairs], "in small parts"
    monkeypatch.setattr(duplicates, "MOST_PAIRS", 3000)
    result = draw_once(strokes)
    assert furthest_mm(strokes, result) <= SAME_LINE_MM * 1.001
    drawn, least = (sum(s.length_mm for s in some) for some in (result, all_pairs))
    assert least < drawn < sum(s.length_mm for s in strokes)


def test_stretches_grow_together() -> None:
    stretches = Stretches()
    for low, high in [(5.0, 6.0), (1.0, 2.0), (8.0, 9.0), (2.004, 3.0)]:
        stretches.add(low, high)
    assert list(stretches.within(0.0, 10.0)) == [(1.0, 3.0), (5.0, 6.0), (8.0, 9.0)]
    assert list(stretches.within(3.0, 5.5)) == [(5.0, 6.0)]
    stretches.add(2.5, 8.5)
    assert list(stretches.within(0.0, 10.0)) == [(1.0, 9.0)]
