"""Flattened shapes to strokes: fills closed, dashes, clips, hidden lines and the page's edge, in this order."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from output.wording import counted
from planning.geometry.strokes import Strokes
from plotter.errors import BadInput
from plotter.svg.clip import Clip, apply_clips, clipped_area
from plotter.svg.clip_paths import shape_areas
from plotter.svg.collector import Shape, different_shapes
from plotter.svg.cut import Piece, dash, dash_count
from plotter.svg.dashes import Dashes, user_lengths
from plotter.svg.flatten import Polylines
from plotter.svg.matrix import IDENTITY
from plotter.svg.notes import Notes
from plotter.svg.occlude import Occluders
from plotter.svg.options import ReadOptions
from plotter.svg.path_segments import Bools, Floats
from plotter.svg.style import Style


@dataclass(frozen=True, eq=False, slots=True)
class _Part:
    """Strokes of one layer: the place of each in the painting order, how many points it has, its colour; and all points."""

    order: NDArray[np.int64]
    size: NDArray[np.int64]
    color: NDArray[np.int64]
    points: Floats
    corner: Bools


class _Looks:
    """What there is to know of each shape besides its outline, in arrays over the shapes.

    `order` in which they are painted, `layer`, `color` as an index into `palette`, whether they must be `worked` on one by one,
    and whether they are `dotless`, drawn only where they have some length.
    """

    def __init__(self, shapes: list[Shape], *, worked_all: bool) -> None:
        codes: dict[str | None, int] = {}
        different, which = different_shapes(shapes)
        colors = [shape.color or shape.style.color for shape in different]
        self.color = np.array([codes.setdefault(color, len(codes)) for color in colors], dtype=np.int64)[which]
        self.palette = list(codes)
        self.order = np.array([shape.order for shape in different], dtype=np.int64)[which]
        own = self.order < 0
        self.order[own] = np.flatnonzero(own)
        self.layer = np.array([shape.layer for shape in different], dtype=np.int64)[which]
        self.worked = np.array([worked_all or bool(shape.clips or shape.dashes) for shape in different], dtype=bool)[which]
        self.dotless = np.array([_is_dotless(shape.style) for shape in different], dtype=bool)[which]


def _is_dotless(style: Style) -> bool:
    return style.stroke is None or style.inherited.get("stroke-linecap", "butt") == "butt"


def _points_of(polylines: Polylines, rows: NDArray[np.int64]) -> tuple[Floats, Bools]:
    """The points and corner marks of some polylines, one after the other; of all of them, without a copy."""
    if len(rows) == len(polylines.path):
        return polylines.points, polylines.corner
    size = np.diff(polylines.offset)[rows]
    at = np.repeat(polylines.offset[rows] - np.cumsum(size) + size, size) + np.arange(int(size.sum()))
    return polylines.points[at], polylines.corner[at]


def _in_order(parts: list[_Part], palette: tuple[str | None, ...]) -> Strokes:
    """A layer's strokes in painting order; those of one shape stay as they come."""
    if not parts:
        none = np.zeros(0, dtype=np.int64)
        return Strokes(np.zeros((0, 2)), np.zeros(0, dtype=bool), np.zeros(1, dtype=np.int64), none, palette)
    one = len(parts) == 1
    order = np.concatenate([part.order for part in parts])
    size = np.concatenate([part.size for part in parts])
    strokes = Strokes(
        parts[0].points if one else np.concatenate([part.points for part in parts]),
        parts[0].corner if one else np.concatenate([part.corner for part in parts]),
        np.concatenate(([0], np.cumsum(size))),
        np.concatenate([part.color for part in parts]),
        palette,
    )
    return strokes if (np.diff(order) >= 0).all() else strokes.take(np.argsort(order, kind="stable"))


