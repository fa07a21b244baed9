"""Lines that lie on each other are drawn once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from planning.geometry.stroke import Stroke
from planning.ordering.crowds import CROWD_MM, SAME_LINE_MM, Crowd, Interval, Ints, find_crowds
from planning.ordering.metric import Array
from planning.ordering.quick import is_dot

# What was drawn before is left out in stretches of at least this length: for less, a lift costs more than the ink.
LEAST_GAP_MM = 0.5

# A segment longer than this stands in the index in pieces; all segments together in at most so many.
LONGEST_ENTRY_MM = 5.0
MOST_PIECES = 500_000
# Vertices looked up at a time, those of them looked up first to see how much will be found, and pairs found at a time, unless
# one vertex has more: these bound the memory.
QUERY = 16_384
PROBE = 64
AT_A_TIME = 1_000_000
# Overlapping pairs that are gone through. Where there are more, some lines stay that lie on others: nothing is lost.
MOST_PAIRS = 4_000_000
# Segments of one vertex this far apart in direction (radians) are too short for their overlap to matter.
WIDEST_ANGLE = 0.1


@dataclass(frozen=True, eq=False)
class _Segments:
    """All segments of positive length: from `a` to `b` (n, 2); which stroke and which of its segments each is."""

    a: Array
    b: Array
    stroke: Ints
    place: Ints

    @property
    def length(self) -> Array:
        return np.asarray(np.hypot(*(self.b - self.a).T))


def draw_once(strokes: Sequence[Stroke], drawn: Sequence[Stroke] = ()) -> list[Stroke]:
    """The strokes without the parts that an earlier one, or an earlier part of the same one, has drawn already.

    What is `drawn` comes before all of them. A part counts as drawn when it lies within SAME_LINE_MM of a segment that stays;
    parts shorter than LEAST_GAP_MM are let be. What is left of a stroke may be several pieces; they stand where it stood.
    Strokes that lose nothing come back as they are. About n log n for n segments.
    """
    strokes = [*drawn, *strokes]
    kept = _without_equal_dots(strokes)
    segments = _segments(strokes, kept)
    if len(segments.a) == 0:
        return [strokes[k] for k in kept if k >= len(drawn)]
    # Equal points have one number: the ends of the segments, first all a's and then all b's.
    vertex = np.unique(np.concatenate((segments.a, segments.b)) @ [1, 1j], return_inverse=True)[1].ravel()
    left = _first_of_equals(vertex)
    left.update(_uncovered(segments, vertex, left))
    by_stroke: dict[int, dict[int, list[Interval]]] = {}
    for k, intervals in left.items():
        by_stroke.setdefault(int(segments.stroke[k]), {})[int(segments.place[k])] = intervals
    result = []
    for number in kept:
        if number < len(drawn):
            continue
        if number in by_stroke:
            result.extend(_pieces(strokes[number], _without_small_gaps(strokes[number], by_stroke[number])))
        else:
            result.append(strokes[number])
    return result


def _without_equal_dots(strokes: Sequence[Stroke]) -> list[int]:
    """Numbers of the strokes, without the dots that repeat another."""
    seen: set[tuple[float, float]] = set()
    kept = []
    for number, stroke in enumerate(strokes):
        if is_dot(stroke):
            x, y = stroke.points_mm[0].tolist()
            if (x, y) in seen:
                continue
            seen.add((x, y))
        kept.append(number)
    return kept


def _segments(strokes: Sequence[Stroke], numbers: Sequence[int]) -> _Segments:
    lines = [k for k in numbers if len(strokes[k].points_mm) > 1]
    if not lines:
        none = np.zeros(0, dtype=np.int64)
        return _Segments(np.zeros((0, 2)), np.zeros((0, 2)), none, none)
    sizes = np.array([len(strokes[k].points_mm) for k in lines])
    points = np.concatenate([strokes[k].points_mm for k in lines])
    stroke = np.repeat(np.array(lines, dtype=np.int64), sizes)[:-1]
    place = (np.arange(len(points)) - np.repeat(np.cumsum(sizes) - sizes, sizes))[:-1]
    real = (stroke == np.repeat(np.array(lines), sizes)[1:]) & (points[:-1] != points[1:]).any(axis=1)
    return _Segments(points[:-1][real], points[1:][real], stroke[real], place[real])


def _first_of_equals(vertex: Ints) -> dict[int, list[Interval]]:
    """Nothing is left of a segment that has the very ends of an earlier one, in either direction."""
    a, b = vertex.reshape(2, -1)
    _, first = np.unique(np.minimum(a, b) * (vertex.max() + 1) + np.maximum(a, b), return_index=True)
    repeats = np.ones(len(a), dtype=np.bool_)
    repeats[first] = False
    return {k: [] for k in np.flatnonzero(repeats).tolist()}


def _uncovered(segments: _Segments, vertex: Ints, gone: dict[int, list[Interval]]) -> dict[int, list[Interval]]:
    """What is left, as fractions of its length, of each segment that earlier ones cover in part or whole."""
    here = np.ones(len(segments.a), dtype=np.bool_)
    here[list(gone)] = False
    present = np.flatnonzero(here)
    crowds = find_crowds(segments.a[present], segments.b[present])
    crowd_of = {int(present[k]): (crowd, k) for crowd in crowds for k in crowd.members.tolist()}
    here[list(crowd_of)] = False
    alone = np.flatnonzero(here)
    pairs, beside = _overlapping(segments, vertex, alone, crowds)
    left: dict[int, list[Interval]] = {}
    rows = np.flatnonzero(np.diff(pairs[:, 0], prepend=-1))
    earlier_of = dict(zip(pairs[rows, 0].tolist(), np.split(pairs[:, 1], rows[1:]), strict=True)) if len(rows) else {}
    for s in sorted({*earlier_of, *crowd_of, *beside}):  # what is left of the earlier ones is known by now
        if s in crowd_of:
            crowd, k = crowd_of[s]
            left[s] = crowd.draw(k)
            continue
        a, b = segments.a[s], segments.b[s]
        for t in earlier_of[s].tolist() if s in earlier_of else ():
            for fractions in left.get(t, [(0.0, 1.0)]):
                ends = segments.a[t] + np.array(fractions)[:, None] * (segments.b[t] - segments.a[t])
                covered = _covered(a, b, ends, SAME_LINE_MM)
                if covered is not None:
                    left[s] = _subtract(left.get(s, [(0.0, 1.0)]), covered)
        for other in beside.get(s, ()):
            left[s] = _beside_crowd(a, b, left.get(s, [(0.0, 1.0)]), other)
    sliver = SAME_LINE_MM / segments.length
    whole = [(0.0, 1.0)]
    return {s: [i for i in intervals if i[1] - i[0] > sliver[s]] for s, intervals in left.items() if intervals != whole}


def _beside_crowd(a: Array, b: Array, left: list[Interval], crowd: Crowd) -> list[Interval]:
    """What a crowd leaves of `left` of the segment from `a` to `b`, which then takes its place on the crowd's line."""
    for ends in crowd.inked_beside(a, b):
        covered = _covered(a, b, ends, SAME_LINE_MM - CROWD_MM)
        if covered is not None:
            left = _subtract(left, covered)
    for fractions in left:
        covered = _covered(crowd.a, crowd.b, a + np.array(fractions)[:, None] * (b - a), SAME_LINE_MM - CROWD_MM)
        if covered is not None:
            crowd.taken.add(covered[0] * crowd.length_mm, covered[1] * crowd.length_mm)
    return left


