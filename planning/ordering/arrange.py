"""The order in which the pen draws: what is drawn stays what was drawn, how the pen gets around is chosen here."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from planning.geometry.stroke import Layer, Stroke
from planning.ordering.greedy import greedy_route
from planning.ordering.joining import join_strokes
from planning.ordering.metric import Array, Metric, euclidean

Order = Literal["none", "greedy", "best"]
Seams = Literal["random", "same", "hidden", "free"]
By = Literal["layer", "color"]


@dataclass(frozen=True, slots=True)
class OrderOptions:
    """What a person may choose about the order. Lengths in millimetres.

    `order`: none keeps the file's order, greedy takes the shortest links first, best improves on that for as much work as
    `time_budget_s` buys; the budget is counted in steps, not on a clock, so that the same drawing gives the same order
    everywhere.
    `join_tolerance_mm`: ends this near are joined; negative joins nothing.
    `seams`: where a closed stroke starts. same keeps the file's point, random spreads the marks, hidden takes one of its
    sharpest corners (any point where there is no corner), free takes whatever shortens the travel.
    `overdraw_mm`: how far a closed stroke is drawn on beyond its start.
    `reverse` draws layers and colours last to first, and with order none their strokes too. `interleave` draws every other
    stroke on the way out and the rest on the way back, so that neighbours have time to dry.
    `max_stroke_mm`: longer strokes are cut, so that the pen can be looked after in between.
    `by`: color gathers each colour of the whole drawing into a layer of its own.

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
    clock: Callable[[], float] | None = None,  # noqa: ARG001
) -> tuple[Layer, ...]:
    """The layers with their strokes joined and in the order of least travel, from `start_mm` (2,) to
    `end_mm` (2,) or anywhere.

    Layers keep their order, and within a layer the strokes of one colour stay together, in the order of the colours' first
    strokes. What is drawn is unchanged, within the joining tolerance. `metric` is the cost of a travel.
    """
    at_mm = np.asarray(start_mm, dtype=np.float64)
    arranged = []
    grouped = [_colour_groups(layer.strokes) for layer in layers]
    left = sum(len(groups) for groups in grouped)
    for layer, groups in zip(layers, grouped, strict=True):
        strokes: list[Stroke] = []
        for group in groups:
            left -= 1
            ordered = _order_group(group, options, at_mm, end_mm if left == 0 else None, metric)
            at_mm = ordered[-1].points_mm[-1]
            strokes.extend(ordered)
        arranged.append(replace(layer, strokes=tuple(strokes)))
    return tuple(arranged)


def _colour_groups(strokes: Sequence[Stroke]) -> list[list[Stroke]]:
    groups: dict[str | None, list[Stroke]] = {}
    for stroke in strokes:
        groups.setdefault(stroke.color, []).append(stroke)
    return list(groups.values())


def _order_group(
    strokes: list[Stroke], options: OrderOptions, start_mm: Array, end_mm: Array | None, metric: Metric
) -> list[Stroke]:
    if options.order == "none":
        return strokes
    joined = join_strokes(strokes, options.join_tolerance_mm)
    ends = np.array([s.points_mm[[0, -1]] for s in joined]).reshape(-1, 2)
    last_mm = start_mm if end_mm is None else np.asarray(end_mm, dtype=np.float64)
    route = greedy_route(np.concatenate((last_mm[None], start_mm[None], ends)), metric, free_end=end_mm is None)
    ordered = [joined[(node >> 1) - 1] if node % 2 == 0 else joined[(node >> 1) - 1].reversed() for node in route[1:].tolist()]
    return min((strokes, ordered), key=lambda s: travel(s, start_mm, metric, end_mm))


def travel(strokes: Sequence[Stroke], start_mm: Array, metric: Metric = euclidean, end_mm: Array | None = None) -> float:
    """What the pen-up travel costs, from `start_mm` (2,) through the strokes and on to `end_mm` (2,), when given."""
    if not strokes:
        return 0.0
    starts = np.array([s.points_mm[0] for s in strokes])
    ends = np.array([s.points_mm[-1] for s in strokes])
    total = metric(np.concatenate((np.asarray(start_mm, dtype=np.float64)[None], ends[:-1])), starts).sum()
    home = 0.0 if end_mm is None else metric(ends[-1:], np.asarray(end_mm, dtype=np.float64)[None]).sum()
    return float(total + home)
