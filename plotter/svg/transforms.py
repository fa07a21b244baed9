"""An element's own transform, from its attribute or its style, with its origin."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from plotter.svg.lengths import Frame, parse_length
from plotter.svg.matrix import Matrix, multiply, parse_transform, translation
from plotter.svg.notes import Notes
from plotter.svg.style import Style

# So many different transforms are kept parsed.
_KNOWN = 100_000


class Transforms:
    """Parses each transform once. `name_of` is how notes name an element."""

    def __init__(self, notes: Notes, name_of: Callable[[Any], str]) -> None:
        self._notes = notes
        self._name = name_of
        self._known: dict[str, Matrix | None] = {}

    def own(self, element: Any, style: Style, frame: Frame) -> Matrix | None:
        """Where the element's coordinates lie in its parent's; None without a transform, or with one that is not valid."""
        text = style.own.get("transform", element.get("transform"))
        if text is None:
            return None
        try:
            matrix = self._known[text]
        except KeyError:
            matrix = parse_transform(text)
            if len(self._known) < _KNOWN:
                self._known[text] = matrix
        if matrix is None:
            self._notes.add(
                "{count} [transform is|transforms are] not valid and ignored ({names})",
                f"{self._name(element)}: {text[:40]}",
            )
            return None
        origin = style.own.get("transform-origin")
        if origin is not None:
            at = _origin(origin, frame)
            matrix = multiply(multiply(translation(*at), matrix), translation(-at[0], -at[1]))
        return matrix


_ORIGIN_WORDS = {"left": "0%", "top": "0%", "center": "50%", "right": "100%", "bottom": "100%"}


def _origin(text: str, frame: Frame) -> tuple[float, float]:
    """transform-origin against the viewport (transform-box: view-box, SVG's default)."""
    words = text.split()
    if len(words) >= 2 and (words[0] in ("top", "bottom") or words[1] in ("left", "right")):
        words[:2] = [words[1], words[0]]
    x = _ORIGIN_WORDS.get(words[0], words[0]) if words else "0"
    y = _ORIGIN_WORDS.get(words[1], words[1]) if len(words) > 1 else "50%"
    return parse_length(x, frame, frame.width) or 0.0, parse_length(y, frame, frame.height) or 0.0
