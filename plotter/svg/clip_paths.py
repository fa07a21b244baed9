"""clipPath elements to areas (CSS Masking 1, 5)."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from plotter.errors import BadInput
from plotter.svg.areas import EMPTY, area_of
from plotter.svg.clip import Clip, clipped_area
from plotter.svg.collector import Shape
from plotter.svg.context import Context
from plotter.svg.flatten import Polylines
from plotter.svg.matrix import Matrix, inverse, is_singular, multiply
from plotter.svg.shapes import is_shape
from plotter.svg.style import Style

if TYPE_CHECKING:
    from plotter.svg.walk import Walk

_URL = re.compile(r"url\(\s*[\"']?\s*#([^\"')]+?)\s*[\"']?\s*\)")

_DEEPEST = 50

Box = tuple[float, float, float, float]


class ClipPaths:
    """Makes clips of clipPath elements, each once for a coordinate system."""

    def __init__(self, walk: Walk) -> None:
        self._walk = walk
        self._known: dict[Any, Clip] = {}
        self._open: list[Any] = []

    def add(
        self,
        clips: tuple[Clip, ...],
        element: Any,
        kind: str,
        attributes: dict[str, str],
        style: Style,
        matrix: Matrix,
        context: Context,
    ) -> tuple[Clip, ...]:
        """`clips` and the one that `element`'s clip-path property names, if any."""
        clip_path = self._named(style, element)
        if clip_path is None:
            return clips

        def box() -> Box | None:
            return self._box(element, kind, attributes, style, matrix, context)

        clip = self._clip(clip_path, matrix, box, context)
        return clips if clip is None else (*clips, clip)

    def _named(self, style: Style, element: Any) -> Any:
        value = style.own.get("clip-path", "none").strip()
        if value == "none":
            return None
        match = _URL.match(value)
        if match is None:
            self._walk.notes.add(
                "{count} clip-path [shape|shapes] other than url(#...) [was|were] ignored ({names})", value[:40]
            )
            return None
        found = self._walk.references.by_id(match[1])
        if found is None or self._walk.kind(found.tag) != "clipPath":
            self._walk.notes.add(
                "{count} clip [path is|paths are] not there and ignored ({names})",
                f"#{match[1]} of {self._walk.name(element)}",
            )
            return None
        return found

    def _clip(self, element: Any, matrix: Matrix, box: Callable[[], Box | None], context: Context) -> Clip | None:
        if any(element is one for one in self._open):
            self._walk.notes.add("{count} clip [path refers to itself and was|paths refer to themselves and were] ignored")
            return None
        if len(self._open) >= _DEEPEST:
            name = self._walk.name(element)
            raise BadInput(f"{name} stands in a chain of more than {_DEEPEST} clip paths that refer to each other; simplify it")
        units = matrix
        if element.get("clipPathUnits") == "objectBoundingBox":
            bounds = box()
            if bounds is None or bounds[2] <= 0 or bounds[3] <= 0:
                return Clip(EMPTY)
            units = multiply(matrix, (bounds[2], 0.0, 0.0, bounds[3], bounds[0], bounds[1]))
        key = (element, units)
        known = self._known.get(key)
        if known is None:
            self._open.append(element)
            try:
                known = self._known[key] = Clip(self._area(element, matrix, units, box, context))
            finally:
                self._open.pop()
        return known

    def _area(
        self, element: Any, matrix: Matrix, units: Matrix, box: Callable[[], Box | None], context: Context
    ) -> BaseGeometry:
        walk = self._walk
        style = walk.style_in_place(element)
        own = walk.transforms.own(element, style, context.frame)
        inner = Context(multiply(units, own) if own else units, style, context.frame, 0, (), context.level + 1, context.uses)
        if is_singular(inner.matrix):
            return EMPTY
        areas = []
        for child in element:
            if self._may_clip(child):
                polylines, shapes = walk.gather(functools.partial(self._child, child, inner))
                areas += [clipped_area(area, shapes[i].clips) for i, area in shape_areas(polylines, shapes, "clip-rule")]
        area = shapely.union_all(areas) if areas else EMPTY
        outer = self._named(style, element) if "clip-path" in style.own else None
        clip = self._clip(outer, matrix, box, context) if outer is not None else None
        return area if clip is None else shapely.intersection(area, clip.area)

    def _child(self, child: Any, inner: Context) -> None:
        """One child of a clipPath, with the clip path of its own if it has one."""
        walk = self._walk
        kind = walk.kind(child.tag)
        style = walk.cascade.style(child, kind, child.items(), inner.style, inner.frame)
        if "clip-path" in style.own:
            own = walk.transforms.own(child, style, inner.frame)
            matrix = multiply(inner.matrix, own) if own else inner.matrix
            inner = replace(inner, clips=self.add(inner.clips, child, kind, dict(child.items()), style, matrix, inner))
        walk.element(child, inner)

    def _may_clip(self, child: Any) -> bool:
        """Only shapes and direct uses of shapes clip; groups do not."""
        kind = self._walk.kind(child.tag)
        if kind == "use":
            href = child.get("href") or child.get("{http://www.w3.org/1999/xlink}href") or ""
            target = self._walk.references.by_id(href.strip().lstrip("#"))
            kind = self._walk.kind(target.tag) if target is not None else ""
        return is_shape(kind) or kind == "text"

    def _box(
        self, element: Any, kind: str, attributes: dict[str, str], style: Style, matrix: Matrix, context: Context
    ) -> Box | None:
        """The bounding box of an element's outlines in its own user units: x, y, width, height."""
        walk = self._walk

        def run() -> None:
            if is_shape(kind):
                walk.shape(element, kind, dict(attributes), style, matrix, (), context)
            else:
                walk.container(element, kind, Context(matrix, style, context.frame, 0, (), context.level + 1, context.uses))

        made, _ = walk.gather(run)
        points = np.concatenate([one.points for one in made]) if made else np.zeros((0, 2))
        if not len(points):
            return None
        a, b, c, d, e, f = inverse(matrix)
        x, y = a * points[:, 0] + c * points[:, 1] + e, b * points[:, 0] + d * points[:, 1] + f
        return (float(x.min()), float(y.min()), float(np.ptp(x)), float(np.ptp(y)))


def shape_areas(
    made: list[Polylines], shapes: list[Shape], rule: str, wanted: Callable[[Shape], bool] | None = None
) -> list[tuple[int, BaseGeometry]]:
    """The area of each wanted shape, by its index, under its `clip-rule` or `fill-rule`."""
    rings: dict[int, list[Any]] = {}
    for polylines in made:
        offset = polylines.offset.tolist()
        for i, owner in enumerate(polylines.path.tolist()):
            if wanted is None or wanted(shapes[owner]):
                rings.setdefault(owner, []).append(polylines.points[offset[i] : offset[i + 1]])
    return [(i, area_of(own, shapes[i].style.inherited.get(rule, "nonzero"))) for i, own in rings.items()]
