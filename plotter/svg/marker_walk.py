"""Markers drawn on the vertices of a shape (SVG 2, 13.7)."""

from __future__ import annotations

import functools
import math
import re
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from output.wording import counted
from plotter.errors import BadInput
from plotter.svg.clip import Clip
from plotter.svg.context import Context
from plotter.svg.lengths import Frame
from plotter.svg.markers import Vertex, vertices
from plotter.svg.matrix import Matrix, is_singular, multiply, translation
from plotter.svg.path_segments import resolve
from plotter.svg.path_tokens import parse_paths
from plotter.svg.style import Style
from plotter.svg.viewport import fit_view_box

if TYPE_CHECKING:
    from plotter.svg.walk import Walk

_URL = re.compile(r"url\(\s*[\"']?\s*#([^\"')]+?)\s*[\"']?\s*\)")
_PLACES = ("marker-start", "marker-mid", "marker-end")
_MARKED = frozenset(("path", "line", "polyline", "polygon"))
_ANGLE = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)(deg|rad|grad|turn)?\s*$")
_DEGREES = {None: 1.0, "deg": 1.0, "rad": 180 / math.pi, "grad": 0.9, "turn": 360.0}
_REFERENCE = {"left": "0%", "top": "0%", "center": "50%", "right": "100%", "bottom": "100%"}


class Markers:
    """Draws markers through the walk, so that what they hold is read like everything else."""

    def __init__(self, walk: Walk) -> None:
        self._walk = walk
        self._count = 0

    def wanted(self, kind: str, style: Style) -> bool:
        return kind in _MARKED and any(style.inherited.get(place, "none") != "none" for place in _PLACES)

    def draw(self, element: Any, data: str, context: Context) -> None:
        """The markers of a shape with outline `data`; `context` is the shape's own."""
        found = {place: self._named(context.style, place, element) for place in _PLACES}
        if not any(marker is not None for marker in found.values()):
            return
        stops = _stops(data)
        for i, stop in enumerate(stops):
            # A path of one vertex bears its start and its end marker on it.
            places = [
                place
                for place, here in zip(_PLACES, (i == 0, 0 < i < len(stops) - 1, i == len(stops) - 1), strict=True)
                if here
            ]
            for place in places:
                if found[place] is not None:
                    self._one(found[place], stop, context, start=place == "marker-start")

    def _named(self, style: Style, place: str, element: Any) -> Any:
        value = style.inherited.get(place, "none")
        match = _URL.match(value) if value != "none" else None
        if match is None:
            return None
        found = self._walk.references.by_id(match[1])
        if found is None or self._walk.kind(found.tag) != "marker":
            self._walk.notes.add(
                "{count} [marker is|markers are] not there and ignored ({names})",
                f"#{match[1]} of {self._walk.name(element)}",
            )
            return None
        return found

    def _one(self, marker: Any, stop: Vertex, context: Context, *, start: bool) -> None:
        walk = self._walk
        if any(marker is one for one in context.uses):
            walk.notes.add("{count} [marker refers to itself and was|markers refer to themselves and were] left out")
            return
        self._count_one()
        style = walk.style_in_place(marker)
        frame = context.frame
        if not style.displayed:
            return
        width = walk.number(marker, "markerWidth", marker.get("markerWidth"), frame, frame.width)
        height = walk.number(marker, "markerHeight", marker.get("markerHeight"), frame, frame.height)
        width, height = 3.0 if width is None else width, 3.0 if height is None else height
        if width <= 0 or height <= 0:
            return
        matrix = multiply(context.matrix, translation(stop.x, stop.y))
        matrix = multiply(matrix, _turned(_angle(marker.get("orient"), stop.angle, start=start)))
        if marker.get("markerUnits") != "userSpaceOnUse":
            matrix = multiply(matrix, (context.style.stroke_px, 0.0, 0.0, context.style.stroke_px, 0.0, 0.0))
        box = walk.view_box(marker)
        if box is not None and (box[2] <= 0 or box[3] <= 0):
            return
        fit: Matrix = (
            (1.0, 0.0, 0.0, 1.0, 0.0, 0.0)
            if box is None
            else fit_view_box(box, width, height, marker.get("preserveAspectRatio"))
        )
        inside = replace(frame, width=box[2], height=box[3]) if box else replace(frame, width=width, height=height)
        x, y = self._reference(marker, "refX", inside, inside.width), self._reference(marker, "refY", inside, inside.height)
        # The content is scaled by the fit and its reference point put on the vertex, so that the fit's own offset cancels.
        matrix = multiply(matrix, (fit[0], 0.0, 0.0, fit[3], -fit[0] * x, -fit[3] * y))
        if is_singular(matrix):
            return
        clips = context.clips
        if style.own.get("overflow", "hidden") not in ("visible", "auto"):
            area = box or (0.0, 0.0, width, height)
            shown = (-fit[4] / fit[0], -fit[5] / fit[3], width / fit[0], height / fit[3]) if box else area
            clips = (*clips, Clip.of_box(matrix, *shown))
        uses = (*context.uses, marker)
        walk.children(marker, Context(matrix, style, inside, context.layer, clips, context.level + 1, uses))

    def _count_one(self) -> None:
        """Raises BadInput for more than the budget."""
        self._count += 1
        limit = self._walk.options.budgets.markers
        if self._count > limit:
            raise BadInput(f"the drawing has more than {counted(limit, 'marker')}; raise --max-markers if it is meant")

    def _reference(self, marker: Any, name: str, frame: Frame, percent_of: float) -> float:
        text = (marker.get(name) or "0").strip()
        return self._walk.number(marker, name, _REFERENCE.get(text, text), frame, percent_of) or 0.0


@functools.lru_cache(maxsize=256)
def _stops(data: str) -> list[Vertex]:
    """The vertices of path data; none where it is not finite."""
    commands, _ = parse_paths([data])
    if not len(commands.code) or not np.isfinite(commands.numbers).all():
        return []
    return vertices(resolve(commands))


def _angle(orient: str | None, along: float, *, start: bool) -> float:
    """Radians by which a marker is turned."""
    text = (orient or "0").strip()
    if text.startswith("auto"):
        return along + math.pi if text == "auto-start-reverse" and start else along
    match = _ANGLE.match(text)
    return math.radians(float(match[1]) * _DEGREES[match[2]]) if match else 0.0


def _turned(angle: float) -> Matrix:
    return (math.cos(angle), math.sin(angle), -math.sin(angle), math.cos(angle), 0.0, 0.0)