def _overlapping(
    segments: _Segments, vertex: Ints, alone: Ints, crowds: Sequence[Crowd]
) -> tuple[Ints, dict[int, list[Crowd]]]:
    """Pairs (k, 2) of a later and an earlier segment of those `alone` that have a common stretch, by rising later, and the
    crowds beside each segment. One of two that have a common stretch always ends on the other.
    """
    a = np.concatenate([segments.a[alone], *[crowd.a[None] for crowd in crowds]])
    b = np.concatenate([segments.b[alone], *[crowd.b[None] for crowd in crowds]])
    new = vertex.max() + 1 + np.arange(2 * len(crowds)).reshape(2, -1)
    vertex = np.concatenate((vertex.reshape(2, -1)[:, alone], new), axis=1)
    vertex = np.unique(vertex.ravel(), return_inverse=True)[1].ravel()
    if len(a) == 0:
        return np.zeros((0, 2), dtype=np.int64), {}
    found = _Pairs(a, b)
    _from_one_vertex(found, vertex)
    _on_vertices(found, vertex)
    pairs = found.all()
    with_crowd = pairs[:, 0] >= len(alone)
    beside: dict[int, list[Crowd]] = {}
    for crowd, k in pairs[with_crowd].tolist():
        if k < len(alone):
            beside.setdefault(int(alone[k]), []).append(crowds[crowd - len(alone)])
    return alone[pairs[~with_crowd]], beside


