"""Texts as outlines: all texts of a drawing go through the font engine at once, each in its own user units.

The engine sees a small document made for it: texts with their computed styles and fonts that are installed. Of texts that run
along a path it only makes the glyphs, which are then set here: it measures curves too roughly. What
comes back is read like any path, so that layers, order, transforms and clips stay ours.
"""

from __future__ import annotations

import re
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from lxml import etree

from output.wording import counted
from plotter.errors import BadInput
from plotter.svg import font_engine, text_single
from plotter.svg.collector import Shape
from plotter.svg.context import PendingText
from plotter.svg.document import SVG
from plotter.svg.lengths import Frame, parse_length
from plotter.svg.matrix import IDENTITY, Matrix, multiply, parse_transform
from plotter.svg.names import named
from plotter.svg.style import Style
from plotter.svg.text_glyphs import Glyphs
from plotter.svg.text_layout import Layout

if TYPE_CHECKING:
    from plotter.svg.walk import Walk

_XML_SPACE = "{http://www.w3.org/XML/1998/namespace}space"
_PLACED = ("x", "y", "dx", "dy", "rotate", "textLength", "lengthAdjust", "startOffset", "method", "spacing", "side", _XML_SPACE)
_ACROSS = {"x": "width", "dx": "width", "y": "height", "dy": "height"}
_FONT = (
    "font-style",
    "font-variant",
    "font-weight",
    "font-stretch",
    "text-anchor",
    "letter-spacing",
    "word-spacing",
    "writing-mode",
    "direction",
    "dominant-baseline",
    "white-space",
)
_DRESS = ("font-family", "font-size", *_FONT)
_FONT_OWN = ("baseline-shift", "alignment-baseline", "text-decoration")
_TEXTS = frozenset(("text", "tspan", "textPath", "a", "tref"))
# The engine opens its font anew for every text, which takes milliseconds.
_MANY_TEXTS = 200
_MANY_CHARACTERS = 5000
_LAST_PLAIN = "\u024f"
# What stands for a character that no font has: it has no ink, is a character like another, and is in every font.
_NO_INK = "\u00a0"
# So many characters are asked for one by one, to see which of them no font has.
_MOST_ALONE = 500
_NOT_PLAIN = frozenset(
    ("text-decoration", "textLength", "word-spacing", "writing-mode", "direction", "dominant-baseline", "baseline-shift")
)

_GENERIC = {
    "sans-serif": ("Arial", "Helvetica", "Liberation Sans", "DejaVu Sans", "Noto Sans", "Verdana"),
    "serif": ("Times New Roman", "Times", "Liberation Serif", "DejaVu Serif", "Noto Serif"),
    "monospace": ("Courier New", "Liberation Mono", "DejaVu Sans Mono", "Noto Sans Mono", "Menlo"),
}
_GENERIC["system-ui"] = _GENERIC["ui-sans-serif"] = _GENERIC["cursive"] = _GENERIC["fantasy"] = _GENERIC["sans-serif"]


def draw_texts(walk: Walk) -> None:
    """Adds what all pending texts draw to the walk's collector; what cannot be drawn is noted. Raises BadInput where there is
    far too much text."""
    texts = walk.texts
    characters = sum(len(text) for pending in texts for text in pending.element.itertext())
    limit = walk.options.budgets.characters
    if characters > limit:
        raise BadInput(
            f"the drawing has {counted(characters, 'character')} of text and the limit is {limit}; "
            "raise --max-characters, or leave text out with --text skip"
        )
    if texts and walk.options.text == "single":
        if text_single.available():
            text_single.draw_single(walk, texts)
        else:
            walk.notes.add(
                "{count} [text was|texts were] left out: single-line strokes need a font (pip install Hershey-Fonts)",
                count=len(texts),
            )
    elif texts:
        _draw_outlines(walk, texts)


def _draw_outlines(walk: Walk, texts: list[PendingText]) -> None:
    if not font_engine.available():
        walk.notes.add(
            "{count} [text was|texts were] left out: outlines need a font engine (pip install 'plotter[text]'); "
            "--text single draws strokes",
            count=len(texts),
        )
        return
    try:
        _Outlines(walk, font_engine.families()).draw(texts)
    except font_engine.FontEngineFailed as error:
        walk.notes.add(
            f"{{count}} [text was|texts were] left out: the font engine failed ({error}); --text single draws strokes",
            count=len(texts),
        )


