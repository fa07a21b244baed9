"""A closed tour through items with two ends each, and the exchange of some of its links for others.

Nodes, items and the start's item are as in `greedy`. Every node has one link, to a node of the item before or after; the stroke
itself is the other edge of each node and is never exchanged.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planning.ordering.greedy import Nodes

Pair = tuple[int, int]


class Tour:
    """`entries` (m,): nodes by which the items are entered, round the tour. `place` (m,): where each item stands in `entries`.

    `link` (2 m,): the node at the other end of each node's link. All three change with every exchange.
    """

    def __init__(self, route: Nodes) -> None:
        self.entries = np.empty(len(route), dtype=np.int64)
        self.place = np.empty(len(route), dtype=np.int64)
        self.link = np.empty(2 * len(route), dtype=np.int64)
        # Single elements are read and written several times faster through these.
        self._entries = self.entries.data
        self._place = self.place.data
        self._link = self.link.data
        self.restore(route)

    def restore(self, entries: Nodes) -> None:
        """Take the items in the order of `entries` (m,) from now on."""
        self.entries[:] = entries
        self.place[self.entries >> 1] = np.arange(len(entries))
        onward = np.roll(self.entries, -1)
        self.link[self.entries ^ 1] = onward
        self.link[onward] = self.entries ^ 1

    def route(self) -> Nodes:
        """The entry nodes from the start's item on, which is entered at node 0 and left at node 1."""
        turned = np.roll(self.entries, -int(self.place[0]))
        if turned[0] != 0:
            turned = np.roll((turned ^ 1)[::-1], 1)
        return turned

    def exchange(self, removed: Sequence[Pair], added: Sequence[Pair]) -> bool:
        """Put the links `added` in the place of the links `removed`, which end in the same nodes.

        Returns False, and changes nothing, when that would not leave one tour. Costs at most a pass over all but the longest of
        the paths between removed links. The same call with the two turned round undoes it.
        """
        count = len(self.entries)
        joined = dict(added)
        joined.update([(b, a) for a, b in added])
        # Each removed link by the place of the item it leaves, and the two nodes in the tour's direction.
        cuts = []
        for a, b in removed:
            at = self._place[a >> 1]
            cuts.append((self._place[b >> 1], b, a) if self._entries[at] == a else (at, a, b))
        cuts.sort()
        paths = []  # (first place, last place, first node, last node), in the tour's order
        last_place, _, first_node = cuts[-1]
        longest, base = -1, 0
        for k, (place, exit_node, entry_node) in enumerate(cuts):
            paths.append(((last_place + 1) % count, place, first_node, exit_node))
            length = (place - last_place) % count
            if length > longest:
                longest, base = length, k
            last_place, first_node = place, entry_node
        by_end = {}
        for k, (_, _, head, foot) in enumerate(paths):
            by_end[head] = (k, False)
            by_end[foot] = (k, True)
        parts: list[tuple[int, bool]] = []
        node = joined[paths[base][3]]
        while True:
            k, backwards = by_end[node]
            if k == base:
                if backwards or len(parts) != len(paths) - 1:
                    return False
                break
            parts.append((k, backwards))
            if len(parts) == len(paths):
                return False
            node = joined[paths[k][2] if backwards else paths[k][3]]
        self._rewrite((paths[base][1] + 1) % count, [(paths[k][0], paths[k][1], backwards) for k, backwards in parts])
        for a, b in joined.items():
            self._link[a] = b
        return True

    def _rewrite(self, at: int, parts: list[tuple[int, int, bool]]) -> None:
        """Write the parts, given by their first and last places, one after the other from place `at` on."""
        pieces = []
        for first, last, backwards in parts:
            piece = (
                self.entries[first : last + 1]
                if first <= last
                else np.concatenate((self.entries[first:], self.entries[: last + 1]))
            )
            pieces.append((piece ^ 1)[::-1] if backwards else piece)
        new = pieces[0].copy() if len(pieces) == 1 else np.concatenate(pieces)
        end = at + len(new)
        count = len(self.entries)
        if end <= count:
            self.entries[at:end] = new
            self.place[new >> 1] = np.arange(at, end)
        else:
            places = np.arange(at, end) % count
            self.entries[places] = new
            self.place[new >> 1] = places
