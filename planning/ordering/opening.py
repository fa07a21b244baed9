"""What is drawn first, while the rest is still being put in order.

To put a large drawing in order takes seconds in which nothing would move. Its opening, some strokes near the start, is put in
order by itself and at once; drawing it takes longer than ordering what is left, which then goes on from the opening's end. All
of it is counted in strokes and nominal seconds, never timed, so that the same drawing comes in the same order everywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planning.geometry.stroke import Stroke
from planning.geometry.strokes import Ints, ends_mm, lengths_mm, sizes
from planning.motion.late import hanging_together
from planning.ordering.metric import Array
from planning.ordering.route import KICKS_PER_S, KICKS_PER_STROKE, QUICK_STROKES_PER_S, SEAM_ROUNDS, THOROUGH_STROKES_PER_S

# Seconds that joining, overlaps and the greedy route take, on a core of 2024.
PREPARING_S_PER_STROKE = 5e-5
PREPARING_S_PER_VERTEX = 8e-6
# What takes less than this is waited for.
SOON_S = 0.3
# The opening is drawn for so many times as long as ordering the rest takes: the machine may be slower, or busy.
LEAD = 2.0
# What is joined stays together unless the opening becomes so many times longer by it.
WHOLE = 3.0
# A drawing of which nearly all would be the opening has none.
GREATEST_SHARE = 0.8
# What improving the opening may cost, while nothing moves: on the samples ten times as much made no opening shorter.
BUDGET_S = 0.01


@dataclass(frozen=True, slots=True)
class Pace:
    """About how fast the machine draws: seconds for each stroke's lifts and travel, and millimetres a second along it."""

    stroke_s: float
    draw_mm_s: float

    def seconds(self, strokes: Sequence[Stroke]) -> Array:
        """How long each stroke takes, (n,)."""
        return np.asarray(self.stroke_s + lengths_mm(strokes) / self.draw_mm_s)


def ordering_s(strokes: Sequence[Stroke], *, best: bool, budget_s: float, routes: int = 1) -> float:
    """Nominal seconds that it takes to put these strokes in order, so many `routes` being looked for."""
    count = len(strokes)
    preparing_s = count * PREPARING_S_PER_STROKE + int(sizes(strokes).sum()) * PREPARING_S_PER_VERTEX
    if not best:
        return preparing_s
    rounds_s = SEAM_ROUNDS * count / QUICK_STROKES_PER_S + count / THOROUGH_STROKES_PER_S
    return preparing_s + routes * min(budget_s, rounds_s + KICKS_PER_STROKE * count / KICKS_PER_S)


def opening(strokes: Sequence[Stroke], start_mm: Array, lead_s: float, pace: Pace, *, near: bool) -> list[int]:
    """Numbers of the strokes to begin with, rising: those nearest to `start_mm` (2,), or else the first ones, whose drawing
    takes `lead_s`. Strokes whose ends meet stay together as far as that goes. Empty when that would be nearly all of them.
    """
    ends = ends_mm(strokes)
    figure = _figures(ends)
    each_s = pace.seconds(strokes)
    if near:
        turn = _by_distance(figure, np.hypot(*(ends - start_mm).transpose(2, 0, 1)).min(axis=1), each_s, lead_s)
    else:
        turn = np.arange(len(strokes))
    until_s = np.cumsum(each_s[turn])
    least = int(np.searchsorted(until_s, lead_s)) + 1
    if least >= GREATEST_SHARE * len(strokes):
        return []
    border = np.flatnonzero(np.diff(figure[turn])) + 1  # places where one figure ends and another begins
    whole = border[border >= least]
    take = int(whole[0]) if whole.size and until_s[whole[0] - 1] <= WHOLE * max(lead_s, float(until_s[least - 1])) else least
    return sorted(turn[:take].tolist()) if take < GREATEST_SHARE * len(strokes) else []


def _by_distance(figure: Ints, away: Array, each_s: Array, lead_s: float) -> Ints:
    """Figure by figure, the nearest first, and within each as well: as many figures as take `lead_s`, and two more."""
    nearest = np.full(figure.max() + 1, np.inf)
    np.minimum.at(nearest, figure, away)
    figures = np.argsort(nearest, kind="stable")
    until_s = np.cumsum(np.bincount(figure, each_s)[figures])
    taken = np.zeros(len(figures), dtype=bool)
    taken[figures[: int(np.searchsorted(until_s, lead_s)) + 3]] = True
    rows = np.flatnonzero(taken[figure])
    return np.asarray(rows[np.lexsort((away[rows], figure[rows], nearest[figure[rows]]))])


def _figures(ends: Array) -> Ints:
    """Which figure each stroke belongs to: strokes whose very ends (n, 2, 2) meet are of one."""
    count = len(ends)
    place: Ints = np.unique(_cells(ends.reshape(-1, 2)), return_inverse=True)[1].reshape(count, 2)
    return np.asarray(hanging_together(place[:, 0], place[:, 1], 2 * count)[place[:, 0]])


def _cells(points_mm: Array) -> Ints:
    """A number for each point (n, 2): the same for points that are the same to the micrometre."""
    micrometres = np.rint(points_mm * 1000).astype(np.int64)
    x, y = (micrometres - micrometres.min(axis=0)).T
    if (int(x.max()) + 1) * (int(y.max()) + 1) > np.iinfo(np.int64).max:  # kilometres of them
        x, y = (np.unique(axis, return_inverse=True)[1] for axis in (x, y))
    return np.asarray(x * (y.max() + 1) + y)
