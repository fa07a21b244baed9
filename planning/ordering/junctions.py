"""Where stroke ends meet, and which of them the pen should draw through.

Strokes are the edges of a graph and junctions its nodes. A set of edges that hang together and has k > 0 odd nodes can be
drawn in k / 2 strokes and not in fewer; with none it is one closed stroke. The pairing below reaches that least number: at
each junction the ends are paired so that as few as possible are left, straight on where there is a choice; what then runs
in a circle is spliced into whatever passes through one of its junctions.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from planning.motion.late import hanging_together, tree_of
from planning.ordering.metric import Array

Ints = NDArray[np.int64]
Pass = tuple[int, int]  # two ends between which the pen goes through a junction; the second may be -1

# Halvings of the tolerance before ends count as meeting only where they are equal.
HALVINGS = 5
# More neighbours than this per point on average, and the points are first gathered in cells.
CROWDED = 30


def junctions(ends_mm: Array, tolerance_mm: float) -> Ints:
    """A number for each end, (n,), equal for ends that meet. No two ends of one junction are further apart than the tolerance.

    Chains of near points longer than the tolerance are taken apart at a smaller distance instead of being joined end to end.
    """
    points, label = np.unique(ends_mm + 0.0, axis=0, return_inverse=True)
    label = label.ravel().astype(np.int64)
    if len(points) < 2 or tolerance_mm <= 0:
        return label
    group = np.zeros(len(points), dtype=np.int64)  # points in different groups never meet
    wide = np.ones(len(points), dtype=bool)  # points whose group may still be too wide
    reach = tolerance_mm
    for _ in range(HALVINGS):
        chosen = np.flatnonzero(wide)
        part = _chains(points[chosen], reach)
        group[chosen] = group.max() + 1 + part
        wide[chosen] = _diameters(points[chosen], part) > tolerance_mm
        if not wide.any():
            break
        reach /= 2
    chosen = np.flatnonzero(wide)
    group[chosen] = group.max() + 1 + np.arange(len(chosen))
    return np.unique(group, return_inverse=True)[1].ravel().astype(np.int64)[label]


def _chains(points: Array, reach: float) -> Ints:
    """Numbers of the sets of points linked by steps of at most `reach`."""
    tree = tree_of(points)
    if tree.count_neighbors(tree, reach) > CROWDED * len(points):
        cells, inverse = np.unique(np.floor(points / (reach / 3)), axis=0, return_inverse=True)
        return _chains(cells * (reach / 3), reach / 2)[inverse.ravel()] if len(cells) < len(points) else np.arange(len(points))
    pairs = tree.query_pairs(reach, output_type="ndarray")
    return hanging_together(pairs[:, 0], pairs[:, 1], len(points))


def _diameters(points: Array, part: Ints) -> Array:
    """For each point the diagonal of the box around its part."""
    order = np.argsort(part, kind="stable")
    starts = np.flatnonzero(np.diff(part[order], prepend=-1))
    spread = np.maximum.reduceat(points[order], starts) - np.minimum.reduceat(points[order], starts)
    return np.asarray(np.hypot(spread[:, 0], spread[:, 1]))[np.unique(part, return_inverse=True)[1].ravel()]


def pair_ends(junction: Ints, tangents: Array, through: Ints | None = None) -> Ints:
    """For each end the end that the pen goes on to, or -1: (2 n,) for n strokes whose ends are rows 2 i and 2 i + 1.

    `junction` (2 n,) from `junctions`; `tangents` (2 n, 2) unit vectors from each end into its stroke. `through` (2 n,)
    fixes pairs beforehand (-1 where free). The number of trails that remain is the least there is.
    """
    mate = np.full(len(junction), -1, dtype=np.int64) if through is None else through.copy()
    into = tangents.tolist()
    for node in _members(junction, mate == -1):
        if len(node) == 2:
            mate[node] = node[::-1]
        elif len(node) <= 6:
            _take_pairs(sorted(_bends(node, into)), mate)
        else:
            _pair_many(np.array(node), tangents, mate)
    _splice_rings(junction, tangents, mate)
    return mate


def _members(junction: Ints, allowed: NDArray[np.bool_]) -> list[list[int]]:
    """The ends of every junction that has at least two of those allowed."""
    chosen = np.flatnonzero(allowed)
    order = chosen[np.argsort(junction[chosen], kind="stable")]
    starts = np.flatnonzero(np.diff(junction[order], prepend=-1))
    bounds = [*starts.tolist(), len(order)]
    ends = order.tolist()
    return [ends[a:b] for a, b in pairwise(bounds) if b - a > 1]


def _bends(node: list[int], into: list[list[float]]) -> list[tuple[float, int, int]]:
    """All pairs of a junction's ends and how far each bends. A stroke is closed on itself only as a last choice."""
    return [
        (into[a][0] * into[b][0] + into[a][1] * into[b][1] + 4.0 * (a ^ 1 == b), a, b)
        for k, a in enumerate(node)
        for b in node[k + 1 :]
    ]