class _Outlines:
    def __init__(self, walk: Walk, families: tuple[str, ...]) -> None:
        self._walk = walk
        self._families = {family.lower(): family for family in families}
        self._fonts: dict[str, str | None] = {}
        self._root = etree.Element(f"{{{SVG}}}svg", nsmap={None: SVG})
        self._glyphs = Glyphs()

    def draw(self, texts: list[PendingText]) -> None:
        if not self._families:
            self._walk.notes.add(
                "{count} [text was|texts were] left out: no font is installed; --text single draws strokes", count=len(texts)
            )
            return
        frame = texts[0].context.frame
        for name, size in (("width", frame.width), ("height", frame.height)):
            self._root.set(name, repr(max(1.0, size)))
        set_here = self._set_here(texts)
        for i, pending in enumerate(texts):
            if i in set_here:
                self._want_glyphs(pending.element, pending.context.style, pending.context.frame)
            else:
                group = etree.SubElement(self._root, f"{{{SVG}}}g", id=f"t{i}")
                self._copy(pending.element, "text", pending.context.style, pending.context.frame, group)
        outlined = font_engine.outlines(etree.tostring(self._root))
        if outlined.missing:
            self._leave_out(self._lacking(set(outlined.missing)), texts)
            outlined = font_engine.outlines(etree.tostring(self._root))
        for character in outlined.missing:
            self._walk.notes.add(
                "{count} [character was|characters were] drawn as [a box|boxes], for want of a font ({names})", named(character)
            )
        parser = etree.XMLParser(resolve_entities=False, no_network=True, huge_tree=True)
        made = etree.fromstring(outlined.document, parser)
        for group in made.iterchildren(f"{{{SVG}}}g"):
            name = group.get("id") or ""
            if name.startswith("t"):
                self._collect(group, texts[int(name[1:])], IDENTITY)
            elif name.startswith("c"):
                self._glyphs.read(int(name[1:]), group)
        layout = Layout(self._walk, self._glyphs.advance)
        for i in sorted(set_here):
            self._place(layout, texts[i])

    def _lacking(self, told: set[str]) -> set[str]:
        """The characters that no font has. Each is asked for by itself, in the dress that it has where it is first: of a text
        the engine may tell too many (see `outlines`), or for a mark the letter that it stands on. Only where there are too many
        of them is what it `told` taken for it."""
        check = etree.Element(f"{{{SVG}}}svg", nsmap={None: SVG}, width="1", height="1")
        asked: set[str] = set()
        for element in self._root.iter():
            for character in {*(element.text or ""), *(part for child in element for part in child.tail or "")} - asked:
                if not character.isascii():
                    asked.add(character)
                    dressed = element if element.get("font-family") else element.getparent()
                    dress = {name: value for name in _DRESS if (value := dressed.get(name)) is not None}
                    etree.SubElement(check, f"{{{SVG}}}text", dress).text = character
        if len(asked) > _MOST_ALONE:
            return {character for character in told if not character.isascii()}
        return set(font_engine.outlines(etree.tostring(check)).missing) & asked

    def _leave_out(self, gone: set[str], texts: list[PendingText]) -> None:
        """Takes characters away from what the engine will be given, and names them."""
        table = {ord(character): _NO_INK for character in gone}
        for element in self._root.iter():
            if element.text:
                element.text = element.text.translate(table)
            if element.tail:
                element.tail = element.tail.translate(table)
        for character in (one for pending in texts for part in pending.element.itertext() for one in part):
            if character in gone:
                self._walk.notes.add(
                    "{count} [character is|characters are] in no installed font and left out ({names})", named(character)
                )

    def _set_here(self, texts: list[PendingText]) -> set[int]:
        """Texts to be set glyph by glyph: those along a path, and where there is much text all that is plain enough."""
        characters = sum(len(part) for text in texts for part in text.element.itertext())
        much = len(texts) > _MANY_TEXTS or characters > _MANY_CHARACTERS
        return {i for i, text in enumerate(texts) if _runs_on_path(self._walk, text.element) or (much and _is_plain(text))}

    def _want_glyphs(self, element: Any, style: Style, frame: Frame) -> None:
        """Orders the glyphs of every character below `element`."""
        self._order(element.text, style)
        for child in element:
            kind = self._walk.kind(child.tag)
            if kind in _TEXTS:
                self._want_glyphs(child, self._walk.cascade.style(child, kind, child.items(), style, frame), frame)
            self._order(child.tail, style)

    def _order(self, text: str | None, style: Style) -> None:
        plain = "".join(" " if character.isspace() else character for character in text or "")
        for part in (Glyphs.RULER, *plain, *map("".join, pairwise(plain))) if plain else ():
            number = self._glyphs.wanted(part, style)
            if number is not None:
                group = etree.SubElement(self._root, f"{{{SVG}}}g", id=f"c{number}")
                line = etree.SubElement(group, f"{{{SVG}}}text", {_XML_SPACE: "preserve"})
                self._dress(line, style)
                for words, color in ((part, "#000001"), (Glyphs.RULER, "#000002")):
                    etree.SubElement(line, f"{{{SVG}}}tspan", fill=color).text = words

    def _place(self, layout: Layout, pending: PendingText) -> None:
        """A text on a path: the engine's glyphs, set one by one."""
        context = pending.context
        for placed in layout.place(pending.element, context.style, context.frame):
            style = placed.style
            outline = self._glyphs.outline(placed.character, style)
            if outline and style.visible and (style.fill is not None or style.stroke is not None):
                matrix = multiply(context.matrix, placed.matrix)
                shape = Shape(style, pending.layer, matrix, context.clips, None, pending.order, style.color)
                self._walk.collector.add_path(pending.element, shape, outline)

    def _collect(self, element: Any, pending: PendingText, outer: Matrix) -> None:
        """The paths below `element`, with the transforms the engine gave them."""
        matrix = multiply(outer, parse_transform(element.get("transform", "")) or IDENTITY)
        if element.tag == f"{{{SVG}}}path":
            context = pending.context
            full = multiply(context.matrix, matrix)
            shape = Shape(context.style, pending.layer, full, context.clips, None, pending.order, element.get("fill"))
            self._walk.collector.add_path(pending.element, shape, element.get("d", ""))
        for child in element:
            self._collect(child, pending, matrix)

    def _copy(self, element: Any, kind: str, style: Style, frame: Frame, parent: Any) -> None:
        """`element` and its text below `parent`, with nothing left to inherit."""
        made = etree.SubElement(parent, f"{{{SVG}}}{kind}")
        for name in _PLACED:
            value = element.get(name)
            if value is not None:
                made.set(name, self._absolute(name, value, frame))
        self._dress(made, style)
        made.text = element.text
        for child in element:
            child_kind = self._walk.kind(child.tag)
            if child_kind in _TEXTS:
                child_style = self._walk.cascade.style(child, child_kind, child.items(), style, frame)
                if child_style.displayed:
                    child_frame = Frame(frame.width, frame.height, child_style.font_px, frame.px_per_in)
                    self._copy(child, "tspan" if child_kind in ("a", "tref") else child_kind, child_style, child_frame, made)
                    made[-1].tail = child.tail
                    continue
            if child.tail:
                if len(made):
                    made[-1].tail = (made[-1].tail or "") + child.tail
                else:
                    made.text = (made.text or "") + child.tail

    def _absolute(self, name: str, value: str, frame: Frame) -> str:
        """Percentages and units of a list of lengths worked out, as the engine's viewport is not the text's own."""
        if name not in _ACROSS:
            return value
        percent_of = getattr(frame, _ACROSS[name])
        lengths = [parse_length(part, frame, percent_of) for part in re.split(r"[\s,]+", value.strip()) if part]
        return " ".join(repr(length) for length in lengths if length is not None)

    def _dress(self, made: Any, style: Style) -> None:
        for name in _FONT:
            if name in style.inherited:
                made.set(name, style.inherited[name])
        for name in _FONT_OWN:
            if name in style.own:
                made.set(name, style.own[name])
        made.set("font-size", repr(style.font_px))
        made.set("font-family", self._font(style.inherited.get("font-family", "sans-serif")))
        painted = (style.fill is not None or style.stroke is not None or self._walk.options.hidden != "skip") and style.visible
        # The fill carries the pen's colour through the engine.
        made.set("fill", (style.color or "#000000") if painted else "none")

    def _font(self, wanted: str) -> str:
        """An installed family for a font-family list, noted once for each list."""
        names = [name.strip().strip("\"'") for name in wanted.split(",")]
        found = next((family for name in names for family in self._installed(name)), None)
        if found is None:
            found = next(iter(self._installed("sans-serif")), next(iter(self._families.values()), "sans-serif"))
        if wanted not in self._fonts:
            self._fonts[wanted] = found
            stand_in = "" if found.lower() == names[0].lower() else f" (for {names[0]}, which is not installed)"
            if names[0].lower() in _GENERIC:
                stand_in = f" (for {names[0]})"
            self._walk.notes.add(f"text was drawn as outlines in {found}{stand_in}")
        return found

    def _installed(self, name: str) -> list[str]:
        lower = name.lower()
        if lower in self._families:
            return [self._families[lower]]
        return [self._families[one.lower()] for one in _GENERIC.get(lower, ()) if one.lower() in self._families]


def _runs_on_path(walk: Walk, element: Any) -> bool:
    return any(walk.kind(one.tag) == "textPath" for one in element.iter())


def _is_plain(pending: PendingText) -> bool:
    """Latin letters in a row, which need no more than advances and kerning."""
    if any(name in pending.context.style.inherited for name in _NOT_PLAIN):
        return False
    for element in pending.element.iter():
        if any(element.get(name) is not None for name in _NOT_PLAIN) or "baseline" in (element.get("style") or ""):
            return False
    return all(part.isascii() or max(part) <= _LAST_PLAIN for part in pending.element.itertext() if part)
