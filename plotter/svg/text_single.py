"""Texts as single-line strokes in Hershey's simplex roman, of the package Hershey-Fonts (extra `text`).

The font's capitals are 21 units high and stand 9 units below its zero; they are made as high as those of a usual face.
"""

from __future__ import annotations

import functools
import importlib
import importlib.util
import unicodedata
from typing import TYPE_CHECKING, Any

from plotter.svg.collector import Shape
from plotter.svg.context import PendingText
from plotter.svg.matrix import apply
from plotter.svg.names import named
from plotter.svg.style import Style
from plotter.svg.text_layout import Layout, Placed

if TYPE_CHECKING:
    from plotter.svg.walk import Walk

FONT = "futural"
_BASELINE = 9.0
_CAPITAL_PER_EM = 0.7
_UNITS_PER_EM = 21.0 / _CAPITAL_PER_EM
_STAND_INS = {
    "‘": "'",
    "’": "'",
    "“": '"',
    "”": '"',
    "–": "-",
    "—": "-",
    "−": "-",
    "…": "...",
    "×": "x",
    "\u00a0": " ",
    "ß": "ss",
    "½": "1/2",
    "¼": "1/4",
    "¾": "3/4",
}


def available() -> bool:
    """Whether the package with the font is installed."""
    return importlib.util.find_spec("HersheyFonts") is not None


def draw_single(walk: Walk, texts: list[PendingText]) -> None:
    """Adds the strokes of `texts` to the walk's collector; characters that the font lacks, or draws as others, are noted."""
    layout = Layout(walk, _advance)
    for pending in texts:
        for placed in layout.place(pending.element, pending.context.style, pending.context.frame):
            if not placed.style.visible or (placed.style.fill is None and placed.style.stroke is None):
                continue
            if not _drawable(placed.character):
                walk.notes.add(
                    "{count} [character is|characters are] not in the single-line font and left out ({names})",
                    named(placed.character),
                )
            elif _looks_other(placed.character):
                walk.notes.add(
                    "{count} [character was|characters were] drawn as the nearest that the font has ({names})",
                    f"{named(placed.character)} as {_drawable(placed.character)}",
                )
            _draw(walk, pending, placed)
    walk.notes.add(f"{{count}} [text was|texts were] drawn as single-line strokes in Hershey {FONT}", count=len(texts))


def _advance(character: str, _following: str, style: Style) -> float:
    return sum(_glyph(one)[0] for one in _drawable(character)) * _scale(style)


def _draw(walk: Walk, pending: PendingText, placed: Placed) -> None:
    scale = _scale(placed.style)
    codes: list[bytes] = []
    numbers: list[float] = []
    begin = 0.0
    for one in _drawable(placed.character):
        width, strokes = _glyph(one)
        for stroke in strokes:
            codes.append(b"M" + b"L" * (len(stroke) - 1))
            for x, y in stroke:
                numbers += apply(placed.matrix, (begin + x) * scale, (y - _BASELINE) * scale)
        begin += width
    if codes:
        context = pending.context
        style, order = placed.style, pending.order
        shape = Shape(style, pending.layer, context.matrix, context.clips, None, order, style.color)
        walk.collector.add_commands(pending.element, shape, b"".join(codes), numbers)


def _scale(style: Style) -> float:
    return style.font_px / _UNITS_PER_EM


@functools.lru_cache(maxsize=4096)
def _drawable(character: str) -> str:
    """What the font draws for a character: itself, a stand-in, its letter without accent, or nothing."""
    plain = _STAND_INS.get(character, character)
    if len(plain) == 1 and not " " <= plain <= "~":
        plain = unicodedata.normalize("NFKD", plain)
    return "".join(one for one in plain if " " <= one <= "~")


def _looks_other(character: str) -> bool:
    """Whether what is drawn for a character is another one to the eye: not so for quotes, dashes and spaces."""
    if _drawable(character) == character or unicodedata.category(character)[0] in "PZ":
        return False
    return character != "−"


@functools.lru_cache(maxsize=256)
def _glyph(character: str) -> tuple[float, list[list[tuple[float, float]]]]:
    """Advance and strokes of an ASCII character, font units, y down."""
    glyph = next(iter(_font().glyphs_for_text(character)))
    left = glyph.left_offset
    strokes = [[(float(x - left), float(y)) for x, y in stroke] for stroke in glyph.strokes]
    return float(glyph.char_width), [stroke for stroke in strokes if stroke]


@functools.lru_cache(maxsize=1)
def _font() -> Any:
    font = importlib.import_module("HersheyFonts").HersheyFonts()
    font.load_default_font(FONT)
    return font