class Assembly:
    """Makes the strokes of one drawing. `strokes` holds, for each layer of the file, its strokes in painting order."""

    def __init__(self, options: ReadOptions, notes: Notes, page_mm: tuple[float, float], shapes: list[Shape]) -> None:
        self._options = options
        self._notes = notes
        self._shapes = shapes
        self._page = Clip.of_box(IDENTITY, 0.0, 0.0, *page_mm) if options.crop else None
        self._occluders: Occluders | None = None
        self._dash_count = 0.0

    def strokes(self, made: list[Polylines], layer_count: int) -> list[Strokes]:
        """Raises BadInput where the dash budget is exceeded. Empties `made` on its way, to save memory."""
        if self._options.occlude:
            self._occluders = self._opaque_areas(made)
        looks = _Looks(self._shapes, worked_all=self._options.occlude or self._options.crop or self._options.fills == "close")
        found: list[list[_Part]] = [[] for _ in range(layer_count)]
        while made:
            self._batch(made.pop(0), looks, found)
        return [_in_order(parts, tuple(looks.palette)) for parts in found]

    def _batch(self, polylines: Polylines, looks: _Looks, found: list[list[_Part]]) -> None:
        rows = np.flatnonzero(~(polylines.dot & looks.dotless[polylines.path]))
        worked = looks.worked[polylines.path[rows]]
        plain = rows[~worked]
        owner = polylines.path[plain]
        size = np.diff(polylines.offset)[plain]
        layer = looks.layer[owner]
        for number in np.unique(layer).tolist():
            mine = slice(None) if (layer == number).all() else layer == number
            points, corner = _points_of(polylines, plain[mine])
            found[number].append(_Part(looks.order[owner[mine]], size[mine], looks.color[owner[mine]], points, corner))
        rows = rows[worked]
        borders = np.flatnonzero(np.diff(polylines.path[rows])) + 1
        for of_one in np.split(rows, borders) if len(rows) else ():
            self._shape(int(polylines.path[of_one[0]]), of_one, polylines, looks, found)

    def _shape(
        self, owner: int, rows: NDArray[np.int64], polylines: Polylines, looks: _Looks, found: list[list[_Part]]
    ) -> None:
        """The strokes of a shape that is dashed, clipped, or looked at for other reasons."""
        shape = self._shapes[owner]
        pieces: list[Piece] = []
        for i in rows.tolist():
            begin, end = polylines.offset[i : i + 2].tolist()
            piece = Piece(polylines.points[begin:end], polylines.corner[begin:end])
            if self._options.fills == "close" and shape.style.fill is not None and not polylines.closed[i]:
                piece = _shut(piece)
            pieces.append(piece)
        pieces = list(self._worked(pieces, shape, int(looks.order[owner])))
        if not pieces:
            return
        found[shape.layer].append(
            _Part(
                np.full(len(pieces), looks.order[owner]),
                np.array([len(piece.points) for piece in pieces]),
                np.full(len(pieces), looks.color[owner]),
                np.concatenate([piece.points for piece in pieces]),
                np.concatenate([piece.corner for piece in pieces]),
            )
        )

    def _worked(self, pieces: list[Piece], shape: Shape, order: int) -> Iterable[Piece]:
        if shape.dashes is not None:
            pieces = self._dashed(pieces, shape, shape.dashes)
        pieces = apply_clips(pieces, shape.clips)
        if self._page is not None:
            pieces = apply_clips(pieces, (self._page,))
        if self._occluders is not None:
            pieces = [part for piece in pieces for part in self._occluders.visible(piece, order)]
        return pieces

    def _dashed(self, pieces: list[Piece], shape: Shape, dashes: Dashes) -> list[Piece]:
        positions = [user_lengths(piece.points, shape.matrix) for piece in pieces]
        total = sum(float(position[-1]) for position in positions)
        scale = total / dashes.path_length if dashes.path_length else 1.0
        pattern = np.array(dashes.pattern) * scale
        if not pattern.sum() > 0:
            return pieces
        self._dash_count += sum(dash_count(float(position[-1]), pattern) for position in positions)
        budget = self._options.budgets.dashes
        if self._dash_count > budget:
            raise BadInput(
                f"the drawing has more than {counted(budget, 'dash', 'dashes')}; raise --max-dashes, or make the dashes longer"
            )
        dots = shape.style.inherited.get("stroke-linecap", "butt") != "butt"
        return [
            part
            for piece, position in zip(pieces, positions, strict=True)
            for part in (
                [piece] if len(piece.points) == 1 else dash(piece, position, pattern, dashes.offset * scale, dots=dots)
            )
        ]

    def _opaque_areas(self, made: list[Polylines]) -> Occluders:
        occluders = Occluders()
        for owner, area in shape_areas(made, self._shapes, "fill-rule", wanted=_hides):
            shape = self._shapes[owner]
            order = shape.order if shape.order >= 0 else owner
            occluders.add(order, clipped_area(area, shape.clips), outlined=shape.dashes is None)
        return occluders


def _hides(shape: Shape) -> bool:
    fill = shape.style.fill
    return fill is not None and fill.opaque and shape.style.visible and not shape.style.translucent


def _shut(piece: Piece) -> Piece:
    """The closing line that a fill implies."""
    points = piece.points
    if len(points) < 3 or (points[0] == points[-1]).all():
        return piece
    return Piece(np.concatenate((points, points[:1])), np.append(piece.corner, True))