def _pair_many(node: Ints, tangents: Array, mate: Ints) -> None:
    """`_bends` for many ends. In a large star, opposite in angle is straight on, without looking at every pair."""
    into = tangents[node]
    if len(node) > 64:
        turned = node[np.argsort(np.arctan2(into[:, 1], into[:, 0]), kind="stable")]
        half = len(node) // 2
        row, column = turned[:half], turned[half : 2 * half]
        bend = np.zeros(half)
    else:
        a, b = np.triu_indices(len(node), 1)
        row, column = node[a], node[b]
        bend = (into @ into.T)[a, b] + 4.0 * (row ^ 1 == column)
    best = np.argsort(bend, kind="stable")
    _take_pairs(zip(bend[best].tolist(), row[best].tolist(), column[best].tolist(), strict=True), mate)


def _take_pairs(pairs: Iterable[tuple[float, int, int]], mate: Ints) -> None:
    """Pair the ends in this order, each once. Changes `mate`."""
    for _, a, b in pairs:
        if mate[a] == -1 and mate[b] == -1:
            mate[a], mate[b] = b, a


def trails(mate: Ints) -> list[list[int]]:
    """The strokes of each trail as the ends by which they are entered, open trails and rings, by their first stroke."""
    follow: list[int] = mate.tolist()
    seen = bytearray(len(follow) // 2)
    found = []
    for first in range(0, len(follow), 2):
        if seen[first >> 1]:
            continue
        start = first  # walk back to the trail's beginning, or once round
        while follow[start] != -1:
            start = follow[start] ^ 1
            if start == first:
                break
        trail = []
        node = start
        while node != -1 and not seen[node >> 1]:
            seen[node >> 1] = 1
            trail.append(node)
            node = follow[node ^ 1]
        found.append(trail)
    return found


def pair_near(ends_mm: Array, mate: Ints, tolerance_mm: float) -> None:
    """Pair the ends that are still free, the nearest first, up to the tolerance; no ring is made. Changes `mate`."""
    free = np.flatnonzero(mate == -1)
    if len(free) < 3 or tolerance_mm <= 0:
        return
    tail = {}
    for trail in trails(mate):
        tail[trail[0]], tail[trail[-1] ^ 1] = trail[-1] ^ 1, trail[0]
    near = min(9, len(free))
    found = tree_of(ends_mm[free]).query(ends_mm[free], near, distance_upper_bound=tolerance_mm)
    distance, index = np.asarray(found[0]), np.asarray(found[1])
    row, column = np.nonzero(np.isfinite(distance) & (index != np.arange(len(free))[:, None]))
    for k in np.argsort(distance[row, column], kind="stable").tolist():
        a, b = int(free[row[k]]), int(free[index[row[k], column[k]]])
        if mate[a] == -1 and mate[b] == -1 and tail[a] != b:
            mate[a], mate[b] = b, a
            far_a, far_b = tail[a], tail[b]
            tail[far_a], tail[far_b] = far_b, far_a


def _splice_rings(junction: Ints, tangents: Array, mate: Ints) -> None:
    """Exchange pairs at junctions where a ring meets another trail, so that the two become one."""
    owner = np.empty(len(mate) // 2, dtype=np.int64)
    ring: list[bool] = []
    for number, trail in enumerate(trails(mate)):
        owner[np.array(trail) >> 1] = number
        ring.append(bool(mate[trail[0]] != -1))
    if not any(ring):
        return
    parent = list(range(len(ring)))

    def root(of: int) -> int:
        while parent[of] != of:
            parent[of] = parent[parent[of]]
            of = parent[of]
        return of

    touched = np.unique(junction[np.repeat(np.array(ring)[owner], 2)])
    for node in _members(junction, np.isin(junction, touched)):
        kept: list[Pass] = []  # one pass through this junction for each trail met so far
        passes = [(a, int(mate[a])) for a in node if mate[a] == -1 or (mate[a] > a and junction[mate[a]] == junction[a])]
        for a, b in passes:
            own = root(int(owner[a >> 1]))
            for k, (c, d) in enumerate(kept):
                other = root(int(owner[c >> 1]))
                if other != own and (ring[own] or ring[other]) and not (b == -1 and d == -1):
                    a_new, kept[k] = _exchange((a, b), (c, d), tangents, mate)
                    parent[other] = own
                    ring[own] = ring[own] and ring[other]
                    a, b = a_new
            kept.append((a, b))


def _exchange(
    first: tuple[int, int], second: tuple[int, int], tangents: Array, mate: Ints
) -> tuple[tuple[int, int], tuple[int, int]]:
    """Pair two passes through a junction the other way, the straighter of the two ways; -1 stands for no stroke."""
    (a, b), (c, d) = first, second

    def bend(u: int, v: int) -> float:
        return 0.0 if u == -1 or v == -1 else float(tangents[u] @ tangents[v])

    if bend(a, d) + bend(b, c) < bend(a, c) + bend(b, d):
        c, d = d, c
    for u, v in ((a, c), (b, d)):
        if u != -1:
            mate[u] = v
        if v != -1:
            mate[v] = u
    made = [pair if pair[0] != -1 else (pair[1], -1) for pair in ((a, c), (b, d))]
    return made[0], made[1]
