"""Hidden-line removal: opaque fills hide what was drawn before them."""

from __future__ import annotations

import shapely
from shapely.geometry.base import BaseGeometry

from plotter.svg.cut import Piece, Region, cut


class Occluders:
    """Opaque areas with their place in the painting order. Where the occluder's own outline is drawn, a line that runs along it
    is hidden too: the outline covers it."""

    def __init__(self) -> None:
        self._areas: list[BaseGeometry] = []
        self._owner: list[int] = []
        self._outlined: list[bool] = []
        self._regions: dict[int, Region] = {}
        self._tree: shapely.STRtree | None = None

    def add(self, owner: int, area: BaseGeometry, *, outlined: bool) -> None:
        if not area.is_empty:
            self._owner.append(owner)
            self._areas.append(area)
            self._outlined.append(outlined)

    def visible(self, piece: Piece, owner: int) -> list[Piece]:
        """What of `piece`, drawn with shape `owner`, no later area hides."""
        if self._tree is None:
            self._tree = shapely.STRtree(self._areas)
        if not self._areas:
            return [piece]
        box = shapely.box(*piece.points.min(axis=0), *piece.points.max(axis=0))
        pieces = [piece]
        for index in sorted(self._tree.query(box).tolist()):
            if self._owner[index] <= owner or not pieces:
                continue
            region = self._regions.get(index)
            if region is None:
                region = self._regions[index] = Region(self._areas[index])
            pieces = [part for one in pieces for part in cut(one, region, inside=False, boundary=not self._outlined[index])]
        return pieces
