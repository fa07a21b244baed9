"""Better routes by exchanging links: Lin-Kernighan moves, found for all nodes at once.

A move removes a link (t1, t2), adds (t2, t3), removes t3's link (t3, t4), adds (t4, t5) and so on, and closes with a link
from the last node to t1. As long as what was removed outweighs what was added, it is worth going on (Lin and Kernighan, An
Effective Heuristic Algorithm for the Traveling-Salesman Problem, 1973). 2-opt, Or-opt and 3-opt are the moves of two and three
links. A node has only one link that can be removed, so t4 follows from t3, and new ends are looked for among a node's nearest.

All nodes' moves are searched side by side in arrays, a level at a time. Then the best are carried out one by one, each only
if no move before it has touched its links; the nodes of those that were left out, and of the links that changed, are looked at
again in the next round.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planning.motion.late import tree_of
from planning.ordering.greedy import AT_ONE_POINT, Nodes, coincident
from planning.ordering.metric import Array, Metric
from planning.ordering.tour import Pair, Tour

# Nodes whose moves are searched together: bounds the memory.
CHUNK = 16384
LEAST_GAIN = 1e-7

# Asked between rounds of work: whether to leave it at that.
Stop = Callable[[], bool]


def never() -> bool:
    """Work until it is done."""
    return False


@dataclass(frozen=True, eq=False)
class Costs:
    """What a link between two nodes costs.

    When the route may end anywhere, a link to node 0 costs what `after`, for each node, says that comes after it: nothing.
    """

    points_mm: Array
    metric: Metric
    free_end: bool
    after: Array | None = None

    def __call__(self, a: Nodes, b: Nodes) -> Array:
        cost = self.metric(self.points_mm[a], self.points_mm[b])
        if not self.free_end:
            return cost
        if self.after is None:
            return np.where((a == 0) | (b == 0), 0.0, cost)
        return np.where(a == 0, self.after[b], np.where(b == 0, self.after[a], cost))


def near_nodes(points_mm: Array, count: int, free_end: bool) -> Nodes:
    """For each node its nearest nodes of other items, (2 m, count), nearest first."""
    first = 1 if free_end else 0
    order, rank = coincident(points_mm[first:])
    nodes = np.sort(order[rank < AT_ONE_POINT]) + first
    count = min(count, len(nodes) - 2)
    index = nodes[np.asarray(tree_of(points_mm[nodes]).query(points_mm, count + 2)[1]).reshape(len(points_mm), -1)]
    own = (index >> 1) == (np.arange(len(points_mm)) >> 1)[:, None]
    return np.take_along_axis(index, np.argsort(own, axis=1, kind="stable")[:, :count], axis=1)


def search(tour: Tour, near: Nodes, costs: Costs, active: Nodes, depth: int, width: int) -> tuple[Nodes, Array]:
    """The best move found from each active node that has one: (n, 2 depth) nodes, padded with -1, and its gain (n,).

    `width` bounds how many unfinished moves are kept for each active node and level.
    """
    moves, gains = [], []
    for k in range(0, len(active), CHUNK):
        move, gain = _search_chunk(tour, near, costs, active[k : k + CHUNK], depth, width)
        moves.append(move)
        gains.append(gain)
    return np.concatenate(moves), np.concatenate(gains)


def _search_chunk(tour: Tour, near: Nodes, costs: Costs, active: Nodes, depth: int, width: int) -> tuple[Nodes, Array]:
    breadth = near.shape[1]
    best_move = np.full((len(active), 2 * depth), -1, dtype=np.int64)
    best_gain = np.full(len(active), LEAST_GAIN)
    lane = np.arange(len(active))  # which active node each unfinished move belongs to
    chain = np.stack((tour.link[active], active), axis=1)  # (n, 2 level) its nodes t1, t2, ...
    credit = costs(chain[:, 0], chain[:, 1])  # removed less added
    for level in range(2, depth + 1):
        wide = np.repeat(np.arange(len(lane)), breadth)
        to = near[chain[:, -1]].ravel()
        rest = credit[wide] - costs(chain[wide, -1], to)
        keep = rest > LEAST_GAIN
        wide, to, rest = wide[keep], to[keep], rest[keep]
        fresh = (chain[wide] != to[:, None]).all(axis=1)
        wide, to, rest = wide[fresh], to[fresh], rest[fresh]
        far = tour.link[to]
        lane, credit = lane[wide], rest + costs(to, far)
        chain = np.concatenate((chain[wide], to[:, None], far[:, None]), axis=1)
        gain = credit - costs(far, chain[:, 0])
        promising = np.flatnonzero(gain > best_gain[lane])
        promising = promising[_leaves_one_tour(tour, chain[promising])]
        promising = promising[np.argsort(gain[promising], kind="stable")]  # of equal lanes the last assignment stays
        best_gain[lane[promising]] = gain[promising]
        best_move[lane[promising], : 2 * level] = chain[promising]
        best_move[lane[promising], 2 * level :] = -1
        if level < depth and len(lane) > width * len(active):
            kept = _widest(lane, credit, width)
            lane, chain, credit = lane[kept], chain[kept], credit[kept]
    found = best_move[:, 0] >= 0
    return best_move[found], best_gain[found]


def _widest(lane: Nodes, credit: Array, width: int) -> Nodes:
    """Rows of the `width` greatest credits of each lane."""
    order = np.lexsort((-credit, lane))
    starts = np.flatnonzero(np.diff(lane[order], prepend=-1))
    rank = np.arange(len(order)) - np.repeat(starts, np.diff(np.append(starts, len(order))))
    return order[rank < width]


def _leaves_one_tour(tour: Tour, chain: Nodes) -> NDArray[np.bool_]:
    """Whether each move (rows of t1, t2, ...) leaves one tour and not several.

    Cut at the removed links the tour falls into as many paths; going along a path, then over the added link at its end, and
    so on, must visit them all before it comes back.
    """
    rows, width = chain.shape
    if rows == 0:
        return np.zeros(0, dtype=np.bool_)
    item = chain >> 1
    entered = tour.entries[tour.place[item]] == chain
    # Twice the place, so that an item's entry stands before its exit: round the tour the 2 k nodes are entry, exit, entry, ...
    rank = np.argsort(2 * tour.place[item] + ~entered, axis=1)
    where = np.empty_like(rank)
    np.put_along_axis(where, rank, np.broadcast_to(np.arange(width), rank.shape), axis=1)
    # Column j of `where` is the standing of t(j+1). Paths join an entry to the next exit in standing.
    first_is_entry = np.take_along_axis(entered, rank[:, :1], axis=1)[:, 0]
    standing = np.arange(width)
    along = np.where(first_is_entry[:, None], standing ^ 1, ((standing + 1) ^ 1) - 1) % width
    over = np.empty_like(rank)
    after = where[:, 1:].copy()
    after = np.concatenate((after, where[:, :1]), axis=1)
    np.put_along_axis(over, where[:, 1::2], after[:, 1::2], axis=1)
    np.put_along_axis(over, after[:, 1::2], where[:, 1::2], axis=1)
    row = np.arange(rows)
    at = np.zeros(rows, dtype=np.int64)
    whole = np.ones(rows, dtype=np.bool_)
    for step in range(width // 2):
        at = over[row, along[row, at]]
        if step < width // 2 - 1:
            whole &= at != 0
    return np.asarray(whole & (at == 0))


@dataclass(frozen=True, slots=True)
class Exchange:
    """What one move changed: links taken out, links put in, and the cost that saved."""

    removed: list[Pair]
    added: list[Pair]
    gain: float


@dataclass(frozen=True, slots=True)
class Effort:
    """How hard to look: links of a node looked at, links in one move, unfinished moves kept per node."""

    breadth: int
    depth: int
    width: int


def improve(tour: Tour, near: Nodes, costs: Costs, effort: Effort, active: Nodes, stop: Stop = never) -> list[Exchange]:
    """Carry out improving moves until none is found from the active nodes, nor from any they lead to. Returns them in turn."""
    done: list[Exchange] = []
    near = near[:, : effort.breadth]
    while len(active) and not stop():
        moves, gains = search(tour, near, costs, active, effort.depth, effort.width)
        touched: set[int] = set()
        best_first = np.argsort(-gains, kind="stable")
        again: list[int] = []
        before = len(done)
        for row, gain in zip(moves[best_first].tolist(), gains[best_first].tolist(), strict=True):
            nodes = row[: row.index(-1)] if row[-1] == -1 else row
            removed = list(zip(nodes[::2], nodes[1::2], strict=True))
            added = list(zip(nodes[1::2], nodes[2::2] + nodes[:1], strict=True))
            if not touched.isdisjoint(nodes) or not tour.exchange(removed, added):
                again.append(nodes[1])
                continue
            done.append(Exchange(removed, added, gain))
            touched.update(nodes)
        if len(done) == before:
            break
        active = np.array(sorted(touched.union(again)), dtype=np.int64)
    return done
