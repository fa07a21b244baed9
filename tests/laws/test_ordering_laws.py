"""Laws of the order: what is drawn stays what was drawn, no route is worse than the file's, and chance has no part in it."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.geometry.stroke import Layer, Stroke
from planning.motion.limits import Kinematics, Limits
from planning.ordering.arrange import OrderOptions, order_layers, travel
from planning.ordering.crowds import SAME_LINE_MM
from planning.ordering.greedy import greedy_route
from planning.ordering.improve import Costs, Effort, improve, near_nodes
from planning.ordering.kicks import kick
from planning.ordering.metric import Metric, euclidean, slowest_motor, travel_time
from planning.ordering.tour import Tour

HOME = np.zeros(2)
COREXY = Kinematics(np.array([[80.0, 80.0], [80.0, -80.0]]), 25000.0)
METRICS = [euclidean, slowest_motor(COREXY.steps_per_mm), travel_time(COREXY, Limits(200.0, 2000.0, 1e5))]
COLORS = (None, "#000000", "#ff0000")


@st.composite
def drawings(draw: st.DrawFn, steps: tuple[float, ...] = (0.04, 1.0, 7.3)) -> list[Layer]:
    """Layers with lines, dots, closed strokes and repeated parts; often on a coarse grid, so that ends and lines meet."""
    step = draw(st.sampled_from(steps))
    number = st.integers(-4, 4)
    layers = []
    for k in range(draw(st.integers(1, 3))):
        strokes = []
        for _ in range(draw(st.integers(0, 12))):
            points = np.array(draw(st.lists(st.tuples(number, number), min_size=1, max_size=6)), dtype=float) * step
            if draw(st.booleans()):
                points = np.concatenate((points, points[:1]))
            known = draw(st.booleans())
            corners = np.array(draw(st.lists(st.booleans(), min_size=len(points), max_size=len(points)))) if known else None
            strokes.append(Stroke(points, corners, draw(st.sampled_from(COLORS))))
        if strokes and draw(st.booleans()):
            strokes.append(strokes[draw(st.integers(0, len(strokes) - 1))].reversed())
        layers.append(Layer(k + 1, f"{9 - k} layer", tuple(strokes)))
    return layers


def ink(strokes: Sequence[Stroke]) -> shapely.Geometry:
    """All that is drawn, as one geometry; dots are points."""
    parts = [shapely.Point(s.points_mm[0]) if s.is_dot else shapely.LineString(s.points_mm) for s in strokes]
    return shapely.union_all(parts, grid_size=1e-9) if parts else shapely.GeometryCollection()


def same_ink(before: Sequence[Stroke], after: Sequence[Stroke], slack_mm: float) -> bool:
    """Whether each lies within `slack_mm` of the other: nothing is missing and nothing is added, but links."""
    a, b = ink(before), ink(after)
    if a.is_empty or b.is_empty:
        return bool(a.is_empty == b.is_empty)
    return bool(shapely.buffer(b, slack_mm).covers(a) and shapely.buffer(a, slack_mm).covers(b))


def length(strokes: Sequence[Stroke]) -> float:
    return sum(s.length_mm for s in strokes)


OPTIONS = list(
    itertools.product(
        ("none", "greedy", "best", "random"),
        (-1.0, 0.0, 0.1),
        (False, True),
        ("random", "same", "hidden", "free"),
        (None, 1.7),
        (False, True),
    )
)


@settings(max_examples=50, deadline=None)
@given(
    layers=drawings(),
    chosen=st.sampled_from(OPTIONS),
    reverse=st.booleans(),
    by=st.sampled_from(["layer", "number", "color"]),
    costs=st.sampled_from(METRICS),
    end=st.sampled_from([None, np.array([30.0, 5.0])]),
)
def test_what_is_drawn_stays_what_was_drawn(
    layers: list[Layer], chosen: tuple, reverse: bool, by: str, costs: Metric, end: np.ndarray | None
) -> None:
    order, tolerance, keep, seams, longest, interleave = chosen
    options = OrderOptions(
        order, 0.01, tolerance, keep, seams, reverse=reverse, interleave=interleave, max_stroke_mm=longest, by=by
    )
    after = order_layers(layers, options, HOME, costs, end)
    before_by_color = colours(layers)
    after_by_color = colours(after)
    assert before_by_color.keys() == after_by_color.keys()
    slack = max(tolerance, 0.0) + 3 * SAME_LINE_MM + 1e-6
    for color, strokes in before_by_color.items():
        assert same_ink(strokes, after_by_color[color], slack)
    if by != "color":
        in_turn = sorted(layers, key=lambda layer: -layer.number) if by == "number" else layers
        expected = [layer.number for layer in in_turn][:: -1 if reverse else 1]
        assert [layer.number for layer in after] == expected
        for layer in after:
            assert same_ink(layers[layer.number - 1].strokes, layer.strokes, slack)
    for layer in after:
        runs = [color for color, _ in itertools.groupby(layer.strokes, key=lambda s: s.color)]
        assert len(runs) == len(set(runs)), "the strokes of one colour stay together"
        if longest is not None:
            assert all(s.length_mm <= longest * (1 + 1e-9) for s in layer.strokes)


def colours(layers: Sequence[Layer]) -> dict[str | None, list[Stroke]]:
    found: dict[str | None, list[Stroke]] = {}
    for layer in layers:
        for stroke in layer.strokes:
            found.setdefault(stroke.color, []).append(stroke)
    return found


@settings(max_examples=40, deadline=None)
@given(
    layers=drawings(),
    order=st.sampled_from(["none", "greedy", "best", "random"]),
    seams=st.sampled_from(["random", "same", "hidden", "free"]),
)
def test_with_duplicates_kept_the_length_is_kept(layers: list[Layer], order: str, seams: str) -> None:
    """Every line is drawn as often as the file says: without joins the lengths and corner marks add up exactly."""
    after = order_layers(layers, OrderOptions(order, 0.01, -1.0, True, seams), HOME)
    for layer, arranged in zip(layers, after, strict=True):
        assert len(arranged.strokes) == len(layer.strokes)
        assert sorted(segments(arranged.strokes)) == sorted(segments(layer.strokes))


def segments(strokes: Sequence[Stroke]) -> list[tuple]:
    """Every segment of every stroke with its colour, whichever way it is drawn; a dot is a segment from itself to itself."""
    found = []
    for s in strokes:
        points = s.points_mm.tolist() if len(s.points_mm) > 1 else s.points_mm.tolist() * 2
        found += [(str(s.color), *sorted((tuple(a), tuple(b)))) for a, b in itertools.pairwise(points)]
    return found


@settings(max_examples=40, deadline=None)
@given(layers=drawings(), tolerance=st.sampled_from([0.0, 0.1]), options=st.data())
def test_joins_add_no_more_than_the_gaps_they_close(layers: list[Layer], tolerance: float, options: st.DataObject) -> None:
    order = options.draw(st.sampled_from(["none", "greedy", "best"]))
    after = order_layers(layers, OrderOptions(order, 0.01, tolerance, True, "free"), HOME)
    for layer, arranged in zip(layers, after, strict=True):
        links = len(layer.strokes) - len(arranged.strokes) + sum(not s.is_closed for s in layer.strokes)
        added = length(arranged.strokes) - length(layer.strokes)
        assert -1e-9 <= added <= max(links, 0) * tolerance + 1e-9


@settings(max_examples=40, deadline=None)
@given(layers=drawings(steps=(1.0, 7.3)))
def test_drawn_once_means_once(layers: list[Layer]) -> None:
    after = order_layers(layers, OrderOptions("greedy", 0.01, -1.0), HOME)
    for layer, arranged in zip(layers, after, strict=True):
        for color, strokes in colours([layer]).items():
            lines = [s for s in colours([arranged]).get(color, []) if not s.is_dot]
            union = ink([s for s in strokes if not s.is_dot])
            assert length(lines) == pytest.approx(union.length, abs=0.02 + 0.02 * union.length)


@settings(max_examples=40, deadline=None)
@given(layers=drawings(), tolerance=st.sampled_from([-1.0, 0.0, 0.1]), seams=st.sampled_from(["same", "hidden", "free"]))
def test_never_worse_than_the_file(layers: list[Layer], tolerance: float, seams: str) -> None:
    """By whatever travel costs."""
    one = [Layer(1, "all", colours(layers)[color], color) for color in list(colours(layers))[:1]]
    for end_mm, metric in itertools.product((None, np.array([30.0, 5.0])), METRICS):
        if not one:
            return
        file_cost = travel(one[0].strokes, HOME, metric, end_mm)
        for order in ("greedy", "best"):
            after = order_layers(one, OrderOptions(order, 0.01, tolerance, True, seams), HOME, metric, end_mm)
            assert travel(after[0].strokes, HOME, metric, end_mm) <= file_cost * (1 + 1e-9) + 1e-9


@settings(max_examples=20, deadline=None)
@given(layers=drawings(), seed=st.integers(0, 5), seams=st.sampled_from(["random", "hidden"]))
def test_the_same_seed_gives_the_same_order(layers: list[Layer], seed: int, seams: str) -> None:
    options = OrderOptions(seed=seed, time_budget_s=0.02, seams=seams)
    metric = slowest_motor(np.array([[80.0, 80.0], [80.0, -80.0]]))
    first, second = (order_layers(layers, options, HOME, metric) for _ in range(2))
    for a, b in zip(first, second, strict=True):
        assert [s.points_mm.tolist() for s in a.strokes] == [s.points_mm.tolist() for s in b.strokes]
        assert [None if s.corners is None else s.corners.tolist() for s in a.strokes] == [
            None if s.corners is None else s.corners.tolist() for s in b.strokes
        ]


@settings(max_examples=40, deadline=None)
@given(data=st.data(), count=st.integers(1, 60), free_end=st.booleans())
def test_improving_keeps_one_tour_and_counts_its_gain(data: st.DataObject, count: int, free_end: bool) -> None:
    rng = np.random.default_rng(data.draw(st.integers(0, 1000)))
    points = rng.integers(0, data.draw(st.sampled_from([3, 1000])), (2 * count + 2, 2)).astype(float)
    costs = Costs(points, euclidean, free_end)

    def total(route: np.ndarray) -> float:
        return float(costs(route ^ 1, np.roll(route, -1)).sum())

    route = greedy_route(points, euclidean, free_end)
    assert route[0] == 0
    assert sorted(route >> 1) == list(range(count + 1))
    tour = Tour(route)
    near = near_nodes(points, 6, free_end)
    done = improve(tour, near, costs, Effort(6, data.draw(st.integers(2, 5)), 8), np.arange(len(points)))
    improved = tour.route()
    assert improved[0] == 0
    assert sorted(improved >> 1) == list(range(count + 1))
    assert total(route) - total(improved) == pytest.approx(sum(e.gain for e in done), abs=1e-6)
    saved = kick(tour, near, costs, Effort(5, 4, 6), 40, rng)
    kicked = tour.route()
    assert sorted(kicked >> 1) == list(range(count + 1))
    assert saved >= 0
    assert total(improved) - total(kicked) == pytest.approx(saved, abs=1e-6)
