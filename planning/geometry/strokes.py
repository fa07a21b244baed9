"""Many strokes side by side in arrays.

A drawing of 100,000 strokes is read, placed, checked and opened without making 100,000 objects: a Stroke is made of those only
that somebody asks for. What is asked of all of them, their ends and lengths, is answered from the arrays.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import overload

import numpy as np
from numpy.typing import NDArray

from planning.geometry.stroke import Mask, Points, Stroke

Ints = NDArray[np.int64]


class Strokes(Sequence[Stroke]):
    """k strokes in millimetres, a sequence of Stroke.

    `points_mm` (N, 2) and `corners` (N,) hold those of one stroke after the other; stroke i has rows `offset[i]` to
    `offset[i + 1]` (k + 1,), at least one. Its colour is `palette[color[i]]`, with each colour once in the palette.

    Raises ValueError for shapes that do not fit together, or a coordinate that is not finite.
    """

    __slots__ = ("_lengths_mm", "color", "corners", "offset", "palette", "points_mm")

    def __init__(self, points_mm: Points, corners: Mask, offset: Ints, color: Ints, palette: tuple[str | None, ...]) -> None:
        count = len(points_mm)
        if points_mm.shape != (count, 2) or corners.shape != (count,) or len(offset) != len(color) + 1:
            raise ValueError(
                f"points {points_mm.shape}, corners {corners.shape}, offsets {offset.shape}, colours {color.shape} do not match"
            )
        if offset[0] != 0 or offset[-1] != count or (np.diff(offset) < 1).any():
            raise ValueError(f"offsets must rise from 0 to {count}")
        if not np.isfinite(points_mm).all():
            raise ValueError("strokes' points must be finite")
        self.points_mm, self.corners, self.offset, self.color, self.palette = points_mm, corners, offset, color, palette
        self._lengths_mm: Points | None = None

    def __len__(self) -> int:
        return len(self.color)

    @overload
    def __getitem__(self, index: int) -> Stroke: ...
    @overload
    def __getitem__(self, index: slice) -> Strokes: ...
    def __getitem__(self, index: int | slice) -> Stroke | Strokes:
        if isinstance(index, slice):
            return self.take(np.arange(len(self))[index])
        at = range(len(self))[index]
        begin, end = self.offset[at : at + 2].tolist()
        return Stroke(self.points_mm[begin:end], self.corners[begin:end], self.palette[self.color[at]])

    def __iter__(self) -> Iterator[Stroke]:
        points, corners, palette, offset = self.points_mm, self.corners, self.palette, self.offset.tolist()
        for begin, end, color in zip(offset, offset[1:], self.color.tolist(), strict=False):
            yield Stroke(points[begin:end], corners[begin:end], palette[color])

    @property
    def sizes(self) -> Ints:
        """How many points each has, (k,)."""
        return np.diff(self.offset)

    @property
    def lengths_mm(self) -> Points:
        """How long each is, (k,); reckoned once, as the opening and the progress bar both ask."""
        if self._lengths_mm is None:
            self._lengths_mm = _lengths_mm(self.points_mm, self.sizes)
        return self._lengths_mm

    @property
    def colors(self) -> tuple[str | None, ...]:
        """The colours there are, in the order of their first strokes."""
        return tuple(self.palette[self.color[i]] for i in np.sort(np.unique(self.color, return_index=True)[1]).tolist())

    def take(self, rows: Ints) -> Strokes:
        """The strokes of these numbers, in this order."""
        size = self.sizes[rows]
        offset = np.concatenate(([0], np.cumsum(size)))
        if len(rows) and (np.diff(rows) == 1).all():  # they lie one after the other, and need no copy
            there = slice(int(self.offset[rows[0]]), int(self.offset[rows[-1] + 1]))
            return Strokes(self.points_mm[there], self.corners[there], offset, self.color[rows], self.palette)
        at = np.repeat(self.offset[rows] - offset[:-1], size) + np.arange(offset[-1])
        return Strokes(self.points_mm[at], self.corners[at], offset, self.color[rows], self.palette)

    def moved_to(self, points_mm: Points) -> Strokes:
        """The same strokes with other points, (N, 2)."""
        return Strokes(points_mm, self.corners, self.offset, self.color, self.palette)

    @staticmethod
    def joined(parts: Sequence[Strokes]) -> Strokes:
        """The strokes of all `parts`, which share one palette."""
        if len(parts) == 1:
            return parts[0]
        sizes = np.concatenate([part.sizes for part in parts])
        return Strokes(
            np.concatenate([part.points_mm for part in parts]),
            np.concatenate([part.corners for part in parts]),
            np.concatenate(([0], np.cumsum(sizes))),
            np.concatenate([part.color for part in parts]),
            parts[0].palette,
        )


def sizes(strokes: Sequence[Stroke]) -> Ints:
    """How many points each stroke has, (n,)."""
    if isinstance(strokes, Strokes):
        return strokes.sizes
    return np.array([len(stroke.points_mm) for stroke in strokes], dtype=np.int64)


def ends_mm(strokes: Sequence[Stroke]) -> Points:
    """Each stroke's first and last point, (n, 2, 2)."""
    if isinstance(strokes, Strokes):
        return np.stack((strokes.points_mm[strokes.offset[:-1]], strokes.points_mm[strokes.offset[1:] - 1]), axis=1)
    return np.array([(stroke.points_mm[0], stroke.points_mm[-1]) for stroke in strokes], dtype=np.float64).reshape(-1, 2, 2)


