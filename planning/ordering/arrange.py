"""The order in which the pen draws: what is drawn stays what was drawn, how the pen gets around is chosen here."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from planning.geometry.stroke import Layer, Stroke
from planning.geometry.strokes import by_color, chosen, ends_mm, together
from planning.ordering.cutting import cut, interleaved
from planning.ordering.duplicates import draw_once
from planning.ordering.improve import Stop, never
from planning.ordering.joining import join_in_turn, join_strokes
from planning.ordering.meeting import begin_where_met
from planning.ordering.metric import Array, Metric, euclidean
from planning.ordering.opening import BUDGET_S, LEAD, SOON_S, Pace, opening, ordering_s
from planning.ordering.route import Route, Work
from planning.ordering.seams import Choices, Seams, overdraw, places, start_at

Order = Literal["none", "greedy", "best", "random"]
By = Literal["layer", "number", "color"]

# So many strokes are ordered by distance as well, whatever the metric.
FEW = 300

_NUMBER = re.compile(r"[!\s]*(\d{1,9})")


@dataclass(frozen=True, slots=True)
class OrderOptions:
    """What a person may choose about the order. Lengths in millimetres.

    `order`: none keeps the file's order (and its seams, unless they are to be random), greedy takes the shortest links
    first, best improves on that for as much work as `time_budget_s` buys; the budget is counted in steps, not on a clock,
    so that the same drawing gives the same order everywhere. random is any order, for ink that dries slowly.
    `join_tolerance_mm`: ends this near are joined; negative joins nothing.
    `seams`: where a closed stroke starts. same keeps the file's point, random spreads the marks, hidden takes one of its
    sharpest corners (any point where there is no corner), free takes whatever shortens the travel.
    `overdraw_mm`: how far a closed stroke is drawn on beyond its start.
    `reverse` draws layers and colours last to first, and with order none their strokes too. `interleave` draws every other
    stroke on the way out and the rest on the way back, so that neighbours have time to dry.
    `max_stroke_mm`: longer strokes are cut, so that the pen can be looked after in between.
    `by`: number draws the layers by the number that their name begins with, those without one last; color gathers each
    colour of the whole drawing into a layer of its own.
    `pace`: when given, a drawing that takes long to be put in order has an opening that is there at once (see opening.py).

    Raises ValueError for a length or a budget that is out of range.
    """

    order: Order = "best"
    time_budget_s: float = 10.0
    join_tolerance_mm: float = 0.1
    keep_duplicates: bool = False
    seams: Seams = "hidden"
    overdraw_mm: float = 0.0
    reverse: bool = False
    interleave: bool = False
    max_stroke_mm: float | None = None
    seed: int = 0
    by: By = "layer"
    pace: Pace | None = None

    def __post_init__(self) -> None:
        if not (np.isfinite(self.time_budget_s) and self.time_budget_s >= 0):
            raise ValueError(f"time_budget_s must be finite and not negative, not {self.time_budget_s}")
        if not np.isfinite(self.join_tolerance_mm):
            raise ValueError(f"join_tolerance_mm must be finite, not {self.join_tolerance_mm}")
        if not (np.isfinite(self.overdraw_mm) and self.overdraw_mm >= 0):
            raise ValueError(f"overdraw_mm must be finite and not negative, not {self.overdraw_mm}")
        if self.max_stroke_mm is not None and not (np.isfinite(self.max_stroke_mm) and self.max_stroke_mm > 0):
            raise ValueError(f"max_stroke_mm must be positive and finite, not {self.max_stroke_mm}")


def order_layers(
    layers: Sequence[Layer],
    options: OrderOptions,
    start_mm: Array,
    metric: Metric = euclidean,
    end_mm: Array | None = None,
    clock: Callable[[], float] | None = None,
) -> tuple[Layer, ...]:
    """The layers with their strokes joined and in the order of least travel, from `start_mm` (2,) to `end_mm` (2,) or anywhere.

    Layers keep their order, and within a layer the strokes of one colour stay together, in the order of the colours' first
    strokes. What is drawn is unchanged, within the joining tolerance. `metric` is the cost of a travel; it never comes out
    greater than in the file's own order (unless interleave, random seams or a random order ask for it).

    `clock`, in seconds, only guards against slow machines: when it says that the time budget is used up, improving ends early.
    Without it, or when it does not come to that, the same layers and options give the same result everywhere.
    """
    pieces = list(order_in_turn(layers, options, start_mm, metric, end_mm, clock))
    return merged(pieces)


def order_in_turn(
    layers: Sequence[Layer],
    options: OrderOptions,
    start_mm: Array,
    metric: Metric = euclidean,
    end_mm: Array | None = None,
    clock: Callable[[], float] | None = None,
) -> Iterator[Layer]:
    """`order_layers`, piece by piece as they are found: a layer may come in several pieces one after the other, of the same
    number, of which only the first has a pause before it. `merged` puts them together.
    """
    arranged = _by_color(layers) if options.by == "color" else list(layers)
    if options.by == "number":
        arranged.sort(key=_number_of)
    if options.reverse:
        arranged.reverse()
    grouped = [by_color(layer.strokes) for layer in arranged]
    if options.reverse:
        for groups in grouped:
            groups.reverse()
    total = sum(len(layer.strokes) for layer in arranged)
    work = Work(options.order == "best", options.time_budget_s, options.seed, _deadline(clock, options.time_budget_s))
    at_mm = np.asarray(start_mm, dtype=np.float64)
    last_mm = None if end_mm is None else np.asarray(end_mm, dtype=np.float64)
    left = sum(len(groups) for groups in grouped)
    following = iter([*[ends_mm(group).reshape(-1, 2) for groups in grouped for group in groups][1:], None])
    ahead_s = 0.0  # drawing given out, less the ordering since then
    for layer, groups in zip(arranged, grouped, strict=True):
        strokes: list[Stroke] = []
        begun = False
        for group in groups:
            left -= 1
            share = replace(work, budget_s=work.budget_s * len(group) / total)
            first: list[Stroke] = []
            routes = len(_metrics(len(group), metric))  # or more, should joining leave few
            wait_s = ordering_s(group, best=work.best, budget_s=share.budget_s, routes=routes)
            if options.pace is not None and wait_s > SOON_S:
                first, group = _opened(group, options, Way(at_mm, metric), share, LEAD * wait_s - ahead_s, options.pace)
                strokes.extend(first)
                if strokes:
                    yield _piece(layer, strokes, begun)
                    ahead_s += float(options.pace.seconds(strokes).sum())
                    at_mm, strokes, begun = strokes[-1].points_mm[-1], [], True
            way = Way(at_mm, metric, last_mm if left == 0 else None, next(following))
            ordered = _order_group(group, options, way, share, first)
            ahead_s = max(ahead_s - wait_s, 0.0)
            at_mm = ordered[-1].points_mm[-1] if ordered else at_mm
            strokes.extend(ordered)
        if options.pace is not None:
            ahead_s += float(options.pace.seconds(strokes).sum())
        if strokes or not begun:
            yield _piece(layer, strokes, begun)


def merged(pieces: Sequence[Layer]) -> tuple[Layer, ...]:
    """Whole layers from the pieces that `order_in_turn` gives."""
    result: list[Layer] = []
    for piece in pieces:
        if result and result[-1].number == piece.number and not piece.pause_before:
            result[-1] = replace(result[-1], strokes=(*result[-1].strokes, *piece.strokes))
        else:
            result.append(piece)
    return tuple(result)


def _number_of(layer: Layer) -> float:
    """The number that a layer's name begins with, as in "2 blue" or, with a pause, "! 2 blue"; infinite without one."""
    found = _NUMBER.match(layer.name)
    return int(found[1]) if found else np.inf