class _Pairs:
    """Pairs of the segments from `a` to `b` (n, 2) that have a common stretch, each once, as they are found."""

    def __init__(self, a: Array, b: Array) -> None:
        self.a, self.b = a, b
        self._found: list[Ints] = []
        self._waiting = 0
        self._kept = 0

    def add(self, one: Ints, other: Ints) -> None:
        """Those of (one, other) that may have a common stretch."""
        for low in range(0, len(one), AT_A_TIME):
            s, t = one[low : low + AT_A_TIME], other[low : low + AT_A_TIME]
            later, earlier = np.maximum(s, t), np.minimum(s, t)
            common = _have_common(self.a, self.b, later, earlier)
            self._found.append(later[common] * len(self.a) + earlier[common])
            self._waiting += len(self._found[-1])
            if self._waiting > max(self._kept, AT_A_TIME):
                self._compact()

    def _compact(self) -> None:
        """Each pair once; of more than MOST_PAIRS, for each later segment the same number with the earliest ones."""
        found = np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *self._found]))
        if len(found) > MOST_PAIRS:
            later = found // len(self.a)
            starts = np.flatnonzero(np.diff(later, prepend=-1))
            rank = np.arange(len(found)) - np.repeat(starts, np.diff(np.append(starts, len(found))))
            found = found[rank < max(1, MOST_PAIRS // len(starts))]
        self._found, self._kept, self._waiting = [found], len(found), 0

    def all(self) -> Ints:
        """The pairs (k, 2), later and earlier, in rising order."""
        self._compact()
        return np.stack(np.divmod(self._found[0], len(self.a)), axis=1)


def _from_one_vertex(pairs: _Pairs, vertex: Ints) -> None:
    """Add the segments that leave one vertex in about one direction. `vertex` (2 n,) numbers the ends, a's before b's.

    Sorted by angle such segments stand together, so that a star is not searched pair by pair.
    """
    a, b = pairs.a, pairs.b
    count = len(a)
    ends = np.flatnonzero(_may_share_direction(a, b, vertex))
    span = np.concatenate((b - a, a - b))[ends]
    angle = np.arctan2(span[:, 1], span[:, 0])
    wrapped = np.flatnonzero(angle < WIDEST_ANGLE - np.pi)  # these come after those just under pi as well
    segment = np.concatenate((ends, ends[wrapped])) % count
    at = vertex[np.concatenate((ends, ends[wrapped]))]
    angle = np.concatenate((angle, angle[wrapped] + 2 * np.pi))
    reach = np.minimum(4 * SAME_LINE_MM / np.hypot(span[:, 0], span[:, 1]), WIDEST_ANGLE)
    reach = np.concatenate((reach, reach[wrapped]))
    order = np.lexsort((angle, at))
    segment, at, angle, reach = segment[order], at[order], angle[order], reach[order]
    for step in (1, -1):  # each looks as far as its own reach, both ways
        here, there = np.arange(len(order)), np.arange(len(order))
        while len(here):
            there = there + step
            inside = (there >= 0) & (there < len(order))
            here, there = here[inside], there[inside]
            near = (at[here] == at[there]) & (np.abs(angle[there] - angle[here]) <= reach[here])
            here, there = here[near], there[near]
            other = segment[here] != segment[there]
            pairs.add(segment[here[other]], segment[there[other]])


def _may_share_direction(a: Array, b: Array, vertex: Ints) -> NDArray[np.bool_]:
    """For each end (2 n,) whether another segment there might go the same way: not where one just goes on from another."""
    degree = np.bincount(vertex)
    on = np.flatnonzero((b[:-1] == a[1:]).all(axis=1) & (degree[vertex[1 : len(a)]] == 2))
    onward = ((b[on] - a[on]) * (b[on + 1] - a[on + 1])).sum(axis=1) >= 0
    possible = degree[vertex] > 1
    possible[on[onward] + len(a)] = possible[on[onward] + 1] = False
    return possible


def _on_vertices(pairs: _Pairs, vertex: Ints) -> None:
    """Add the segments of which one ends on the other, but not in its end."""
    a, b = pairs.a, pairs.b
    count = len(a)
    tree, owner = _index(a, b)
    by_vertex = np.argsort(vertex, kind="stable")
    starts = np.searchsorted(vertex[by_vertex], np.arange(vertex.max() + 2))
    points = np.concatenate((a, b))[by_vertex[starts[:-1]]]
    for low, of, on in _near(tree, points):
        at, segment = low + of, owner[on]
        inside = (vertex[segment] != at) & (vertex[segment + count] != at)
        at, segment = at[inside], segment[inside]
        degree = starts[at + 1] - starts[at]
        parts = np.searchsorted(np.cumsum(degree), np.arange(AT_A_TIME, int(degree.sum()), AT_A_TIME))
        for part in np.split(np.arange(len(at)), parts):
            many = degree[part]
            nth = np.arange(int(many.sum())) - np.repeat(np.cumsum(many) - many, many)
            pairs.add(by_vertex[np.repeat(starts[at[part]], many) + nth] % count, np.repeat(segment[part], many))


def _near(tree: shapely.STRtree, points: Array) -> Iterator[tuple[int, Ints, Ints]]:
    """First of some points, and of each entry within reach of one of them the number of the point, from there, and its own."""
    low, size = 0, QUERY
    while low < len(points):
        some = shapely.points(points[low : low + size])
        if len(some) > 1:
            probe = some[:: -(-len(some) // PROBE)]
            found = tree.query(probe, predicate="dwithin", distance=SAME_LINE_MM).shape[1]
            if found * len(some) > AT_A_TIME * len(probe):
                size = len(some) // 2
                continue
        of, on = tree.query(some, predicate="dwithin", distance=SAME_LINE_MM)
        yield low, of, on
        low += len(some)
        size = min(2 * size, QUERY)


def _index(a: Array, b: Array) -> tuple[shapely.STRtree, Ints]:
    """A spatial index of the segments from a to b, and which segment each of its entries is of.

    Long ones are entered in pieces: the boxes of long slanting hatches would all lie over each other.
    """
    length = np.hypot(*(b - a).T)
    piece_mm = max(LONGEST_ENTRY_MM, float(length.sum()) / MOST_PIECES)
    count = np.maximum(np.ceil(length / piece_mm), 1).astype(np.int64)
    owner = np.repeat(np.arange(len(a)), count)
    nth = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    span = ((b - a) / count[:, None])[owner]
    head = a[owner] + nth[:, None] * span
    return shapely.STRtree(shapely.linestrings(np.stack((head, head + span), axis=1))), owner


def _have_common(a: Array, b: Array, s: Ints, t: Ints) -> NDArray[np.bool_]:
    """Whether segments s and t (k,) may run along each other for more than a point; `_covered` decides."""
    along_s, along_t = b[s] - a[s], b[t] - a[t]
    length_s, length_t = np.hypot(*along_s.T), np.hypot(*along_t.T)
    cross = np.abs(along_s[:, 0] * along_t[:, 1] - along_s[:, 1] * along_t[:, 0])
    parallel = cross <= 4 * SAME_LINE_MM * np.maximum(length_s, length_t)
    reach = np.stack([((end - a[s]) * along_s).sum(axis=1) / length_s for end in (a[t], b[t])])
    common = np.minimum(reach.max(axis=0), length_s) - np.maximum(reach.min(axis=0), 0.0)
    return np.asarray(parallel & (common > SAME_LINE_MM))


def _covered(a: Array, b: Array, other: Array, within_mm: float) -> Interval | None:
    """The part of the segment from a to b that lies along the segment `other` (2, 2), as fractions, or None."""
    span = b - a
    length = float(np.hypot(span[0], span[1]))
    along = span / length
    reach = (other - a) @ along
    aside = (other - a) @ np.array([-along[1], along[0]])
    if reach[0] > reach[1]:
        reach, aside = reach[::-1], aside[::-1]
    low, high = max(0.0, float(reach[0])), min(length, float(reach[1]))
    if high - low <= SAME_LINE_MM:
        return None
    if np.abs(np.interp((low, high), reach, aside)).max() > within_mm:
        return None
    return low / length, high / length


def _subtract(intervals: list[Interval], hole: Interval) -> list[Interval]:
    left = []
    for low, high in intervals:
        if low < min(high, hole[0]):
            left.append((low, min(high, hole[0])))
        if max(low, hole[1]) < high:
            left.append((max(low, hole[1]), high))
    return left


def _without_small_gaps(stroke: Stroke, left: dict[int, list[Interval]]) -> dict[int, list[Interval]]:
    """`left` with the gaps filled that are too short to be worth a lift, unless nothing of the stroke is left but they."""
    length = np.hypot(*np.diff(stroke.points_mm, axis=0).T)
    run = np.concatenate(([0.0], np.cumsum(length)))
    gaps: list[list[float]] = []  # begin and end along the stroke
    for k in sorted(left):
        edges = [0.0, *(edge for interval in left[k] for edge in interval), 1.0]
        for low, high in zip(edges[::2], edges[1::2], strict=True):
            begin, end = run[k] + low * length[k], run[k] + high * length[k]
            if gaps and begin - gaps[-1][1] <= SAME_LINE_MM:
                gaps[-1][1] = end
            elif high > low:
                gaps.append([begin, end])
    if sum(end - begin for begin, end in gaps) >= run[-1] - SAME_LINE_MM:
        return left
    wide = [(begin, end) for begin, end in gaps if end - begin >= LEAST_GAP_MM]
    return {k: part for k, part in left.items() if any(begin < run[k + 1] and end > run[k] for begin, end in wide)}


def _pieces(stroke: Stroke, left: dict[int, list[Interval]]) -> list[Stroke]:
    """What remains of a stroke, in its own order and direction; `left` names the segments that are not whole."""
    points, corners = stroke.points_mm, stroke.corners
    pieces: list[Stroke] = []
    run: list[Array] = []
    marks: list[bool] = []

    def finish() -> None:
        if len(run) > 1:
            known = None if corners is None else np.array([True, *marks[1:-1], True])
            pieces.append(Stroke(np.array(run), known, stroke.color))
        run.clear()
        marks.clear()

    for k in range(len(points) - 1):
        for low, high in left.get(k, [(0.0, 1.0)]):
            if low > 0.0:
                finish()
            if not run:
                run.append(points[k] + low * (points[k + 1] - points[k]))
                marks.append(True)
            run.append(points[k + 1] if high == 1.0 else points[k] + high * (points[k + 1] - points[k]))
            marks.append(high < 1.0 or corners is None or bool(corners[k + 1]))
            if high < 1.0:
                finish()
        if left.get(k) == []:
            finish()
    finish()
    return pieces
