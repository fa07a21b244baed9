"""Clips: areas in page millimetres outside of which nothing is drawn."""

from __future__ import annotations

from collections.abc import Iterable

import shapely
from shapely.geometry.base import BaseGeometry

from plotter.svg.cut import ON_BOUNDARY_MM, Piece, Region, cut
from plotter.svg.matrix import Matrix, apply

_MARGIN_MM = 2 * ON_BOUNDARY_MM


class Clip:
    """One clip. Its area and region are made when the first polyline is not plainly inside or outside of it."""

    def __init__(self, area: BaseGeometry | None, corners: tuple[tuple[float, float], ...] = ()) -> None:
        self._area = area
        self._corners = corners
        self._region: Region | None = None
        if area is None:
            xs, ys = [x for x, _ in corners], [y for _, y in corners]
            self.box = (min(xs), min(ys), max(xs), max(ys))
            self._is_box = all(x in (self.box[0], self.box[2]) and y in (self.box[1], self.box[3]) for x, y in corners)
            return
        bounds = shapely.bounds(area).tolist()
        self.box = (bounds[0], bounds[1], bounds[2], bounds[3])
        self._is_box = bool(area.area == (bounds[2] - bounds[0]) * (bounds[3] - bounds[1]))

    @classmethod
    def of_box(cls, matrix: Matrix, x: float, y: float, width: float, height: float) -> Clip:
        """The rectangle x, y, width, height in the units of `matrix`."""
        right, bottom = x + width, y + height
        return cls(None, (apply(matrix, x, y), apply(matrix, right, y), apply(matrix, right, bottom), apply(matrix, x, bottom)))

    @property
    def area(self) -> BaseGeometry:
        if self._area is None:
            self._area = shapely.Polygon(self._corners)
        return self._area

    @property
    def region(self) -> Region:
        if self._region is None:
            self._region = Region(self.area)
        return self._region

    def apply(self, piece: Piece) -> list[Piece]:
        """The parts of `piece` inside; what runs along the edge is kept, as half of its ink would show."""
        if self._area is not None and self._area.is_empty:
            return []
        low, high = piece.points.min(axis=0), piece.points.max(axis=0)
        left, top, right, bottom = self.box
        if not (low[0] <= right + _MARGIN_MM and high[0] >= left - _MARGIN_MM):
            return []
        if not (low[1] <= bottom + _MARGIN_MM and high[1] >= top - _MARGIN_MM):
            return []
        if self._is_box:
            if low[0] >= left and high[0] <= right and low[1] >= top and high[1] <= bottom:
                return [piece]
        elif bool(shapely.contains_properly(self.region.area, shapely.box(*low, *high))):
            return [piece]
        return cut(piece, self.region, inside=True, boundary=True)


def apply_clips(pieces: list[Piece], clips: Iterable[Clip]) -> list[Piece]:
    for clip in clips:
        if not pieces:
            return pieces
        pieces = [part for piece in pieces for part in clip.apply(piece)]
    return pieces


def clipped_area(area: BaseGeometry, clips: Iterable[Clip]) -> BaseGeometry:
    for clip in clips:
        area = shapely.intersection(area, clip.area)
    return area
