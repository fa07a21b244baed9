"""Where the characters of a text stand (SVG 2, 11.5), for a font whose advances are known: chunks, anchors, lists of positions,
white space, and text on a path. No bidirectional or vertical text, no ligatures."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from plotter.svg.along import Track, track_of
from plotter.svg.document import XLINK
from plotter.svg.lengths import Frame, parse_length
from plotter.svg.matrix import IDENTITY, Matrix, parse_transform
from plotter.svg.shapes import is_shape, outline, path_text
from plotter.svg.style import Style

if TYPE_CHECKING:
    from plotter.svg.walk import Walk

_XML_SPACE = "{http://www.w3.org/XML/1998/namespace}space"
_CHILDREN = frozenset(("tspan", "textPath", "a", "tref"))
_SHARE = {"start": 0.0, "middle": 0.5, "end": 1.0}


@dataclass(slots=True)
class Placed:
    """One character: its style, and the map from its own units (px, origin on the baseline) to the text's user units."""

    character: str
    style: Style
    matrix: Matrix


@dataclass(slots=True)
class _Cell:
    character: str
    style: Style
    x: float | None = None
    y: float | None = None
    dx: float = 0.0
    dy: float = 0.0
    turn: float = 0.0
    track: Track | None = None
    offset: float = 0.0
    advance: float = 0.0


class Layout:
    """Lays out one text element."""

    def __init__(self, walk: Walk, advance: Callable[[str, str, Style], float]) -> None:
        """`advance` gives a character's advance in px, kerned for the one that follows it in the same style, or for nothing."""
        self._walk = walk
        self._advance = advance

    def place(self, element: Any, style: Style, frame: Frame) -> list[Placed]:
        """The characters of `element`, in order; those beyond the end of their path are left out."""
        cells = _collapsed(self._cells(element, style, frame, None, 0.0), keep=element.get(_XML_SPACE) == "preserve")
        for i, cell in enumerate(cells):
            spacing = cell.style.inherited.get("letter-spacing", "normal")
            following = cells[i + 1].character if i + 1 < len(cells) and cells[i + 1].style is cell.style else ""
            cell.advance = self._advance(cell.character, following, cell.style) + (parse_length(spacing, frame) or 0.0)
        placed: list[Placed] = []
        x = y = 0.0
        at = 0
        while at < len(cells):
            end = at + 1
            while end < len(cells) and cells[end].x is None and cells[end].y is None and cells[end].track is cells[at].track:
                end += 1
            x, y = self._chunk(cells[at:end], x, y, placed)
            at = end
        return placed

    def _chunk(self, cells: list[_Cell], x: float, y: float, placed: list[Placed]) -> tuple[float, float]:
        """Places one chunk, which its anchor shifts as a whole; gives where the pen is after it."""
        first = cells[0]
        track = first.track
        if track is not None:
            x, y = first.offset if first.x is None else first.x + first.offset, 0.0
        else:
            x, y = x if first.x is None else first.x, y if first.y is None else first.y
        width = sum(cell.advance + cell.dx for cell in cells)
        x -= width * _SHARE.get(first.style.inherited.get("text-anchor", "start"), 0.0)
        for cell in cells:
            x, y = x + cell.dx, y + cell.dy
            matrix = _turned(x, y, cell.turn) if track is None else _on_track(track, x, y, cell)
            if matrix is not None and not cell.character.isspace():
                placed.append(Placed(cell.character, cell.style, matrix))
            x += cell.advance
        return x, y

    def _cells(self, element: Any, style: Style, frame: Frame, track: Track | None, offset: float) -> list[_Cell]:
        """Characters below `element`, with the positions that its own lists give them."""
        cells = [_Cell(character, style, track=track, offset=offset) for character in element.text or ""]
        for child in element:
            kind = self._walk.kind(child.tag)
            if kind in _CHILDREN:
                child_style = self._walk.cascade.style(child, kind, child.items(), style, frame)
                child_frame = Frame(frame.width, frame.height, child_style.font_px, frame.px_per_in)
                if child_style.displayed and kind == "textPath":
                    own, begin = self._track(child, child_frame)
                    if own is not None:
                        cells += self._cells(child, child_style, child_frame, own, begin)
                elif child_style.displayed:
                    cells += self._cells(child, child_style, child_frame, track, offset)
            cells += [_Cell(character, style, track=track, offset=offset) for character in child.tail or ""]
        self._positions(cells, element, frame)
        return cells

    def _positions(self, cells: list[_Cell], element: Any, frame: Frame) -> None:
        solid = [
            cell for i, cell in enumerate(cells) if not cell.character.isspace() or (i and not cells[i - 1].character.isspace())
        ]
        for name, percent_of in (("x", frame.width), ("y", frame.height), ("dx", frame.width), ("dy", frame.height)):
            values = self._list(element.get(name), frame, percent_of)
            for cell, value in zip(solid, values, strict=False):
                if name in ("x", "y"):
                    if getattr(cell, name) is None:
                        setattr(cell, name, value)
                elif getattr(cell, name) == 0:
                    setattr(cell, name, value)
        turns = self._list(element.get("rotate"), frame, 0.0)
        for i, cell in enumerate(solid if turns else ()):
            cell.turn = cell.turn or math.radians(turns[min(i, len(turns) - 1)])

    @staticmethod
    def _list(text: str | None, frame: Frame, percent_of: float) -> list[float]:
        found = [parse_length(part, frame, percent_of) for part in re.split(r"[\s,]+", (text or "").strip()) if part]
        return [value for value in found if value is not None]

    def _track(self, element: Any, frame: Frame) -> tuple[Track | None, float]:
        """The path that a textPath runs along, and where on it the text begins."""
        href = (element.get("href") or element.get(f"{{{XLINK}}}href") or "").strip()
        target = self._walk.references.by_id(href.lstrip("#"))
        track = track_of(*outline_of(self._walk, target)) if target is not None else None
        if track is None:
            return None, 0.0
        return track, parse_length(element.get("startOffset"), frame, track.length) or 0.0


def outline_of(walk: Walk, target: Any) -> tuple[str, Matrix]:
    """Path data of a shape element, and its own transform."""
    kind = walk.kind(target.tag)
    attributes = dict(target.items())
    found = outline(kind, attributes, Frame(100.0, 100.0)) if is_shape(kind) else None
    data = "" if found is None else path_text(found)
    return data, parse_transform(attributes.get("transform", "")) or IDENTITY


def _turned(x: float, y: float, angle: float) -> Matrix:
    return (math.cos(angle), math.sin(angle), -math.sin(angle), math.cos(angle), x, y)


def _on_track(track: Track, x: float, y: float, cell: _Cell) -> Matrix | None:
    """A character rests on the path with the middle of its advance."""
    half = cell.advance / 2
    here = track.at(x + half)
    if here is None:
        return None
    px, py, angle = here
    cos, sin = math.cos(angle), math.sin(angle)
    return _turned(px - half * cos - y * sin, py - half * sin + y * cos, angle + cell.turn)


def _collapsed(cells: list[_Cell], *, keep: bool) -> list[_Cell]:
    """White space as xml:space says: kept as spaces, or runs made one and both ends stripped."""
    for cell in cells:
        if cell.character in "\t\n\r":
            cell.character = " "
    if keep:
        return cells
    kept: list[_Cell] = []
    for cell in cells:
        if cell.character == " " and (not kept or kept[-1].character == " "):
            continue
        kept.append(cell)
    while kept and kept[-1].character == " ":
        kept.pop()
    return kept