def _piece(layer: Layer, strokes: list[Stroke], begun: bool) -> Layer:
    return replace(layer, strokes=tuple(strokes), pause_before=layer.pause_before and not begun)


def _opened(
    group: Sequence[Stroke], options: OrderOptions, way: Way, work: Work, lead_s: float, pace: Pace
) -> tuple[list[Stroke], Sequence[Stroke]]:
    """The group's opening as it will be drawn, and the strokes that are left for later. Never further than the file's order."""
    if lead_s <= 0 or options.interleave or options.order == "random":
        return [], group
    asked = group[::-1] if options.order == "none" and options.reverse else group
    small = replace(work, budget_s=min(work.budget_s, BUDGET_S))
    for near in (True, False) if options.order != "none" else (False,):
        numbers = opening(asked, way.start_mm, lead_s, pace, near=near)
        if not numbers:
            return [], group
        rest = chosen(asked, np.delete(np.arange(len(asked)), numbers))
        plain = replace(options, reverse=False) if near else replace(options, reverse=False, order="none")
        first = _order_group(chosen(asked, np.array(numbers)), plain, way, small)
        if not near or way.cost(first, rest) <= way.cost(asked):
            return first, rest[::-1] if asked is not group else rest
    raise AssertionError("the first strokes in the file's order are no further than the file's order")


