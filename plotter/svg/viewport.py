"""viewBox and preserveAspectRatio: from a viewBox to the rectangle it is shown in (SVG 2, 8.2)."""

from __future__ import annotations

from plotter.svg.lengths import parse_numbers
from plotter.svg.matrix import Matrix

Box = tuple[float, float, float, float]

_ALIGN = {"min": 0.0, "mid": 0.5, "max": 1.0}


def parse_view_box(text: str | None) -> Box | None:
    """(min x, min y, width, height), or None where it is missing or no viewBox; a size of zero or below is none."""
    if not text:
        return None
    values = parse_numbers(text)
    if values is None or len(values) != 4 or values[2] < 0 or values[3] < 0:
        return None
    return (values[0], values[1], values[2], values[3])


def fit_view_box(box: Box, width: float, height: float, aspect: str | None) -> Matrix:
    """The map from viewBox units to a viewport of `width` x `height` at the origin. The box has a positive size."""
    x, y, w, h = box
    words = (aspect or "").replace("defer", " ").split()
    align = words[0] if words else "xMidYMid"
    sx, sy = width / w, height / h
    if align == "none":
        return (sx, 0.0, 0.0, sy, -x * sx, -y * sy)
    share_x, share_y = _ALIGN.get(align[1:4].lower(), 0.5), _ALIGN.get(align[5:8].lower(), 0.5)
    if len(align) != 8 or not align.startswith("x") or align[4] != "Y":
        share_x = share_y = 0.5
    scale = max(sx, sy) if words[1:2] == ["slice"] else min(sx, sy)
    return (scale, 0.0, 0.0, scale, -x * scale + (width - w * scale) * share_x, -y * scale + (height - h * scale) * share_y)
