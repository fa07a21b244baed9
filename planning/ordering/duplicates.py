"""Lines that lie on each other are drawn once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from planning.geometry.stroke import Stroke
from planning.ordering.metric import Array
from planning.ordering.quick import is_dot

# Two lines nearer than this over their common length are one line: less than half a motor step of 0.0125 mm.
SAME_LINE_MM = 0.005

# What was drawn before is left out in stretches of at least this length: for less, a lift costs more than the ink.
LEAST_GAP_MM = 0.5

# A segment longer than this stands in the index in pieces; all segments together in at most so many.
LONGEST_ENTRY_MM = 5.0
MOST_PIECES = 500_000
# Vertices looked up at a time: bounds the memory.
QUERY = 50_000
# Segments of one vertex this far apart in direction (radians) are too short for their overlap to matter.
WIDEST_ANGLE = 0.1

Interval = tuple[float, float]
Ints = NDArray[np.int64]


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
    later, earlier = _overlapping(segments, vertex, present)
    left: dict[int, list[Interval]] = {}
    for s, t in zip(later.tolist(), earlier.tolist(), strict=True):  # by rising s: what is left of t is known by now
        for fractions in left.get(t, [(0.0, 1.0)]):
            ends = segments.a[t] + np.array(fractions)[:, None] * (segments.b[t] - segments.a[t])
            covered = _covered(segments.a[s], segments.b[s], ends)
            if covered is not None:
                left[s] = _subtract(left.get(s, [(0.0, 1.0)]), covered)
    sliver = SAME_LINE_MM / segments.length
    return {s: [i for i in intervals if i[1] - i[0] > sliver[s]] for s, intervals in left.items()}


def _overlapping(segments: _Segments, vertex: Ints, present: Ints) -> tuple[Ints, Ints]:
    """Pairs (later, earlier) of segments with a common stretch, by rising later. One of two such always ends on the other."""
    a, b = segments.a[present], segments.b[present]
    vertex = vertex.reshape(2, -1)[:, present].ravel()
    pairs = np.concatenate((_from_one_vertex(a, b, vertex), _on_vertices(a, b, vertex)))
    pairs = np.sort(pairs, axis=1)
    pairs = pairs[_have_common(a, b, pairs[:, 1], pairs[:, 0])]
    later, earlier = np.divmod(np.unique(pairs[:, 1] * len(a) + pairs[:, 0]), len(a))
    return present[later], present[earlier]


def _from_one_vertex(a: Array, b: Array, vertex: Ints) -> Ints:
    """Pairs (k, 2) of segments that leave one vertex in about one direction. `vertex` (2 n,) numbers the ends, a's before b's.

    Sorted by angle such segments stand together, so that a star is not searched pair by pair.
    """
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
    found = [np.zeros((0, 2), dtype=np.int64)]
    for step in (1, -1):  # each looks as far as its own reach, both ways
        here, there = np.arange(len(order)), np.arange(len(order))
        while len(here):
            there = there + step
            inside = (there >= 0) & (there < len(order))
            here, there = here[inside], there[inside]
            near = (at[here] == at[there]) & (np.abs(angle[there] - angle[here]) <= reach[here])
            here, there = here[near], there[near]
            other = segment[here] != segment[there]
            found.append(np.stack((segment[here[other]], segment[there[other]]), axis=1))
    return np.concatenate(found)


def _may_share_direction(a: Array, b: Array, vertex: Ints) -> NDArray[np.bool_]:
    """For each end (2 n,) whether another segment there might go the same way: not where one just goes on from another."""
    degree = np.bincount(vertex)
    on = np.flatnonzero((b[:-1] == a[1:]).all(axis=1) & (degree[vertex[1 : len(a)]] == 2))
    onward = ((b[on] - a[on]) * (b[on + 1] - a[on + 1])).sum(axis=1) >= 0
    possible = degree[vertex] > 1
    possible[on[onward] + len(a)] = possible[on[onward] + 1] = False
    return possible


def _on_vertices(a: Array, b: Array, vertex: Ints) -> Ints:
    """Pairs (k, 2) of segments of which one ends on the other, but not in its end."""
    count = len(a)
    tree, owner = _index(a, b)
    by_vertex = np.argsort(vertex, kind="stable")
    starts = np.searchsorted(vertex[by_vertex], np.arange(vertex.max() + 2))
    points = np.concatenate((a, b))[by_vertex[np.minimum(starts[:-1], 2 * count - 1)]]
    found = [np.zeros((0, 2), dtype=np.int64)]
    for low in range(0, len(points), QUERY):
        of, on = tree.query(shapely.points(points[low : low + QUERY]), predicate="dwithin", distance=SAME_LINE_MM)
        at, segment = low + of, owner[on]
        inside = (vertex[segment] != at) & (vertex[segment + count] != at)
        at, segment = at[inside], segment[inside]
        degree = starts[at + 1] - starts[at]
        nth = np.arange(int(degree.sum())) - np.repeat(np.cumsum(degree) - degree, degree)
        ending = by_vertex[np.repeat(starts[at], degree) + nth] % count
        found.append(np.stack((ending, np.repeat(segment, degree)), axis=1))
    return np.concatenate(found)


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


def _covered(a: Array, b: Array, other: Array) -> Interval | None:
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
    if np.abs(np.interp((low, high), reach, aside)).max() > SAME_LINE_MM:
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
