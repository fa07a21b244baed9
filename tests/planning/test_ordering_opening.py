"""What is drawn first while the rest is still being put in order: at once, in the same order always, and never further."""

from __future__ import annotations

import time

import numpy as np
import pytest

from planning.geometry.stroke import Layer, Stroke
from planning.motion.limits import Kinematics, Limits
from planning.ordering.arrange import OrderOptions, merged, order_in_turn, order_layers, travel
from planning.ordering.metric import travel_time
from planning.ordering.opening import GREATEST_SHARE, Pace, opening, ordering_s

START = np.zeros(2)
PACE = Pace(0.4, 30.0)


def scattered(count: int, seed: int = 1) -> tuple[Stroke, ...]:
    rng = np.random.default_rng(seed)
    begin = rng.uniform(5, 195, (count, 2))
    return tuple(Stroke(np.array(ends)) for ends in zip(begin, begin + rng.normal(0, 2, (count, 2)), strict=True))


def snake(rows: int, columns: int) -> tuple[Stroke, ...]:
    """Short strokes one after the other along a snake: the file's order can hardly be bettered."""
    places = [(x if y % 2 == 0 else columns - 1 - x, y) for y in range(rows) for x in range(columns)]
    ways = [1.0 if y % 2 == 0 else -1.0 for y in range(rows) for _ in range(columns)]
    return tuple(
        Stroke(np.array([[4.0 * x + 1 - way, 4.0 * y], [4.0 * x + 1 + way, 4.0 * y]]))
        for (x, y), way in zip(places, ways, strict=True)
    )


def segments(layers: tuple[Layer, ...]) -> list[tuple[float, ...]]:
    found = []
    for layer in layers:
        for stroke in layer.strokes:
            for a, b in zip(stroke.points_mm[:-1].tolist(), stroke.points_mm[1:].tolist(), strict=True):
                found.append((*min(a, b), *max(a, b)))
    return sorted(found)


def with_pace(**options: object) -> OrderOptions:
    return OrderOptions(pace=PACE, join_tolerance_mm=-1.0, time_budget_s=0.5, **options)  # type: ignore[arg-type]


def test_the_opening_is_there_long_before_the_rest() -> None:
    list(order_in_turn([Layer(1, "a", scattered(50))], with_pace(), START))  # loads what is loaded on first use
    pieces = order_in_turn([Layer(1, "a", scattered(2500))], with_pace(), START)
    began = time.process_time()
    first = next(pieces)
    opened = time.process_time()
    rest = list(pieces)
    ended = time.process_time()
    assert len(rest) == 1
    assert opened - began < (ended - opened) / 5
    nominal_s = ordering_s(rest[0].strokes, best=True, budget_s=0.5)
    assert float(PACE.seconds(first.strokes).sum()) > 1.8 * nominal_s, "drawing the opening lasts longer than ordering the rest"


def test_what_is_in_order_soon_has_no_opening() -> None:
    layers = [Layer(1, "a", scattered(40))]
    assert len(list(order_in_turn(layers, with_pace(), START))) == 1
    several = [Layer(k, "", scattered(30, k)) for k in (1, 2, 3)]
    assert [piece.number for piece in order_in_turn(several, with_pace(), START)] == [1, 2, 3]


def test_a_small_drawing_for_which_two_routes_are_looked_for_has_an_opening_earlier() -> None:
    """A few strokes are ordered by travel time and by distance, which takes twice as long."""
    by_time = travel_time(Kinematics(np.array([[80.0, 80.0], [80.0, -80.0]]), 25000.0), Limits(300, 3000, 200e3))
    layers = [Layer(1, "a", scattered(50))]
    assert len(list(order_in_turn(layers, with_pace(), START))) == 1
    first, rest = order_in_turn(layers, with_pace(), START, by_time)
    assert len(first.strokes) < len(rest.strokes)


def test_the_opening_is_the_nearest_figures_wherever_they_are() -> None:
    """Looked for among the nearest only, it is what it would be among all; kilometres away as well."""
    strokes = [*scattered(400), *(Stroke(line.points_mm + line.points_mm[-1:] - line.points_mm[0]) for line in scattered(400))]
    for scale in (1.0, 3e6):
        grown = [Stroke(line.points_mm * scale) for line in strokes]
        pace = Pace(0.4, 30.0 * scale)
        numbers = opening(grown, START, 12.0, pace, near=True)
        away = np.array([min(np.hypot(*line.points_mm[0]), np.hypot(*line.points_mm[-1])) for line in grown])
        figures = away.reshape(2, 400).min(axis=0)  # each stroke and the one that goes on from its end
        expected, took_s = set[int](), 0.0
        for k in np.argsort(figures, kind="stable").tolist():
            if took_s >= 12.0:
                break
            expected |= {k, k + 400}
            took_s += float(pace.seconds([grown[k], grown[k + 400]]).sum())
        assert set(numbers) == expected