def _deadline(clock: Callable[[], float] | None, budget_s: float) -> Stop:
    if clock is None:
        return never
    end_s = clock() + budget_s
    return lambda: clock() > end_s


def _by_color(layers: Sequence[Layer]) -> list[Layer]:
    """One layer for each colour of the drawing, by its first stroke, numbered from 1 and named after the colour."""
    groups = by_color(together(layer.strokes for layer in layers))
    pause = any(layer.pause_before for layer in layers)
    return [
        Layer(number, group[0].color or "no color", group, group[0].color, pause)
        for number, group in enumerate(groups, start=1)
    ]


@dataclass(frozen=True, eq=False, slots=True)
class Way:
    """From which place (2,) a group is drawn, what travel costs, where it ends and what follows it (n, 2), if that is known."""

    start_mm: Array
    metric: Metric
    end_mm: Array | None = None
    following_mm: Array | None = None

    def cost(self, *parts: Sequence[Stroke]) -> float:
        """What travel costs, at least one stroke drawn in this order, part by part, and on to the nearest of what follows."""
        ends = np.concatenate([ends_mm(part) for part in parts])
        total = _travel(ends, self.start_mm, self.metric, self.end_mm)
        if self.end_mm is None and self.following_mm is not None:
            total += float(self.metric(ends[-1:, 1], self.following_mm).min())
        return total


def _metrics(count: int, metric: Metric) -> list[Metric]:
    """By which metrics so many strokes are ordered. A few may well be stuck with one where they are not with another."""
    return [metric] if metric is euclidean or count > FEW else [metric, euclidean]


def _routed(joined: list[Stroke], options: OrderOptions, way: Way, work: Work) -> list[Stroke]:
    """The shortest route that is found."""
    routes = []
    for metric in _metrics(len(joined), way.metric):
        choices = Choices(joined, options.seams, np.random.default_rng(options.seed))
        route = Route(joined, choices, way.start_mm, way.end_mm, metric, way.following_mm)
        route.find(work)
        routes.append(route.drawn())
    return min(routes, key=way.cost)


def _order_group(
    strokes: Sequence[Stroke], options: OrderOptions, way: Way, work: Work, drawn: Sequence[Stroke] = ()
) -> list[Stroke]:
    """The strokes of one colour as they will be drawn: at least one, unless what was `drawn` before covers them."""
    once = list(strokes) if options.keep_duplicates else draw_once(strokes, drawn)
    if not once:
        return []
    rng = np.random.default_rng(options.seed)
    if options.order == "random":
        joined = join_strokes(once, options.join_tolerance_mm)
        ordered = [joined[k] for k in rng.permutation(len(joined))]
        if options.seams == "random":
            ordered = [start_at(stroke, int(places(stroke, "random", rng)[0])) for stroke in ordered]
    elif options.order == "none":
        ordered = join_in_turn(once[::-1] if options.reverse else once, options.join_tolerance_mm)
        if options.seams == "random":
            ordered = [start_at(stroke, int(places(stroke, "random", rng)[0])) for stroke in ordered]
    else:
        movable = begin_where_met(once, options.join_tolerance_mm) if options.seams in ("hidden", "free") else once
        joined = join_strokes(movable, options.join_tolerance_mm)
        found = _routed(joined, options, way, work)
        as_in_file = join_in_turn(once, options.join_tolerance_mm)
        ordered = found if options.seams == "random" else min((found, as_in_file), key=way.cost)
    if options.interleave:
        ordered = interleaved(ordered)
    ordered = [overdraw(stroke, options.overdraw_mm) for stroke in ordered]
    if options.max_stroke_mm is not None:
        ordered = [piece for stroke in ordered for piece in cut(stroke, options.max_stroke_mm)]
    return ordered


def travel(strokes: Sequence[Stroke], start_mm: Array, metric: Metric = euclidean, end_mm: Array | None = None) -> float:
    """What the pen-up travel costs, from `start_mm` (2,) through the strokes and on to `end_mm` (2,), when given."""
    return _travel(ends_mm(strokes), start_mm, metric, end_mm)


def _travel(ends: Array, start_mm: Array, metric: Metric, end_mm: Array | None) -> float:
    if not len(ends):
        return 0.0
    starts, feet = ends[:, 0], ends[:, 1]
    total = metric(np.concatenate((np.asarray(start_mm, dtype=np.float64)[None], feet[:-1])), starts).sum()
    home = 0.0 if end_mm is None else metric(feet[-1:], np.asarray(end_mm, dtype=np.float64)[None]).sum()
    return float(total + home)
