"""Lengths, speeds and times as people write them. The one module that turns written units into millimetres and seconds."""

from __future__ import annotations

import math
import re

MM_PER = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4, "pt": 25.4 / 72, "pc": 25.4 / 6, "px": 25.4 / 96, "q": 0.25}
SECONDS_PER = {"s": 1.0, "ms": 0.001, "min": 60.0, "h": 3600.0}
_QUANTITY = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([a-zA-Z%/0-9]*)\s*$")


def parse_quantity(text: str, units: dict[str, float], default_unit: str) -> float:
    """`text` as a number in the base unit of `units`. A bare number is in `default_unit`.

    Raises ValueError that names the text and the units it may have.
    """
    match = _QUANTITY.match(text)
    unit = (match.group(2) or default_unit).lower() if match else ""
    if match is None or unit not in units:
        raise ValueError(f"'{text}' is not a number with one of the units {', '.join(units)}")
    value = float(match.group(1)) * units[unit]
    if not math.isfinite(value):
        raise ValueError(f"'{text}' is not a finite number")
    return value


def length_mm(text: str) -> float:
    """`10mm`, `1in`, `2.5` (millimetres) as millimetres."""
    return parse_quantity(text, MM_PER, "mm")


def _per(suffix: str) -> dict[str, float]:
    return {f"{unit}/{suffix}": scale for unit, scale in MM_PER.items()}


def speed_mm_s(text: str) -> float:
    """`80`, `80mm/s`, `3in/s` as mm/s."""
    return parse_quantity(text, _per("s"), "mm/s")


def acceleration_mm_s2(text: str) -> float:
    """`1000`, `1000mm/s2`, `1m/s2` as mm/s2."""
    return parse_quantity(text, _per("s2"), "mm/s2")


def jerk_mm_s3(text: str) -> float:
    """`50000`, `50000mm/s3`, `50m/s3` as mm/s3."""
    return parse_quantity(text, _per("s3"), "mm/s3")


def time_s(text: str) -> float:
    """`1.5`, `200ms`, `10min` as seconds."""
    return parse_quantity(text, SECONDS_PER, "s")


def percent(text: str) -> float:
    """`60` or `60%`."""
    return parse_quantity(text, {"%": 1.0}, "%")


def amount(text: str) -> tuple[float | None, float | None]:
    """`2m` as (millimetres, None), `5min` as (None, seconds). A unit is needed: `5` could be either."""
    match = _QUANTITY.match(text)
    unit = match.group(2).lower() if match else ""
    if unit in MM_PER:
        return length_mm(text), None
    if unit in SECONDS_PER:
        return None, time_s(text)
    raise ValueError(f"'{text}' is neither a length, like 2m, nor a time, like 5min")


def point_mm(text: str) -> tuple[float, float]:
    """`200mm,15mm` as x and y in millimetres."""
    words = text.split(",")
    if len(words) != 2:
        raise ValueError(f"'{text}' is not two lengths with a comma between them, like 200mm,15mm")
    return length_mm(words[0]), length_mm(words[1])


def spoken_duration(seconds: float) -> str:
    """A duration as a person says it: `8.4 s`, `3 min 05 s`, `1 h 02 min`."""
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {rest:02d} s"
    return f"{minutes // 60} h {minutes % 60:02d} min"
