"""A poster of text as outlines: the title's glyphs in cubic curves (OpenType), the paragraphs' in quadratic ones (TrueType).

Font: Source Serif Pro by Adobe, SIL Open Font License 1.1, from the PyPI package `font-source-serif-pro` 0.0.1; a drawing
made with a font is not under the font's licence. Text: Lewis Carroll, Alice's Adventures in Wonderland (1865), public domain.
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any

from generators.svgtext import num

WIDTH_MM, HEIGHT_MM = 210.0, 210.0
LEFT_MM, RIGHT_MM = 22.0, 188.0
MM_PER_POINT = 25.4 / 72

TITLE = ("Down the", "Rabbit-Hole")
PARAGRAPH = """\
Alice was beginning to get very tired of sitting by her sister on the bank, and of having nothing to do: once or twice she \
had peeped into the book her sister was reading, but it had no pictures or conversations in it, “and what is the use of a \
book,” thought Alice “without pictures or conversations?”
So she was considering in her own mind (as well as she could, for the hot day made her feel very sleepy and stupid), whether \
the pleasure of making a daisy-chain would be worth the trouble of getting up and picking the daisies, when suddenly a White \
Rabbit with pink eyes ran close by her."""
COLOPHON = "Lewis Carroll, 1865"


class FontMissing(Exception):
    """fontTools or the font is not installed."""


class _Face:
    """A font file's outlines, as path data in mm."""

    def __init__(self, file_name: str) -> None:
        if not find_spec("fontTools") or not (package := find_spec("font_source_serif_pro")):
            raise FontMissing("poster needs fontTools and a font: pip install fonttools==4.* font-source-serif-pro==0.0.1")
        from fontTools.pens.svgPathPen import SVGPathPen  # only this sample needs it
        from fontTools.pens.transformPen import TransformPen
        from fontTools.ttLib import TTFont

        font = TTFont(Path(str(package.origin)).parent / "files" / file_name)
        self._svg_pen, self._transform_pen = SVGPathPen, TransformPen
        self._glyphs: Any = font.getGlyphSet()
        self._names: dict[int, str] = font.getBestCmap()
        self._units: int = font["head"].unitsPerEm

    def width_mm(self, text: str, size_mm: float) -> float:
        return sum(self._glyphs[self._names[ord(c)]].width for c in text) * size_mm / self._units

    def set(self, text: str, x_mm: float, y_mm: float, size_mm: float) -> list[str]:
        """Path data of each glyph that has an outline, from the baseline's (x, y) on."""
        scale, out = size_mm / self._units, []
        for character in text:
            glyph = self._glyphs[self._names[ord(character)]]
            pen = self._svg_pen(self._glyphs, ntos=num)
            glyph.draw(self._transform_pen(pen, (scale, 0, 0, -scale, x_mm, y_mm)))
            if data := pen.getCommands():
                out.append(data)
            x_mm += glyph.width * scale
        return out


def _paragraph(
    face: _Face, text: str, left: float, right: float, y: float, size: float, leading: float, first: float
) -> tuple[list[str], float]:
    """Justified lines from the baseline y on, the first indented by `first`; the glyphs, and the next line's baseline."""
    out: list[str] = []
    space = face.width_mm(" ", size)
    words, line, indent = text.split(), [], first
    for word in [*words, ""]:
        width = sum(face.width_mm(w, size) for w in [*line, word]) + space * len(line)
        if word and width <= right - left - indent:
            line.append(word)
            continue
        used = sum(face.width_mm(w, size) for w in line)
        gap = (right - left - indent - used) / (len(line) - 1) if word and len(line) > 1 else space
        x = left + indent
        for w in line:
            out += face.set(w, x, y, size)
            x += face.width_mm(w, size) + gap
        y, line, indent = y + leading, [word], 0.0
    return out, y


def poster() -> str:
    title, text, italic = (_Face(f"SourceSerifPro-{style}") for style in ("Bold.otf", "Regular.ttf", "It.ttf"))
    big: list[str] = []
    y = 46.0
    for line in TITLE:
        size = 33.0
        big += title.set(line, (WIDTH_MM - title.width_mm(line, size)) / 2, y, size)
        y += 33.0
    small: list[str] = []
    y -= 10.0
    for number, paragraph in enumerate(PARAGRAPH.split("\n")):
        size = 16 * MM_PER_POINT
        glyphs, y = _paragraph(text, paragraph, LEFT_MM, RIGHT_MM, y, size, 8.5, 0.0 if number == 0 else 8.0)
        small += glyphs
    size = 15 * MM_PER_POINT
    small += italic.set(COLOPHON, RIGHT_MM - italic.width_mm(COLOPHON, size), 196.0, size)
    groups = "".join(
        f'  <g\n     id="{name}"\n     aria-label="{name}"\n     style="fill:none;stroke:{color};stroke-width:0.25">\n'
        + "".join(f'    <path\n       d="{data}" />\n' for data in paths)
        + "  </g>\n"
        for name, color, paths in (("title", "#8c1c13", big), ("text", "#1a1a1a", small))
    )
    return (
        '<?xml version="1.0" encoding="UTF-8" standalone="no"?>\n'
        f'<svg\n   width="{num(WIDTH_MM)}mm"\n   height="{num(HEIGHT_MM)}mm"\n'
        f'   viewBox="0 0 {num(WIDTH_MM)} {num(HEIGHT_MM)}"\n'
        '   version="1.1"\n   xmlns="http://www.w3.org/2000/svg">\n'
        "  <title>Down the Rabbit-Hole</title>\n"
        "  <desc>Public domain, CC0 1.0; outlines drawn with Source Serif Pro (Adobe, SIL Open Font License 1.1)</desc>\n"
        f"{groups}</svg>\n"
    )
