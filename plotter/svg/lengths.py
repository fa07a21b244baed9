"""Numbers and lengths as SVG and CSS write them, in user units (px)."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

MM_PER_IN = 25.4
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_LENGTH = re.compile(rf"\s*({_NUMBER})\s*([a-zA-Z]+|%)?\s*$")
_NOT_FINITE = re.compile(r"\s*[+-]?(nan|inf(inity)?)\b", re.IGNORECASE)

_PER_INCH = {"in": 1.0, "cm": 2.54, "mm": 25.4, "q": 101.6, "pt": 72.0, "pc": 6.0}
# Heights of x and 0 against the font size, where no font is at hand (CSS Values 4, 6.1.1).
_PER_EM = {"em": 1.0, "ex": 0.5, "ch": 0.5, "rem": 1.0, "ic": 1.0, "cap": 0.7}


class NotFinite(ValueError):
    """The text says NaN or infinity, or a number too large for a double."""


@dataclass(frozen=True, slots=True)
class Frame:
    """What lengths are relative to: the nearest viewport in user units, the font size in px, and px per inch."""

    width: float
    height: float
    font_px: float = 16.0
    px_per_in: float = 96.0

    @property
    def diagonal(self) -> float:
        return math.hypot(self.width, self.height) / math.sqrt(2)


def parse_length(text: str | None, frame: Frame, percent_of: float = 0.0) -> float | None:
    """A length in user units, or None where the text is missing or no length. Raises NotFinite."""
    if not text:
        return None
    try:
        value = float(text)
    except ValueError:
        match = _LENGTH.match(text)
        if match is None:
            if _NOT_FINITE.match(text):
                raise NotFinite(text) from None
            return None
        value = float(match[1])
        factor = _unit(match[2], frame, percent_of)
        if factor is None:
            return None
        value *= factor
    if not math.isfinite(value):
        raise NotFinite(text)
    return value


def _unit(unit: str | None, frame: Frame, percent_of: float) -> float | None:
    unit = (unit or "px").lower()
    if unit == "px":
        return 1.0
    if unit == "%":
        return percent_of / 100
    if unit in _PER_INCH:
        return frame.px_per_in / _PER_INCH[unit]
    if unit in _PER_EM:
        return _PER_EM[unit] * frame.font_px
    share = {
        "vw": frame.width,
        "vh": frame.height,
        "vmin": min(frame.width, frame.height),
        "vmax": max(frame.width, frame.height),
    }
    return share[unit] / 100 if unit in share else None


_SEPARATOR = re.compile(r"[\s,]+")


def parse_numbers(text: str) -> list[float] | None:
    """Numbers separated by commas and white space; None where one of them is no number. Raises NotFinite."""
    try:
        values = [float(part) for part in _SEPARATOR.split(text.strip()) if part]
    except ValueError:
        return None
    if not all(map(math.isfinite, values)):
        raise NotFinite(text)
    return values
