"""Flattened shapes to strokes: fills closed, dashes, clips, hidden lines and the page's edge, in this order."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import groupby

import numpy as np

from output.wording import counted
from planning.geometry.stroke import Stroke
from plotter.errors import BadInput
from plotter.svg.clip import Clip, apply_clips, clipped_area
from plotter.svg.clip_paths import shape_areas
from plotter.svg.collector import Shape
from plotter.svg.cut import Piece, dash, dash_count
from plotter.svg.dashes import Dashes, user_lengths
from plotter.svg.flatten import Polylines
from plotter.svg.matrix import IDENTITY
from plotter.svg.notes import Notes
from plotter.svg.occlude import Occluders
from plotter.svg.options import ReadOptions


class Assembly:
    """Makes the strokes of one drawing. `strokes` holds, for each layer of the file, its strokes in painting order."""

    def __init__(self, options: ReadOptions, notes: Notes, page_mm: tuple[float, float], shapes: list[Shape]) -> None:
        self._options = options
        self._notes = notes
        self._shapes = shapes
        self._page = Clip.of_box(IDENTITY, 0.0, 0.0, *page_mm) if options.crop else None
        self._occluders: Occluders | None = None
        self._dash_count = 0.0

    def strokes(self, made: list[Polylines], layer_count: int) -> list[list[Stroke]]:
        """Raises BadInput where the dash budget is exceeded. Empties `made` on its way, to save memory."""
        if self._options.occlude:
            self._occluders = self._opaque_areas(made)
        found: list[list[tuple[int, Stroke]]] = [[] for _ in range(layer_count)]
        late = any(shape.order >= 0 for shape in self._shapes)
        while made:
            self._batch(made.pop(0), found)
        if late:
            for layer in found:
                layer.sort(key=lambda item: item[0])
        return [[stroke for _, stroke in layer] for layer in found]

    def _batch(self, polylines: Polylines, found: list[list[tuple[int, Stroke]]]) -> None:
        shapes, options = self._shapes, self._options
        offset, dots, closed = polylines.offset.tolist(), polylines.dot.tolist(), polylines.closed.tolist()
        points, corner = polylines.points, polylines.corner
        for owner, rows in groupby(enumerate(polylines.path.tolist()), key=lambda item: item[1]):
            shape = shapes[owner]
            style = shape.style
            color = shape.color or style.color
            order = owner if shape.order < 0 else shape.order
            plain = not (shape.clips or shape.dashes or options.occlude or options.crop or options.fills == "close")
            layer = found[shape.layer]
            pieces: list[Piece] = []
            for i, _ in rows:
                if dots[i] and (style.stroke is None or style.inherited.get("stroke-linecap", "butt") == "butt"):
                    continue
                begin, end = offset[i], offset[i + 1]
                if plain:
                    layer.append((order, Stroke(points[begin:end], corner[begin:end], color)))
                    continue
                piece = Piece(points[begin:end], corner[begin:end])
                if options.fills == "close" and style.fill is not None and not closed[i]:
                    piece = _shut(piece)
                pieces.append(piece)
            if pieces:
                layer += [(order, Stroke(piece.points, piece.corner, color)) for piece in self._worked(pieces, shape, order)]

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
