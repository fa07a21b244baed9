"""Computed style: the cascade of attributes, sheets and style attributes, and inheritance (SVG 2, 6; CSS Cascade 4).

Elements of a drawing share few distinct styles, so each Style remembers the children computed from it.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from plotter.svg.colors import Paint, is_paint, parse_paint
from plotter.svg.lengths import Frame, parse_length
from plotter.svg.stylesheet import Stylesheet, parse_style_attribute

INHERITED = frozenset(
    (
        "clip-rule",
        "color",
        "direction",
        "fill",
        "fill-opacity",
        "fill-rule",
        "font-family",
        "font-size",
        "font-style",
        "font-variant",
        "font-weight",
        "font-stretch",
        "letter-spacing",
        "word-spacing",
        "text-anchor",
        "writing-mode",
        "dominant-baseline",
        "marker",
        "marker-start",
        "marker-mid",
        "marker-end",
        "paint-order",
        "stroke",
        "stroke-dasharray",
        "stroke-dashoffset",
        "stroke-linecap",
        "stroke-linejoin",
        "stroke-miterlimit",
        "stroke-opacity",
        "stroke-width",
        "visibility",
        "white-space",
        "xml:space",
        "font",
    )
)
OWN = frozenset(
    (
        "alignment-baseline",
        "baseline-shift",
        "clip-path",
        "display",
        "filter",
        "mask",
        "opacity",
        "overflow",
        "text-decoration",
        "transform",
        "transform-origin",
        "transform-box",
    )
)
# Geometry that a sheet or a style attribute may set (SVG 2, 7); as attributes they are read with the element.
GEOMETRY = frozenset(["x", "y", "width", "height", "cx", "cy", "r", "rx", "ry", "d"])

_ATTRIBUTES = (INHERITED | OWN) - {"font", "marker"}
# Attributes that can change the style: what the memory of styles is keyed by.
KEYS = _ATTRIBUTES | {"style", "class"}
# A value of these that is no paint is no declaration: what was inherited or declared before holds.
_PAINTS = frozenset(("fill", "stroke", "color"))
_KNOWN = INHERITED | OWN | GEOMETRY

# Styles remembered under one parent; a drawing that gives every element its own colour must not fill the memory.
_REMEMBERED = 20_000

_FONT_SIZE_PX = {
    "xx-small": 9.0,
    "x-small": 10.0,
    "small": 13.0,
    "medium": 16.0,
    "large": 18.0,
    "x-large": 24.0,
    "xx-large": 32.0,
    "xxx-large": 48.0,
}


class Style:
    """One computed style. `inherited` and `own` hold CSS texts; the rest is what the reader asks for, worked out once."""

    __slots__ = (
        "children",
        "displayed",
        "fill",
        "font_px",
        "inherited",
        "own",
        "stroke",
        "stroke_px",
        "translucent",
        "visible",
    )

    def __init__(
        self, inherited: dict[str, str], own: dict[str, str], font_px: float, frame: Frame, *, inside_translucent: bool = False
    ) -> None:
        self.inherited = inherited
        self.own = own
        self.font_px = font_px
        self.children: dict[Any, Style] = {}
        # Whether something shows through, be it because of a group around: then a fill hides nothing.
        self.translucent = inside_translucent or _opacity(own.get("opacity")) < 1 or own.get("mask", "none") != "none"
        self.displayed = own.get("display") != "none"
        self.visible = inherited.get("visibility", "visible") not in ("hidden", "collapse")
        color = inherited.get("color", "black")
        self.fill = _paint(inherited.get("fill", "black"), color, inherited.get("fill-opacity"), own.get("opacity"))
        width = parse_length(inherited.get("stroke-width", "1"), frame, frame.diagonal)
        self.stroke_px = 1.0 if width is None or width < 0 else width
        stroke = _paint(inherited.get("stroke", "none"), color, inherited.get("stroke-opacity"), own.get("opacity"))
        self.stroke = stroke if self.stroke_px > 0 else None

    @property
    def color(self) -> str | None:
        """The pen's colour: of the stroke, else of the fill."""
        paint = self.stroke or self.fill
        return paint.color if paint else None

    def get(self, name: str) -> str | None:
        value = self.inherited.get(name)
        return self.own.get(name) if value is None else value


def _opacity(text: str | None) -> float:
    if text is None:
        return 1.0
    try:
        value = float(text[:-1]) / 100 if text.endswith("%") else float(text)
    except ValueError:
        return 1.0
    return min(1.0, max(0.0, value))


def _paint(text: str, color: str, *opacities: str | None) -> Paint | None:
    paint = parse_paint(text, color)
    if paint is None:
        return None
    for text_opacity in opacities:
        if text_opacity is not None:
            opacity = _opacity(text_opacity)
            if opacity == 0:
                return None
            if opacity < 1 and paint.opaque:
                paint = Paint(paint.color, False, paint.server, paint.has_fallback)
    return paint


def root_style(frame: Frame) -> Style:
    """The initial values."""
    return Style({}, {}, 16.0, frame)


