"""Shapes that differ in nothing but their outline from one under the same parent.

Large drawings are made of them. What the walk found out about the first ones holds for all: style, transform, layer, that they
are drawn, and that there is nothing to say about them. So the walk only looks at those, and the rest are handed on here.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from lxml import etree

from plotter.svg.collector import Shape
from plotter.svg.context import Context
from plotter.svg.matrix import is_singular, multiply, parse_transform
from plotter.svg.run import Run
from plotter.svg.shapes import OUTLINES, Ellipse, Outline, is_shape, outline
from plotter.svg.style import Style

if TYPE_CHECKING:
    from plotter.svg.walk import Walk

# Properties of an element's own that change nothing here: of transforms the matrix is remembered.
_HARMLESS = frozenset(("transform", "opacity"))
# Kinds of shapes remembered under one parent.
_REMEMBERED = 20_000
# So many are taken one by one before a run of them is looked for, and so many times as many before the next.
_FIRST_LOOK, _LOOK_AGAIN = 500, 4
# Until the first one is handed on: a layer is there when something is drawn in it.
_NO_LAYER = -1


class Alike:
    """The shapes among the children of one parent, whose context is `context`."""

    def __init__(self, walk: Walk, context: Context) -> None:
        self._walk = walk
        self._context = context
        self._keys = walk.cascade.keys
        self._never = walk.cascade.is_complex or walk.gathering
        # For each kind of shape met: what they have in common; None where they are to be looked at one by one; or how often it
        # was met, as those that come once are not worth finding out about.
        self._known: dict[Any, tuple[str, Shape] | int | None] = {}
        self._taken, self._look_at = 0, _FIRST_LOOK

    def take(self, element: Any) -> bool:
        """Hands `element` to the collector if it is like one before; else the walk has to look at it."""
        if self._never:
            return False
        items = element.items()
        keys = self._keys
        key = (element.tag, *[item for item in items if item[0] in keys])
        known = self._known.get(key, 0)
        if known is None:
            return False
        if isinstance(known, int):
            self._learn(key, known, element, items)
            return False
        walk, (kind, shape) = self._walk, known
        walk.count_elements()
        attributes = dict(items)
        found = _plain(kind, attributes) or outline(kind, attributes, self._context.frame)
        if found is not None:
            walk.collector.add(element, self._in_layer(key, kind, shape), found)
        self._taken += kind in OUTLINES
        return True

    @property
    def may_run(self) -> bool:
        """Whether so many were taken that a run is worth looking for; not often, as that looks at all that follow."""
        return self._taken >= self._look_at

    def take_run(self, element: Any) -> Iterator[Any]:
        """Hands on all that follow `element`, which was taken, and are like it, if they are of OUTLINES. Returns the rest."""
        self._look_at *= _LOOK_AGAIN
        try:
            run = Run(element, self._keys)
        except etree.XPathError:  # there are more than the parser's limit
            return iter(element.itersiblings())
        key = (element.tag, *run.common)
        known = self._known[key]
        if not isinstance(known, tuple):
            raise AssertionError(f"{key} was not taken")
        kind, shape = known
        name, as_path = OUTLINES.get(kind, ("", str))
        texts = [as_path(text) for text in run.values(name) or ()]
        if not any(texts):
            return iter(element.itersiblings())
        self._walk.count_elements(len(texts))
        self._walk.collector.add_run(run, self._in_layer(key, kind, shape), texts)
        return run.rest()

    def _in_layer(self, key: Any, kind: str, shape: Shape) -> Shape:
        """The shape, in the layer in which one outside of all layers comes now: another one after each layer."""
        if self._context.layer is None:
            layer = self._walk.layer_of(self._context)
            if layer != shape.layer:
                shape = Shape(shape.style, layer, shape.matrix, shape.clips)
                self._known[key] = kind, shape
        return shape

    def _learn(self, key: Any, times: int, element: Any, items: list[tuple[str, str]]) -> None:
        if len(self._known) > _REMEMBERED:
            self._known.clear()
        self._known[key] = times + 1 if times == 0 else self._common(element, items)

    def _common(self, element: Any, items: list[tuple[str, str]]) -> tuple[str, Shape] | None:
        """What all shapes with these attributes have in common under this parent; None where more must be looked at."""
        walk, context = self._walk, self._context
        kind = walk.kind(element.tag)
        if not is_shape(kind):
            return None
        style = walk.cascade.style(element, kind, items, context.style, context.frame)
        if not style.own.keys() <= _HARMLESS or style.font_px != context.frame.font_px:
            return None
        if not _is_plainly_drawn(walk, style) or "stroke-dasharray" in style.inherited or walk.markers.wanted(kind, style):
            return None
        matrix = context.matrix
        if "transform" in style.own:
            own = parse_transform(style.own["transform"])
            if own is None:
                return None
            matrix = multiply(matrix, own)
        if is_singular(matrix):
            return None
        return kind, Shape(style, _NO_LAYER if context.layer is None else context.layer, matrix, context.clips)


def _is_plainly_drawn(walk: Walk, style: Style) -> bool:
    """Whether a shape is drawn without anything to be said about its paints."""
    if not (style.displayed and style.visible):
        return False
    if walk.options.hidden != "skip":
        return True
    paints = [paint for paint in (style.stroke, style.fill) if paint is not None]
    if any(paint.server is not None for paint in paints):
        return False
    return style.stroke is not None or (style.fill is not None and walk.options.fills != "skip")


def _plain(kind: str, attributes: dict[str, str]) -> Outline | Ellipse | None:
    """The outline of a line or a circle, when all of its numbers are there and none has a unit or is beyond numbers."""
    try:
        if kind == "line":
            ends = [float(attributes["x1"]), float(attributes["y1"]), float(attributes["x2"]), float(attributes["y2"])]
            return (b"ML", ends) if math.isfinite(sum(ends)) else None
        if kind == "circle":
            x, y, r = float(attributes["cx"]), float(attributes["cy"]), float(attributes["r"])
            return (x, y, r, r) if r > 0 and math.isfinite(x + y + r) else None
    except (KeyError, ValueError):
        pass
    return None
