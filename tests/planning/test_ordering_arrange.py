"""The order on drawings whose best answer is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from planning.geometry.stroke import Layer, Stroke
from planning.motion.limits import Kinematics, Limits
from planning.motion.travel import travel as plan_travel
from planning.ordering.arrange import OrderOptions, order_layers, travel
from planning.ordering.cutting import cut, interleaved
from planning.ordering.duplicates import draw_once
from planning.ordering.greedy import greedy_route
from planning.ordering.joining import join_strokes
from planning.ordering.junctions import junctions
from planning.ordering.metric import euclidean, slowest_motor, travel_time
from planning.ordering.seams import overdraw, places, start_at

HOME = np.zeros(2)


def line(*points: tuple[float, float], color: str | None = None) -> Stroke:
    return Stroke(np.array(points, dtype=float), None, color)


def layer(*strokes: Stroke) -> Layer:
    return Layer(1, "one", strokes)


def ordered(strokes: list[Stroke], **options: object) -> list[Stroke]:
    return list(order_layers([layer(*strokes)], OrderOptions(**options), HOME)[0].strokes)  # type: ignore[arg-type]


def points(strokes: list[Stroke]) -> list[list[list[float]]]:
    return [s.points_mm.tolist() for s in strokes]


def circle(x: float, y: float, r: float, count: int = 40) -> Stroke:
    angle = np.linspace(0, 2 * np.pi, count + 1)
    ring = np.stack((x + r * np.cos(angle), y + r * np.sin(angle)), axis=1)
    ring[-1] = ring[0]
    return Stroke(ring, np.r_[True, np.zeros(count - 1, bool), True])


def square(x: float, y: float, side: float) -> Stroke:
    ring = np.array([[x, y], [x + side, y], [x + side, y + side], [x, y + side], [x, y]])
    return Stroke(ring, np.ones(5, bool))


def grid(count: int, seed: int = 0) -> list[Stroke]:
    edges = [line((i, j), (i + 1, j)) for i in range(count - 1) for j in range(count)]
    edges += [line((j, i), (j, i + 1)) for i in range(count - 1) for j in range(count)]
    return [edges[k] for k in np.random.default_rng(seed).permutation(len(edges))]


def test_shuffled_dashes_come_out_in_a_row() -> None:
    dashes = [line((x, 0), (x + 0.5, 0)) for x in range(1, 60)]
    shuffled = [dashes[k] if k % 3 else dashes[k].reversed() for k in np.random.default_rng(1).permutation(len(dashes))]
    for order in ("greedy", "best"):
        assert points(ordered(shuffled, order=order)) == points(dashes)


@pytest.mark.parametrize("count", [2, 3, 8, 15])
def test_a_grid_takes_half_as_many_strokes_as_it_has_odd_nodes(count: int) -> None:
    edges = grid(count)
    odd = 4 * (count - 2)
    assert len(ordered(edges)) == max(1, odd // 2)


def test_the_house_of_santa_claus_is_one_stroke() -> None:
    house = [((0, 0), (1, 0)), ((1, 0), (1, 1)), ((1, 1), (0, 1)), ((0, 1), (0, 0)), ((0, 0), (1, 1)), ((1, 0), (0, 1))]
    house += [((0, 1), (0.5, 1.5)), ((0.5, 1.5), (1, 1))]
    assert len(ordered([line(*edge) for edge in house])) == 1


def test_two_rings_that_share_a_junction_are_one_stroke() -> None:
    eight = [
        line((0, 0), (1, 1), (2, 0)),
        line((2, 0), (1, -1), (0, 0)),
        line((0, 0), (-1, 1), (-2, 0)),
        line((-2, 0), (-1, -1), (0, 0)),
    ]
    joined = join_strokes(eight, 0.1)
    assert len(joined) == 1
    assert joined[0].is_closed


def test_a_ring_and_the_stick_that_ends_on_it_are_one_stroke() -> None:
    ring = circle(0, 0, 5)
    stick = Stroke(np.array([[0.0, 20.0], [0.0, 5.05]]), np.ones(2, bool))
    assert len(ordered([ring, stick])) == 1
    assert len(ordered([ring, stick], seams="same")) == 2, "the file's seam is elsewhere"


def test_a_crossing_is_drawn_straight_through() -> None:
    arms = [line((0, 0), (1, 0)), line((0, 0), (0, 1)), line((0, 0), (-1, 0)), line((0, 0), (0, -1))]
    joined = join_strokes(arms, 0.1)
    assert len(joined) == 2
    for stroke in joined:
        first, _, last = stroke.points_mm
        assert (first == -last).all()


def test_ends_further_apart_than_the_tolerance_stay_apart() -> None:
    assert len(join_strokes([line((0, 0), (1, 0)), line((1.0999, 0), (2, 0))], 0.1)) == 1
    assert len(join_strokes([line((0, 0), (1, 0)), line((1.1001, 0), (2, 0))], 0.1)) == 2


def test_a_chain_of_near_points_is_no_junction() -> None:
    """Ends 0.06 mm apart in a row: no two of a junction are further apart than 0.1 mm."""
    ends = np.array([[0.06 * k, 0.0] for k in range(50)])
    junction = junctions(ends, 0.1)
    for number in set(junction.tolist()):
        assert np.ptp(ends[junction == number][:, 0]) <= 0.1


def test_a_smooth_join_is_no_corner_and_a_bend_is() -> None:
    whole = circle(0, 0, 5)
    halves = [
        Stroke(whole.points_mm[:21], np.r_[True, whole.corners[1:20], True]),
        Stroke(whole.points_mm[20:], whole.corners[20:]),
    ]
    halves[1].corners[0] = True
    joined = join_strokes(halves, 0.1)[0]
    assert joined.is_closed
    assert joined.corners.sum() == 2, "only the two ends"
    bent = join_strokes([halves[0], Stroke(np.array([[-5.0, 0.0], [-9.0, 0.0]]), np.ones(2, bool))], 0.1)[0]
    assert bent.corners.sum() == 3


def test_colour_goes_along_with_joins_cuts_and_seams() -> None:
    red = [line((0, 0), (1, 0), color="#ff0000"), line((1, 0), (5, 0), color="#ff0000")]
    blue = [line((0, 0), (0, 3), color="#0000ff")]
    result = ordered([red[0], *blue, red[1]], max_stroke_mm=2.0)
    assert [s.color for s in result] == ["#ff0000"] * 3 + ["#0000ff"] * 2
    assert start_at(Stroke(square(0, 0, 1).points_mm, None, "#0000ff"), 2).color == "#0000ff"


def test_layers_stay_in_order_and_by_color_regroups_them() -> None:
    layers = [
        Layer(1, "a", (line((9, 9), (8, 9), color="#111111"), line((0, 0), (0, 1), color="#222222"))),
        Layer(2, "b", (line((5, 5), (6, 5), color="#222222"), line((3, 3), (3, 4), color="#111111"))),
    ]
    assert [x.number for x in order_layers(layers, OrderOptions(), HOME)] == [1, 2]
    assert [x.number for x in order_layers(layers, OrderOptions(reverse=True), HOME)] == [2, 1]
    by_color = order_layers(layers, OrderOptions(by="color"), HOME)
    assert [(x.name, x.color, len(x.strokes)) for x in by_color] == [("#111111", "#111111", 2), ("#222222", "#222222", 2)]


def test_an_empty_layer_stays() -> None:
    assert order_layers([Layer(3, "none", ())], OrderOptions(), HOME) == (Layer(3, "none", ()),)


def test_the_end_counts_when_the_pen_goes_home() -> None:
    dashes = [line((x, y), (x + 0.5, y)) for x in range(1, 12) for y in (0.0, 1.0, 2.0)]
    there = order_layers([layer(*dashes)], OrderOptions(), HOME)[0].strokes
    back = order_layers([layer(*dashes)], OrderOptions(), HOME, end_mm=HOME)[0].strokes
    assert travel(back, HOME, end_mm=HOME) < travel(there, HOME, end_mm=HOME)
    assert travel(back, HOME) >= travel(there, HOME)


def test_the_metric_is_what_is_minimised() -> None:
    rng = np.random.default_rng(3)
    dots = [line(tuple(p)) for p in rng.random((200, 2)) * 100]
    corexy = slowest_motor(np.array([[80.0, 80.0], [80.0, -80.0]]))
    for_corexy = order_layers([layer(*dots)], OrderOptions(), HOME, corexy)[0].strokes
    straight = order_layers([layer(*dots)], OrderOptions(), HOME)[0].strokes
    assert travel(for_corexy, HOME, corexy) < travel(straight, HOME, corexy)
    assert travel(straight, HOME) < travel(for_corexy, HOME)


@pytest.mark.parametrize("seed", range(3))
def test_best_is_near_the_known_tour_of_uniform_dots(seed: int) -> None:
    """Random uniform points: the best tour of 1000 is 0.7313 sqrt(n A) (Johnson and McGeoch, 1997); ours within 12 %."""
    dots = [line(tuple(p)) for p in np.random.default_rng(seed).random((1000, 2)) * 100]
    cost = travel(ordered(dots, time_budget_s=1.0), HOME)
    assert cost <= 1.12 * 0.7313 * np.sqrt(1000 * 100 * 100)


def test_greedy_links_the_shortest_pairs_first() -> None:
    nodes = np.repeat(np.array([[0.0, 0.0], [10, 0], [11, 0], [30, 0], [12, 0]]), 2, axis=0)
    route = greedy_route(nodes, euclidean, free_end=True)
    assert (route >> 1).tolist() == [0, 1, 2, 4, 3]


def test_overlaps_are_drawn_once() -> None:
    result = draw_once([line((0, 0), (10, 0)), line((5, 0), (15, 0)), line((2, 0), (3, 0)), line((20, 0), (-1, 0))])
    assert points(result) == [[[0, 0], [10, 0]], [[10, 0], [15, 0]], [[20, 0], [15, 0]], [[0, 0], [-1, 0]]]


def test_equal_strokes_and_dots_are_drawn_once_unless_kept() -> None:
    strokes = [circle(0, 0, 5), circle(0, 0, 5).reversed(), line((1, 1)), line((1, 1)), line((0, 0), (4, 0), (0, 0))]
    assert sum(s.length_mm for s in draw_once(strokes)) == pytest.approx(circle(0, 0, 5).length_mm + 4)
    assert len(draw_once(strokes)) == 3
    assert len(ordered(strokes, keep_duplicates=True, join_tolerance_mm=-1.0)) == 5


def test_hatches_closer_than_a_line_is_wide_do_not_vanish() -> None:
    """Each is within reach of the one before it, but only what lies on a line that stays may go."""
    hatch = [line((0, 0.003 * k), (10, 0.003 * k)) for k in range(100)]
    left = np.array([s.points_mm[0, 1] for s in draw_once(hatch)])
    assert len(left) == 50
    assert cKDTree(left[:, None]).query(np.arange(100)[:, None] * 0.003)[0].max() <= 0.005


def test_hidden_seams_are_at_the_sharpest_corner() -> None:
    rng = np.random.default_rng(0)
    kite = Stroke(np.array([[0.0, 0.0], [4, 2], [20, 0], [4, -2], [0, 0]]), np.ones(5, bool))
    assert places(kite, "hidden", rng).tolist() == [2]
    assert places(square(0, 0, 2), "hidden", rng).tolist() == [0, 1, 2, 3]
    assert len(places(circle(0, 0, 2), "hidden", rng)) == 40
    assert places(kite, "same", rng).tolist() == [0]


def test_seams_move_to_where_the_pen_comes_by() -> None:
    circles = [circle(20.0 * k, 0, 9) for k in range(1, 6)]
    cost = travel(ordered(circles, seams="free"), HOME)
    assert cost == pytest.approx(91), "as far as the last circle's near side, and no step back"
    assert cost < travel(ordered(circles, seams="same"), HOME)


def test_a_moved_seam_leaves_a_smooth_curve_smooth() -> None:
    moved = start_at(circle(0, 0, 5), 13)
    assert moved.is_closed
    assert moved.corners.sum() == 2
    cornered = start_at(square(0, 0, 1), 1)
    assert cornered.corners.all()
    assert cornered.points_mm[0].tolist() == [1.0, 0.0]


def test_overdraw_goes_on_past_the_start() -> None:
    assert points([overdraw(square(0, 0, 2), 3.0)])[0][-3:] == [[0, 0], [2, 0], [2, 1]]
    assert overdraw(square(0, 0, 2), 99.0).length_mm == pytest.approx(16)
    assert overdraw(line((0, 0), (5, 0)), 3.0).length_mm == 5


def test_long_strokes_are_cut_evenly() -> None:
    pieces = cut(line((0, 0), (10, 0), (10, 2)), 5.0)
    assert points(pieces) == [[[0, 0], [4, 0]], [[4, 0], [8, 0]], [[8, 0], [10, 0], [10, 2]]]
    assert points(cut(line((0, 0), (5, 0), (10, 0)), 5.0)) == [[[0, 0], [5, 0]], [[5, 0], [10, 0]]]
    assert points(cut(line((3, 3)), 5.0)) == [[[3, 3]]]


def test_interleaving_goes_out_on_one_half_and_back_on_the_other() -> None:
    dashes = [line((x, 0), (x + 0.5, 0)) for x in range(6)]
    assert [s.points_mm[0, 0] for s in interleaved(dashes)] == [0, 2, 4, 5.5, 3.5, 1.5]


def test_none_keeps_the_order_and_reverse_turns_it_round() -> None:
    strokes = [line((9, 9), (8, 8)), line((0, 0), (1, 1)), line((5, 0), (5, 1))]
    assert points(ordered(strokes, order="none")) == points(strokes)
    assert points(ordered(strokes, order="none", reverse=True)) == points(strokes[::-1])


@pytest.mark.parametrize(
    "wrong",
    [{"time_budget_s": -1.0}, {"join_tolerance_mm": np.nan}, {"overdraw_mm": -0.1}, {"max_stroke_mm": 0.0}],
)
def test_options_out_of_range_are_refused_by_name(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        OrderOptions(**wrong)  # type: ignore[arg-type]


def test_a_late_clock_ends_the_work_and_leaves_a_whole_order() -> None:
    ticks = iter(np.arange(0.0, 1e6, 100.0))
    dots = [line(tuple(p)) for p in np.random.default_rng(0).random((300, 2)) * 100]
    late = order_layers([layer(*dots)], OrderOptions(), HOME, clock=lambda: float(next(ticks)))[0].strokes
    assert sorted(points(list(late))) == sorted(points(dots))
    assert travel(late, HOME) <= travel(dots, HOME)


def test_crowds_at_one_point_are_not_searched_pair_by_pair() -> None:
    """Thousands of equal dots, of equal lines and of spokes: each took minutes when every pair was looked at."""
    same = [line((5, 5))] * 4000
    assert travel(ordered(same, order="greedy", keep_duplicates=True), HOME) == pytest.approx(np.hypot(5, 5))
    assert len(ordered([line((5, 5), (9, 9))] * 4000)) == 1
    spokes = [line((0, 0), (100 * np.cos(k / 500), 100 * np.sin(k / 500))) for k in range(3141)]
    assert len(ordered(spokes, order="greedy")) == 1571


def test_a_short_retrace_is_not_worth_a_lift_and_a_long_one_is() -> None:
    first = line((0, 0), (10, 0))
    assert len(draw_once([first, line((4, 3), (4, 0), (4.4, 0), (4.4, 3))])) == 2
    assert len(draw_once([first, line((4, 3), (4, 0), (4.6, 0), (4.6, 3))])) == 3


@pytest.mark.long
def test_a_million_segments_pass() -> None:
    rng = np.random.default_rng(0)
    begin = rng.random((20_000, 1, 2)) * 800
    walks = np.concatenate((begin, begin + np.cumsum(rng.normal(size=(20_000, 50, 2)) * 0.5, axis=1)), axis=1)
    strokes = [Stroke(points) for points in walks]
    result = ordered(strokes, order="greedy", keep_duplicates=True)
    assert sum(len(s.points_mm) for s in result) >= 20_000 * 51 - (20_000 - len(result))
    assert travel(result, HOME) < 0.01 * travel(strokes, HOME)


def test_the_time_of_a_travel_is_what_travel_takes() -> None:
    """Within the ticks that the plan rounds up to, on a CoreXY machine, from ten micrometres to ten metres."""
    limits, kinematics = Limits(200.0, 2000.0, 1e5), Kinematics(np.array([[80.0, 80.0], [80.0, -80.0]]), 25000.0)
    metric, far = travel_time(kinematics, limits), ((-9e3, -9e3), (9e3, 9e3))
    rng = np.random.default_rng(0)
    ways = rng.normal(size=(300, 2)) * np.geomspace(3e-2, 4000, 300)[:, None]
    known = [plan_travel(np.zeros(2), way, limits, kinematics, far).total_s for way in ways]
    np.testing.assert_allclose(metric(np.zeros((300, 2)), ways), known, atol=4e-4)
    assert metric(np.zeros((1, 2)), np.zeros((1, 2)))[0] == 0
    np.testing.assert_allclose(metric(ways, ways[::-1]), metric(ways[::-1], ways))


def test_a_layer_ends_where_the_next_one_begins() -> None:
    """A row that could be drawn either way round, and a layer at one end of it."""
    row = tuple(Stroke(np.array([[10.0 * k, 50.0], [10.0 * k + 4, 50.0]])) for k in range(10))
    for x in (-30.0, 130.0):
        next_one = Layer(2, "next", (Stroke(np.array([[x, 50.0], [x, 60.0]])),))
        after = order_layers([Layer(1, "row", row), next_one], OrderOptions(join_tolerance_mm=-1.0), np.array([47.0, 0.0]))
        assert abs(after[0].strokes[-1].points_mm[-1, 0] - x) < 50
