"""Hidden-line removal: opaque fills hide what was drawn before them."""

from __future__ import annotations

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from plotter.svg.cut import ON_BOUNDARY_MM, Piece, divide, meetings, runs
from plotter.svg.path_segments import Bools, Floats, Ints


class Occluders:
    """Opaque areas with their place in the painting order. Where the occluder's own outline is drawn, a line that runs along it
    is hidden too: the outline covers it. Add all areas first, then ask what is visible."""

    def __init__(self) -> None:
        self._areas: list[BaseGeometry] = []
        self._owners: list[int] = []
        self._covers_edge: list[bool] = []
        self._ready: _Index | None = None

    def add(self, owner: int, area: BaseGeometry, *, outlined: bool) -> None:
        if not area.is_empty:
            self._owners.append(owner)
            self._areas.append(area)
            self._covers_edge.append(outlined)

    def visible(self, piece: Piece, owner: int) -> list[Piece]:
        """What of `piece`, drawn with shape `owner`, no later area hides."""
        if not self._areas:
            return [piece]
        if self._ready is None:
            self._ready = _Index(self._areas, np.array(self._owners), np.array(self._covers_edge))
        return self._ready.visible(piece, owner)


class _Index:
    """The areas and all their edges in spatial trees."""

    def __init__(self, areas: list[BaseGeometry], owners: Ints, covers_edge: Bools) -> None:
        self._areas = np.array(areas)
        self._owners = owners
        self._covers_edge = covers_edge
        shapely.prepare(self._areas)
        self._tree = shapely.STRtree(self._areas)
        ends, area_of_edge = [np.zeros((0, 2, 2))], [np.zeros(0, np.int64)]
        for i, area in enumerate(areas):
            for ring in shapely.get_rings(shapely.get_parts(area)):
                at = shapely.get_coordinates(ring)
                ends.append(np.stack((at[:-1], at[1:]), axis=1))
                area_of_edge.append(np.full(len(at) - 1, i))
        self._ends = np.concatenate(ends)
        self._area_of_edge = np.concatenate(area_of_edge)
        self._edges = shapely.STRtree(shapely.linestrings(self._ends))

    def visible(self, piece: Piece, owner: int) -> list[Piece]:
        points = piece.points
        box = shapely.box(*points.min(axis=0), *points.max(axis=0))
        later = self._tree.query(box)
        later = later[self._owners[later] > owner]
        if not len(later):
            return [piece]
        if len(points) == 1:
            return [] if self._hidden(points, later, owner)[0] else [piece]
        if bool(shapely.contains_properly(self._areas[later], box).any()):
            return []
        segment, edge = self._edges.query(shapely.linestrings(np.stack((points[:-1], points[1:]), axis=1)))
        above = self._owners[self._area_of_edge[edge]] > owner
        segment, t = meetings(points, segment[above], self._ends[edge[above]])
        split, corner = divide(piece, segment, t) if len(segment) else (points, piece.corner)
        return runs(split, corner, ~self._hidden((split[:-1] + split[1:]) / 2, later, owner))

    def _hidden(self, points: Floats, later: Ints, owner: int) -> Bools:
        """Which points lie inside one of the areas `later`, or on an edge that its outline covers."""
        bare = later[~self._covers_edge[later]]
        on_bare = self._on_edges(points, owner, covering=False) if len(bare) else {}
        open_ = np.arange(len(points))
        x, y = np.ascontiguousarray(points[:, 0]), np.ascontiguousarray(points[:, 1])
        # The latest first: in a stack the topmost areas hide most.
        for one in later[np.argsort(-self._owners[later])].tolist():
            inside = shapely.contains_xy(self._areas[one], x[open_], y[open_])
            if one in on_bare:
                # Numbers cannot say whether a point on an edge is inside; where no outline covers it, it stays visible.
                inside &= ~np.isin(open_, on_bare[one])
            if inside.any():
                open_ = open_[~inside]
                if not len(open_):
                    break
        hidden = np.ones(len(points), bool)
        for covered in self._on_edges(points[open_], owner, covering=True).values():
            open_[covered] = -1
        hidden[open_[open_ >= 0]] = False
        return hidden

    def _on_edges(self, points: Floats, owner: int, *, covering: bool) -> dict[int, Ints]:
        """For each later area on whose edge one of `points` lies, the indices of those points; areas whose outline covers their
        edge, or those where it does not."""
        index, edge = self._edges.query(shapely.points(points), predicate="dwithin", distance=ON_BOUNDARY_MM)
        area = self._area_of_edge[edge]
        wanted = (self._owners[area] > owner) & (self._covers_edge[area] == covering)
        return {int(one): index[wanted & (area == one)] for one in np.unique(area[wanted])}