class Cascade:
    """Computes styles of elements, remembering all that it computed.

    Elements of one kind under one parent have one style where their attributes named in `keys` are the same, unless the sheet
    `is_complex`: then it also depends on where they stand.
    """

    def __init__(self, sheet: Stylesheet) -> None:
        self._sheet = sheet
        self.keys = KEYS | {"id"} if sheet.uses_ids else KEYS
        self._plain = sheet.is_empty
        self.is_complex = sheet.is_complex
        self._parsed: dict[str, list[tuple[str, str, bool]]] = {}

    def style(self, element: Any, kind: str, items: list[tuple[str, str]], parent: Style, frame: Frame) -> Style:
        """The style of `element` under `parent`; `items` are its attributes, `kind` its local name."""
        keys = self.keys
        key: Any = tuple([item for item in items if item[0] in keys])
        if not key and self._plain and not parent.own:
            return parent
        rules: Iterable[Any] = ()
        if not self._plain:
            if self.is_complex:
                rules = self._sheet.matched(element, kind)
                key = (key, kind, tuple(map(id, rules)))
            else:
                key = (key, kind)
        known = parent.children.get(key)
        if known is None:
            if not self._plain and not self.is_complex:
                rules = self._sheet.matched(element, kind)
            if len(parent.children) > _REMEMBERED:
                parent.children.clear()
            known = parent.children[key] = self._compute(items, rules, parent, frame)
        return known

    def declared(self, items: Iterable[tuple[str, str]], rules: Iterable[Any]) -> dict[str, str]:
        """The winning declaration of each property."""
        normal: dict[str, str] = {}
        inline: list[tuple[str, str, bool]] = []
        for name, value in items:
            if name in _ATTRIBUTES:
                if name not in _PAINTS or is_paint(value):
                    normal[name] = value.strip()
            elif name == "style":
                parsed = self._parsed.get(value)
                if parsed is None:
                    parsed = parse_style_attribute(value)
                    if len(self._parsed) < 100_000:
                        self._parsed[value] = parsed
                inline = parsed
        important: dict[str, str] = {}
        for declarations in (*(rule.declarations for rule in rules), inline):
            for name, value, is_important in declarations:
                if name in _KNOWN and (name not in _PAINTS or is_paint(value)):
                    for target in (normal, important) if is_important else (normal,):
                        _declare(target, name, value)
        normal.update(important)
        return normal

    def _compute(self, items: list[tuple[str, str]], rules: Iterable[Any], parent: Style, frame: Frame) -> Style:
        inherited = parent.inherited
        own: dict[str, str] = {}
        copied = False
        for name, value in self.declared(items, rules).items():
            word = value.lower() if len(value) < 8 else value
            if name in INHERITED:
                if word in ("inherit", "unset"):
                    continue
                if not copied:
                    inherited, copied = dict(inherited), True
                if word == "initial":
                    inherited.pop(name, None)
                else:
                    inherited[name] = value
            elif word == "inherit":
                if name in parent.own:
                    own[name] = parent.own[name]
            elif word not in ("initial", "unset"):
                own[name] = value
        font_px = _font_px(inherited, parent, frame)
        if copied and inherited.get("font-size", "").endswith(("em", "ex", "%", "ch", "larger", "smaller")):
            inherited["font-size"] = f"{font_px!r}px"
        inner = Frame(frame.width, frame.height, font_px, frame.px_per_in)
        return Style(inherited, own, font_px, inner, inside_translucent=parent.translucent)


def _declare(target: dict[str, str], name: str, value: str) -> None:
    if name == "marker":
        for part in ("marker-start", "marker-mid", "marker-end"):
            target[part] = value
    elif name == "font":
        _font_shorthand(target, value)
    else:
        target[name] = value


def _font_shorthand(target: dict[str, str], value: str) -> None:
    """font: [style] [weight] size[/line height] family"""
    words = value.split()
    for i, word in enumerate(words):
        if word[0].isdigit() or word in _FONT_SIZE_PX:
            if word.isdigit() and int(word) % 100 == 0 and i + 1 < len(words) and words[i + 1][0].isdigit():
                target["font-weight"] = word
                continue
            target["font-size"] = word.split("/")[0]
            target["font-family"] = " ".join(words[i + 1 :])
            return
        if word in ("italic", "oblique"):
            target["font-style"] = word
        elif word in ("bold", "bolder", "lighter"):
            target["font-weight"] = word


def _font_px(inherited: dict[str, str], parent: Style, frame: Frame) -> float:
    text = inherited.get("font-size")
    if text is None or text == parent.inherited.get("font-size"):
        return parent.font_px if text is not None else 16.0
    if text in _FONT_SIZE_PX:
        return _FONT_SIZE_PX[text]
    if text in ("larger", "smaller"):
        return parent.font_px * (1.2 if text == "larger" else 1 / 1.2)
    size = parse_length(text, Frame(frame.width, frame.height, parent.font_px, frame.px_per_in), parent.font_px)
    return parent.font_px if size is None or size < 0 else size