def lengths_mm(strokes: Sequence[Stroke]) -> Points:
    """Each stroke's length, (n,)."""
    if isinstance(strokes, Strokes):
        return strokes.lengths_mm
    return _lengths_mm(all_points_mm(strokes), sizes(strokes))


def _lengths_mm(points_mm: Points, size: Ints) -> Points:
    if not len(size):
        return np.zeros(0)
    step = np.diff(points_mm, axis=0)
    way = np.empty(len(points_mm))
    way[:-1] = np.sqrt(step[:, 0] ** 2 + step[:, 1] ** 2)  # several times as fast as hypot, which guards numbers beyond 1e150
    end = np.cumsum(size)
    way[end - 1] = 0.0  # from one stroke to the next
    return np.asarray(np.add.reduceat(way, end - size))


def all_points_mm(strokes: Sequence[Stroke]) -> Points:
    """The points of all strokes one after the other, (N, 2)."""
    if isinstance(strokes, Strokes):
        return strokes.points_mm
    return np.concatenate([np.zeros((0, 2)), *(stroke.points_mm for stroke in strokes)])


def box_mm(points_mm: Points) -> tuple[float, float, float, float]:
    """(left, top, right, bottom) of points (n, 2), at least one. By column, which numpy takes in 30 times as fast as by row."""
    x, y = points_mm[:, 0], points_mm[:, 1]
    return float(x.min()), float(y.min()), float(x.max()), float(y.max())


def chosen(strokes: Sequence[Stroke], rows: Ints) -> Sequence[Stroke]:
    """The strokes of these numbers, in this order."""
    if isinstance(strokes, Strokes):
        return strokes.take(rows)
    return [strokes[k] for k in rows.tolist()]


def by_color(strokes: Sequence[Stroke]) -> list[Sequence[Stroke]]:
    """Strokes of one colour together, in the order of the colours' first strokes."""
    if isinstance(strokes, Strokes):
        codes, first = np.unique(strokes.color, return_index=True)
        if len(codes) == 1:
            return [strokes]
        return [strokes.take(np.flatnonzero(strokes.color == code)) for code in codes[np.argsort(first)]]
    groups: dict[str | None, list[Stroke]] = {}
    for stroke in strokes:
        groups.setdefault(stroke.color, []).append(stroke)
    return list(groups.values())


def together(parts: Iterable[Sequence[Stroke]]) -> Sequence[Stroke]:
    """All strokes of all `parts`."""
    found = list(parts)
    arrays = [part for part in found if isinstance(part, Strokes)]
    if arrays and len(arrays) == len(found) and all(part.palette == arrays[0].palette for part in arrays):
        return Strokes.joined(arrays)
    return [stroke for part in found for stroke in part]
