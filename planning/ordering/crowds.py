"""Crowds: very many segments on one line, as where all that leaves the page was moved to its border.

Of n segments on one line n^2 / 2 pairs overlap. They are found by their line, without any pair, and each then loses what the
earlier ones together cover, which is a few stretches of that line however many there were.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from planning.ordering.metric import Array

Interval = tuple[float, float]
Ints = NDArray[np.int64]

# Two lines nearer than this over their common length are one line: less than half a motor step of 0.0125 mm.
SAME_LINE_MM = 0.005
# The ends of a crowd's segments are no further from its line: two of them are then nearer to each other than SAME_LINE_MM.
CROWD_MM = 0.4 * SAME_LINE_MM

# Fewer segments on a line are no crowd, nor those of which each overlaps fewer others than this on average.
MANY = 32
MANY_EACH = 8
# Segments of one line have one direction (radians) and offset (mm) in steps of these; what they put together is then measured.
ANGLE_STEP = 1e-5
OFFSET_STEP_MM = 1e-3
# Lines tried for the segments of one direction and offset, and crowds to which all that lies on their line is added, whatever
# its direction as far as rounding goes: each takes a look at all segments.
MOST_LINES = 8
MOST_LOOKS = 64


class Stretches:
    """Stretches of a line as sorted intervals apart from each other. Those less than SAME_LINE_MM apart become one."""

    def __init__(self) -> None:
        self._low: list[float] = []
        self._high: list[float] = []

    def __len__(self) -> int:
        return len(self._low)

    def within(self, low: float, high: float) -> Iterator[Interval]:
        """The stretches that overlap low .. high, whole and in turn."""
        for k in range(bisect_right(self._high, low), bisect_left(self._low, high)):
            yield self._low[k], self._high[k]

    def add(self, low: float, high: float) -> None:
        """Every stretch that is swallowed is gone, so that all additions together take about n log n."""
        first = bisect_left(self._high, low - SAME_LINE_MM)
        last = bisect_right(self._low, high + SAME_LINE_MM)
        if first < last:
            low, high = min(low, self._low[first]), max(high, self._high[last - 1])
        self._low[first:last] = [low]
        self._high[first:last] = [high]


class Crowd:
    """Segments on one line that overlap each other many times over.

    `members` are their numbers; each lies from `begin` to `end` (mm from `origin`) in the direction `along`, or against it.
    `a` and `b` (2,) are the ends of what they cover together. `inked` are the stretches that members draw, `taken` those
    and what others draw within SAME_LINE_MM - CROWD_MM of the line.
    """

    def __init__(self, members: Ints, origin: Array, along: Array, begin: Array, end: Array) -> None:
        low, high = float(min(begin.min(), end.min())), float(max(begin.max(), end.max()))
        self.members = members
        self.a, self.b = origin + low * along, origin + high * along
        self.along = along
        self.length_mm = high - low
        self.inked = Stretches()
        self.taken = Stretches()
        self._ends = dict(zip(members.tolist(), zip((begin - low).tolist(), (end - low).tolist(), strict=True), strict=True))

    def draw(self, member: int) -> list[Interval]:
        """What is left of a member, as fractions of its length, without what was drawn before; that is now drawn as well."""
        begin, end = self._ends[member]
        low, high = min(begin, end), max(begin, end)
        gaps: list[Interval] = []
        at = low
        for covered_from, covered_to in self.taken.within(low, high):
            if min(covered_to, high) - max(covered_from, low) > SAME_LINE_MM:
                if covered_from - at > SAME_LINE_MM:
                    gaps.append((at, covered_from))
                at = covered_to
        if high - at > SAME_LINE_MM or at == low:
            gaps.append((at, high))
        for gap in gaps:
            self.inked.add(*gap)
            self.taken.add(*gap)
        if begin < end:
            return [(self._fraction(member, lo), self._fraction(member, hi)) for lo, hi in gaps]
        return [(self._fraction(member, hi), self._fraction(member, lo)) for lo, hi in reversed(gaps)]

    def _fraction(self, member: int, at: float) -> float:
        begin, end = self._ends[member]
        return 0.0 if at == begin else 1.0 if at == end else (at - begin) / (end - begin)

    def inked_beside(self, a: Array, b: Array) -> Array:
        """The ends (k, 2, 2) of the stretches that members draw, as far as they may lie beside the segment from `a` to `b`."""
        low, high = sorted((float((a - self.a) @ self.along), float((b - self.a) @ self.along)))
        found = np.array(list(self.inked.within(low, high))).reshape(-1, 2)
        return np.asarray(self.a + found[:, :, None] * self.along)


def find_crowds(a: Array, b: Array) -> list[Crowd]:
    """The crowds among the segments from `a` to `b` (n, 2); a segment is in one at most. About n log n."""
    if len(a) <= MANY:
        return []
    free = np.hypot(*(b - a).T) > SAME_LINE_MM
    crowds: list[Crowd] = []
    looks = MOST_LOOKS
    for group in _by_line(a, b):
        rest = group[free[group]]
        for _ in range(MOST_LINES):
            if len(rest) <= MANY:
                break
            on, found = _on_line_of_longest(a, b, rest)
            if found and looks:
                looks -= 1
                hub = rest[np.argmax(_lengths(a, b, rest))]
                others = np.flatnonzero(free)
                found = _on_line_of_longest(a, b, np.concatenate(([hub], others[others != hub])), first=True)[1]
            for crowd in found:
                free[crowd.members] = False
            crowds += found
            rest = rest[~on]
            rest = rest[free[rest]]
    return crowds


def _lengths(a: Array, b: Array, which: Ints) -> Array:
    return np.asarray(np.hypot(*(b[which] - a[which]).T))


def _by_line(a: Array, b: Array) -> list[Ints]:
    """Numbers of the segments of about one direction and offset, in groups of more than MANY, the largest first."""
    span = b - a
    angle = np.arctan2(span[:, 1], span[:, 0]) % np.pi
    angle[angle > np.pi - ANGLE_STEP / 4] -= np.pi  # level is one direction, whichever way it was rounded
    middle = (a.min(axis=0) + a.max(axis=0)) / 2
    # Steps begin in odd places, so that what is level, upright or on a round number is not by chance on either side of one.
    direction = np.floor(angle / ANGLE_STEP + 0.4142).astype(np.int64)
    offset = (a[:, 1] - middle[1]) * np.cos(angle) - (a[:, 0] - middle[0]) * np.sin(angle)
    step = np.floor(offset / OFFSET_STEP_MM + 0.4142).astype(np.int64)
    order = np.lexsort((step, direction))
    new = (np.diff(direction[order]) != 0) | (np.diff(step[order]) != 0)
    starts = np.concatenate(([0], np.flatnonzero(new) + 1, [len(order)]))
    sizes = np.diff(starts)
    large = np.flatnonzero(sizes > MANY)
    large = large[np.argsort(-sizes[large], kind="stable")]
    return [np.sort(order[starts[k] : starts[k + 1]]) for k in large]


def _on_line_of_longest(a: Array, b: Array, which: Ints, *, first: bool = False) -> tuple[NDArray[np.bool_], list[Crowd]]:
    """Which of these lie on the line of the longest of them, or the `first`, and the crowds on that line."""
    hub = which[0] if first else which[np.argmax(_lengths(a, b, which))]
    along = (b[hub] - a[hub]) / np.hypot(*(b[hub] - a[hub]))
    across = np.array([-along[1], along[0]])
    on = (np.abs((a[which] - a[hub]) @ across) <= CROWD_MM) & (np.abs((b[which] - a[hub]) @ across) <= CROWD_MM)
    members = which[on]
    begin, end = (a[members] - a[hub]) @ along, (b[members] - a[hub]) @ along
    low, high = np.minimum(begin, end), np.maximum(begin, end)
    order = np.argsort(low, kind="stable")
    # Where nothing reaches over, the next row of overlapping segments begins.
    apart = low[order][1:] > np.maximum.accumulate(high[order])[:-1] - SAME_LINE_MM
    crowds = []
    for row in np.split(order, np.flatnonzero(apart) + 1):
        # A pair does not overlap where one ends before the other begins.
        disjoint = int(np.searchsorted(np.sort(high[row]), low[row] + SAME_LINE_MM, side="right").sum())
        if len(row) > MANY and len(row) * (len(row) - 1) // 2 - disjoint > MANY_EACH * len(row):
            row = np.sort(row)
            crowds.append(Crowd(members[row], a[hub], along, begin[row], end[row]))
    return on, crowds
