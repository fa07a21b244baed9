"""The route through strokes: first greedy, then improved, with the closed strokes' starts moved to where the route comes by."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from planning.geometry.stroke import Stroke
from planning.motion.late import tree_of
from planning.ordering.greedy import Nodes, greedy_route
from planning.ordering.improve import Costs, Effort, Stop, improve, near_nodes, never
from planning.ordering.kicks import kick
from planning.ordering.metric import Array, Metric
from planning.ordering.quick import is_closed
from planning.ordering.seams import Choices, start_at
from planning.ordering.tour import Tour

QUICK = Effort(breadth=12, depth=3, width=20)
THOROUGH = Effort(breadth=14, depth=4, width=40)
REPAIR = Effort(breadth=12, depth=4, width=6)

# What one second of budget buys. Counted and not timed, so that a drawing gives the same route on every machine; near what they
# take on a core of 2024.
QUICK_STROKES_PER_S = 40_000
THOROUGH_STROKES_PER_S = 15_000
KICKS_PER_S = 800
# A small drawing is done before its budget is.
KICKS_PER_STROKE = 3
# How often route and starts of closed strokes are fitted to each other.
SEAM_ROUNDS = 4
SEAM_SWEEPS = 3


@dataclass(frozen=True, slots=True)
class Work:
    """How far to go: `best` or only greedy, the budget in seconds of nominal work, and a last word on when to stop."""

    best: bool
    budget_s: float
    seed: int
    stop: Stop = never


class Route:
    """A route under way: the items' points, the order found so far, and the chosen starts. Item k + 1 is stroke k.

    It ends at `end_mm` or, when that is None, anywhere, from where the pen goes on to the nearest of `following_mm` (n, 2).
    """

    def __init__(
        self,
        strokes: list[Stroke],
        choices: Choices,
        start_mm: Array,
        end_mm: Array | None,
        metric: Metric,
        following_mm: Array | None = None,
    ) -> None:
        self.strokes, self.choices, self.metric = strokes, choices, metric
        self.free_end = end_mm is None
        self.following = None if following_mm is None or end_mm is not None else tree_of(following_mm)
        self.points_mm = np.empty((2 * len(strokes) + 2, 2))
        self.points_mm[0] = start_mm if end_mm is None else end_mm
        self.points_mm[1] = start_mm
        for k, stroke in enumerate(strokes):
            at = choices.chosen[k]
            self.points_mm[2 * k + 2] = stroke.points_mm[at]
            self.points_mm[2 * k + 3] = stroke.points_mm[at if is_closed(stroke) else -1]
        self.order = np.arange(len(strokes) + 1, dtype=np.int64) * 2

    def cost(self, order: Nodes) -> float:
        costs = self._costs()
        return math.fsum(costs(order ^ 1, np.roll(order, -1)).tolist())

    def find(self, work: Work) -> None:
        """The better of the strokes' own order and the greedy one; for `best`, improved."""
        greedy = greedy_route(self.points_mm, self.metric, self.free_end)
        if self.cost(greedy) < self.cost(self.order):
            self.order = greedy
        self._fit_seams(SEAM_SWEEPS)
        if work.best:
            self._refine(work)

    def _refine(self, work: Work) -> None:
        count = len(self.strokes)
        budget_s = work.budget_s
        rounds = SEAM_ROUNDS if len(self.choices.stroke) else 1
        for _ in range(rounds):
            if budget_s <= 0:
                return
            self._improve(QUICK, work)
            self._fit_seams(SEAM_SWEEPS)
            budget_s -= count / QUICK_STROKES_PER_S
        if budget_s <= 0:
            return
        self._improve(THOROUGH, work)
        budget_s -= count / THOROUGH_STROKES_PER_S
        kicks = min(int(budget_s * KICKS_PER_S), KICKS_PER_STROKE * count)
        if kicks > 0:
            near, costs, tour = self._parts(REPAIR)
            kick(tour, near, costs, REPAIR, kicks, np.random.default_rng(work.seed), work.stop)
            self.order = tour.route()
        self._fit_seams(SEAM_SWEEPS)

    def _parts(self, effort: Effort) -> tuple[Nodes, Costs, Tour]:
        near = near_nodes(self.points_mm, effort.breadth, self.free_end)
        return near, self._costs(), Tour(self.order)

    def _costs(self) -> Costs:
        if self.following is None:
            return Costs(self.points_mm, self.metric, self.free_end)
        nearest = self.following.data[self.following.query(self.points_mm)[1]]
        return Costs(self.points_mm, self.metric, self.free_end, self.metric(self.points_mm, nearest))

    def _improve(self, effort: Effort, work: Work) -> None:
        near, costs, tour = self._parts(effort)
        improve(tour, near, costs, effort, np.arange(len(self.points_mm)), work.stop)
        self.order = tour.route()

    def _fit_seams(self, sweeps: int) -> None:
        """Move the closed strokes' starts, every other one along the route at a time, so that no move spoils the next."""
        if not len(self.choices.stroke):
            return
        count = len(self.strokes)
        place = np.empty(count + 1, dtype=np.int64)
        place[self.order >> 1] = np.arange(count + 1)
        for turn in range(2 * sweeps):
            came = self.points_mm[np.roll(self.order, 1) ^ 1][place[1:]]
            goes = self.points_mm[np.roll(self.order, -1)][place[1:]]
            if self.free_end:
                last = (self.order[-1] >> 1) - 1
                goes[last] = came[last]
            moved, at_mm = self.choices.relax(came, goes, place[1:] % 2 == turn % 2, self.metric)
            self.points_mm[2 * moved + 2] = at_mm
            self.points_mm[2 * moved + 3] = at_mm

    def drawn(self) -> list[Stroke]:
        """The strokes in the route's order and directions, closed ones begun at their chosen starts."""
        result = []
        for node in self.order[1:].tolist():
            k = (node >> 1) - 1
            stroke = start_at(self.strokes[k], int(self.choices.chosen[k]))
            result.append(stroke.reversed() if node % 2 else stroke)
        return result