@pytest.mark.parametrize("order", ["none", "greedy", "best"])
@pytest.mark.parametrize("reverse", [False, True])
def test_everything_is_drawn_once_and_the_same_each_time(order: str, reverse: bool) -> None:
    strokes = scattered(800)
    if order != "best":
        strokes = tuple(Stroke(np.linspace(*s.points_mm, 20)) for s in scattered(1900))  # only preparing takes long here
    layers = [Layer(1, "a", strokes, pause_before=True), Layer(2, "b", scattered(50, 2), pause_before=True)]
    options = with_pace(order=order, reverse=reverse)
    pieces = list(order_in_turn(layers, options, START))
    assert len(pieces) == (2 if reverse else 3), "a small layer that comes first gives time enough"
    assert [layer.pause_before for layer in merged(pieces)] == [True, True]
    assert segments(order_layers(layers, options, START)) == segments(tuple(layers))
    again = merged(list(order_in_turn(layers, options, START)))
    for one, other in zip(merged(pieces), again, strict=True):
        assert all((a.points_mm == b.points_mm).all() for a, b in zip(one.strokes, other.strokes, strict=True))
    if order == "none":
        drawn = [stroke for layer in merged(pieces) for stroke in layer.strokes]
        asked = [
            s for layer in (layers[::-1] if reverse else layers) for s in (layer.strokes[::-1] if reverse else layer.strokes)
        ]
        assert all((a.points_mm == b.points_mm).all() for a, b in zip(drawn, asked, strict=True))


@pytest.mark.parametrize("strokes", [snake(25, 25), snake(25, 25)[::-1], scattered(600)])
def test_the_travel_is_never_longer_than_in_the_file(strokes: tuple[Stroke, ...]) -> None:
    (layer,) = order_layers([Layer(1, "a", strokes)], with_pace(), START)
    assert travel(layer.strokes, START) <= travel(strokes, START) + 1e-9


def test_the_opening_costs_little_travel() -> None:
    layers = [Layer(1, "a", scattered(1000))]
    (quick,), (whole,) = (
        order_layers(layers, with_pace(), START),
        order_layers(layers, OrderOptions(join_tolerance_mm=-1.0, time_budget_s=0.5), START),
    )
    assert travel(quick.strokes, START) <= 1.03 * travel(whole.strokes, START)


def test_what_the_opening_has_drawn_is_not_drawn_again() -> None:
    """Every stroke twice, one of the two turned round, and the copies far away in the file."""
    strokes = scattered(600)
    doubled = (*strokes, *(stroke.reversed() for stroke in strokes[::-1]))
    pieces = list(order_in_turn([Layer(1, "a", doubled)], with_pace(), START))
    assert len(pieces) == 2
    assert segments(merged(pieces)) == segments((Layer(1, "a", strokes),))


def test_a_layer_that_only_repeats_the_opening_is_no_trouble() -> None:
    line = Stroke(np.array([[1.0, 1.0], [9.0, 1.0]]))
    (layer,) = order_layers([Layer(1, "a", (line,) * 20_000)], with_pace(), START)
    assert len(layer.strokes) == 1


def test_what_hangs_together_stays_together() -> None:
    """Lines of ten pieces each: none of them is cut where the opening ends."""
    rng = np.random.default_rng(3)
    lines = [at + np.stack((np.arange(11.0), np.zeros(11)), axis=1) for at in rng.uniform(0, 200, (400, 2))]
    strokes = [Stroke(line[k : k + 2]) for line in lines for k in range(10)]
    numbers = opening(strokes, START, 20.0, PACE, near=True)
    assert numbers
    assert len(numbers) % 10 == 0
    assert {k // 10 for k in numbers} == {k // 10 for k in numbers if k % 10 == 0}
    grid = [Stroke(np.array([[x, 0.0], [x + 1.0, 0.0]])) for x in range(5000)]
    assert len(opening(grid, START, 20.0, PACE, near=True)) == 47, "one line of everything is cut all the same"
    assert opening(grid[:50], START, 20.0, PACE, near=True) == []
    assert GREATEST_SHARE * 50 <= 47
