"""Out of a local optimum: disturb the route in many places, repair it, and keep what came out shorter.

Each disturbance is a double bridge: four links near each other along the route are exchanged so that the two middle parts
change places. No Lin-Kernighan move of few links takes it back directly (Martin, Otto and Felten, Large-Step Markov Chains
for the Traveling Salesman Problem, 1991). A drawing is large and a disturbance small, so a round makes many of them, far
apart. Exchanges that touch the same nodes belong together; a set of them that made the route longer is taken back, the
others stay.
"""

from __future__ import annotations

import math

import numpy as np

from planning.ordering.greedy import Nodes
from planning.ordering.improve import LEAST_GAIN, Costs, Effort, Exchange, Stop, improve, never
from planning.ordering.tour import Pair, Tour

# The four links lie within this many places of the route.
REACH = 50
# Most disturbances in a round: one in so many places.
SPACING = 100


def kick(
    tour: Tour, near: Nodes, costs: Costs, effort: Effort, kicks: int, rng: np.random.Generator, stop: Stop = never
) -> float:
    """Disturb and repair the route `kicks` times in all. Returns the cost saved, never negative."""
    count = len(tour.entries)
    if count < 8:
        return 0.0
    saved = 0.0
    each = max(1, count // SPACING)
    while kicks > 0 and not stop():
        saved += _round(tour, near, costs, effort, min(each, kicks), rng)
        kicks -= each
    return saved


def _round(tour: Tour, near: Nodes, costs: Costs, effort: Effort, kicks: int, rng: np.random.Generator) -> float:
    before = tour.entries.copy()
    done = _disturb(tour, costs, kicks, rng)
    active = np.array(sorted({node for exchange in done for pair in exchange.removed for node in pair}), dtype=np.int64)
    done += improve(tour, near, costs, effort, active)
    won = [together for together in _together(done) if _gain(together) > LEAST_GAIN]
    tour.restore(before)
    return math.fsum(_gain(together) for together in won if _carry_out(tour, together))


def _gain(exchanges: list[Exchange]) -> float:
    return math.fsum(exchange.gain for exchange in exchanges)


def _carry_out(tour: Tour, exchanges: list[Exchange]) -> bool:
    """All of the exchanges or, when one of them does not leave one tour without those that are not made again, none."""
    for k, exchange in enumerate(exchanges):
        if not tour.exchange(exchange.removed, exchange.added):
            for made in reversed(exchanges[:k]):
                tour.exchange(made.added, made.removed)
            return False
    return True


def _disturb(tour: Tour, costs: Costs, kicks: int, rng: np.random.Generator) -> list[Exchange]:
    """Double bridges at random places, no two of which overlap."""
    count = len(tour.entries)
    reach = min(REACH, count - 1)
    first = (rng.integers(count) + np.arange(kicks) * (count // kicks)) % count
    cuts = np.sort(rng.permuted(np.tile(np.arange(reach), (kicks, 1)), axis=1)[:, :4], axis=1)
    places = (first[:, None] + cuts) % count
    a, b = tour.entries[places] ^ 1, tour.entries[(places + 1) % count]  # the links from a to b
    crossed = b[:, [2, 3, 0, 1]]
    gain = (costs(a.ravel(), b.ravel()) - costs(a.ravel(), crossed.ravel())).reshape(a.shape).sum(axis=1)
    done = []
    for left, right, across, saved in zip(a.tolist(), b.tolist(), crossed.tolist(), gain.tolist(), strict=True):
        removed, added = list(zip(left, right, strict=True)), list(zip(left, across, strict=True))
        if tour.exchange(removed, added):
            done.append(Exchange(removed, added, saved))
    return done


def _together(done: list[Exchange]) -> list[list[Exchange]]:
    """The exchanges in sets that have no node in common, each in the order in which they were made."""
    parent = list(range(len(done)))

    def root(of: int) -> int:
        while parent[of] != of:
            parent[of] = parent[parent[of]]
            of = parent[of]
        return of

    owner: dict[int, int] = {}
    for k, exchange in enumerate(done):
        for node in _ends(exchange.removed):
            if node in owner:
                parent[root(owner[node])] = k
            owner[node] = k
    sets: dict[int, list[Exchange]] = {}
    for k, exchange in enumerate(done):
        sets.setdefault(root(k), []).append(exchange)
    return list(sets.values())


def _ends(pairs: list[Pair]) -> list[int]:
    return [node for pair in pairs for node in pair]
