"""CSS colours to `#rrggbb`, for the choice of pens."""

from __future__ import annotations

import functools
import re
from dataclasses import dataclass

import tinycss2.color4

_HEX6 = re.compile(r"#[0-9a-fA-F]{6}$")


@dataclass(frozen=True, slots=True)
class Paint:
    """What a fill or a stroke is painted with. `color` is `#rrggbb`; None for a gradient or a pattern, whose id is `server`."""

    color: str | None
    opaque: bool
    server: str | None = None
    has_fallback: bool = False


_URL = re.compile(r"url\(\s*[\"']?([^\"')]*)[\"']?\s*\)\s*(.*)$", re.DOTALL)


@functools.lru_cache(maxsize=65536)
def parse_paint(text: str, current_color: str) -> Paint | None:
    """The paint of a `fill` or `stroke` value; None for none, for what is wholly transparent and for what is no colour."""
    text = text.strip()
    if text == "none":
        return None
    if _HEX6.match(text):
        return Paint(text.lower(), True)
    if text.startswith("url("):
        match = _URL.match(text)
        if match is None:
            return None
        fallback = parse_paint(match[2], current_color) if match[2] else None
        return Paint(fallback.color if fallback else None, True, match[1].lstrip("#"), fallback is not None)
    if text.lower() == "currentcolor":
        return parse_paint(current_color, "black")
    if text.startswith(("context-fill", "context-stroke")):
        return Paint(None, True)
    try:
        color = tinycss2.color4.parse_color(text)
    except (ValueError, TypeError):
        return None
    if color is None:
        return None
    if isinstance(color, str):  # currentcolor inside something
        return Paint(None, True)
    try:
        red, green, blue = (round(255 * min(1.0, max(0.0, c or 0.0))) for c in color.to("srgb").coordinates)
    except (NotImplementedError, ValueError):
        return Paint(None, True)
    if color.alpha == 0:
        return None
    return Paint(f"#{red:02x}{green:02x}{blue:02x}", color.alpha >= 1)


_WORDS = frozenset(("none", "currentcolor", "transparent", "inherit", "initial", "unset", "context-fill", "context-stroke"))


@functools.lru_cache(maxsize=65536)
def is_paint(text: str) -> bool:
    """Whether a text is a value of `fill` or `stroke` at all."""
    text = text.strip()
    if _HEX6.match(text) or text.lower() in _WORDS or text.startswith("url("):
        return True
    try:
        return tinycss2.color4.parse_color(text) is not None
    except (ValueError, TypeError):
        return False
