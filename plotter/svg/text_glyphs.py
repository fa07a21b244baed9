"""Single glyphs by the font engine: outline and advance of a character in a style.

A character is set in front of a ruler, a character of known place: how far it pushes the ruler is its advance.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from plotter.svg.document import SVG
from plotter.svg.path_segments import resolve
from plotter.svg.path_tokens import parse_paths
from plotter.svg.style import Style

_FACE = ("font-family", "font-style", "font-variant", "font-weight", "font-stretch")


class Glyphs:
    """Glyphs wanted, and what the engine made of them; in px, origin on the baseline."""

    RULER: ClassVar[str] = "|"

    def __init__(self) -> None:
        self._numbers: dict[tuple[Any, ...], int] = {}
        self._outlines: dict[int, str] = {}
        self._rulers: dict[int, float] = {}
        self._is_ruler: set[int] = set()
        self._alone: dict[int, float] = {}

    @staticmethod
    def _key(character: str, style: Style) -> tuple[Any, ...]:
        return (character, style.font_px, *(style.inherited.get(name) for name in _FACE))

    def wanted(self, character: str, style: Style) -> int | None:
        """The number under which to order a glyph or a pair, the ruler's own first; None where it is ordered already."""
        key = self._key(character, style)
        if key in self._numbers:
            return None
        self._numbers[key] = len(self._numbers)
        if character == self.RULER:
            self._is_ruler.add(self._numbers[key])
        return self._numbers[key]

    def read(self, number: int, group: Any) -> None:
        """Takes the engine's outlines of an ordered glyph: the glyph's, and the ruler's."""
        for path in group.iter(f"{{{SVG}}}path"):
            if path.get("fill") == "#000001":
                self._outlines[number] = path.get("d", "")
                if number in self._is_ruler:
                    self._alone[number] = _left(path.get("d", ""))
            else:
                self._rulers[number] = _left(path.get("d", ""))

    def outline(self, character: str, style: Style) -> str:
        return self._outlines.get(self._numbers.get(self._key(character, style), -1), "")

    def advance(self, character: str, following: str, style: Style) -> float:
        """Advance of a character, kerned for what follows it; zero for a glyph that the engine did not make."""
        single = self._pushed(character, style)
        pair = character + following
        if not following or self._key(pair, style) not in self._numbers:
            return single
        return self._pushed(pair, style) - self._pushed(following, style)

    def _pushed(self, text: str, style: Style) -> float:
        """How far `text` pushes the ruler."""
        at = self._rulers.get(self._numbers.get(self._key(text, style), -1))
        alone = self._alone.get(self._numbers.get(self._key(self.RULER, style), -1))
        return 0.0 if at is None or alone is None else at - alone


def _left(data: str) -> float:
    """Least x of an outline."""
    commands, _ = parse_paths([data])
    return float(resolve(commands).points[:, :, 0].min(initial=np.inf))
