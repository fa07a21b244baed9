"""A picture as PNG: drawn four times too large and shrunk, in bands, so that memory stays bounded on a large page."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from planning.geometry.stroke import Points
from plotter.preview.sheet import (
    INK_WIDTH_MM,
    LEGEND_HEIGHT_MM,
    OUTLINE_WIDTH_MM,
    TEXT_COLOR,
    TRAVEL_COLOR,
    TRAVEL_WIDTH_MM,
    Sheet,
)
from plotter.preview.trace import Trace

OVERSAMPLE = 4
LARGEST_PIXELS = 36_000_000
BAND_PIXELS = 12_000_000  # before shrinking
SHARP_TURN_COS = math.cos(math.radians(20.0))


def write_png(path: Path, seen: Trace, sheet: Sheet, dpi: float) -> None:
    """Writes the picture at `dpi`, or less where that would be over 36 million pixels. Raises OSError."""
    scale = min(dpi / 25.4, math.sqrt(LARGEST_PIXELS / (sheet.width_mm * sheet.height_mm)))  # pixels per mm
    width, height = math.ceil(sheet.width_mm * scale), math.ceil(sheet.height_mm * scale)
    picture = Image.new("RGB", (width, height), "#ffffff")
    rows = max(1, BAND_PIXELS // (width * OVERSAMPLE**2))
    for top in range(0, height, rows):
        band = _Band(width, min(rows, height - top), top, scale, sheet)
        _draw_lines(band, seen, sheet)
        picture.paste(band.image.reduce(OVERSAMPLE), (0, top))
    _draw_legend(picture, sheet, scale)
    picture.save(path, dpi=(scale * 25.4, scale * 25.4))


def _draw_lines(band: _Band, seen: Trace, sheet: Sheet) -> None:
    for outline in sheet.outlines:
        band.line(outline.points_mm, outline.color, OUTLINE_WIDTH_MM)
    for points in seen.travels:
        band.line(points, TRAVEL_COLOR, TRAVEL_WIDTH_MM)
    for line in seen.ink:
        band.line(line.points_mm, line.color, INK_WIDTH_MM)


class _Band:
    """A strip of the picture, oversampled; `top` is its first row in the shrunk picture."""

    def __init__(self, width: int, rows: int, top: int, scale: float, sheet: Sheet) -> None:
        self.image = Image.new("RGB", (width * OVERSAMPLE, rows * OVERSAMPLE), "#ffffff")
        self._draw = ImageDraw.Draw(self.image)
        self._scale = scale * OVERSAMPLE
        self._origin_mm = np.array([sheet.left, sheet.top + top / scale])

    def line(self, points_mm: Points, color: str, width_mm: float) -> None:
        """Draws the part of the polyline (n, 2) that this band shows, with round ends and round corners."""
        width = max(2, round(width_mm * self._scale))
        points = (points_mm - self._origin_mm) * self._scale - 0.5  # a pixel's own coordinate is its centre
        for run in _runs_within(points, -width, self.image.height + width):
            if len(run) > 1:
                self._draw.line(run.ravel().tolist(), fill=color, width=width)
            if width > 2:
                r = (width - 1) / 2
                for x, y in run[_needs_cap(run)].tolist():
                    self._draw.ellipse((x - r, y - r, x + r, y + r), fill=color)
            elif len(run) == 1:
                self._draw.point(run.ravel().tolist(), fill=color)


def _runs_within(points: Points, low: float, high: float) -> Iterator[Points]:
    """The stretches of the polyline whose segments have some y between `low` and `high`."""
    y = points[:, 1]
    if len(points) == 1:
        if low <= y[0] <= high:
            yield points
        return
    shown = (np.maximum(y[:-1], y[1:]) >= low) & (np.minimum(y[:-1], y[1:]) <= high)
    if shown.all():
        yield points
        return
    edges = np.flatnonzero(np.diff(np.concatenate(([False], shown, [False])).astype(np.int8)))
    for first, end in zip(edges[::2], edges[1::2], strict=True):
        yield points[first : end + 1]


def _needs_cap(points: Points) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """True at the ends, and where the line turns so sharply that wide segments leave a notch."""
    caps = np.ones(len(points), dtype=np.bool_)
    if len(points) > 2:
        steps = np.diff(points, axis=0)
        lengths = np.hypot(*steps.T)
        caps[1:-1] = (steps[:-1] * steps[1:]).sum(axis=1) < SHARP_TURN_COS * lengths[:-1] * lengths[1:]
    return caps


def _draw_legend(picture: Image.Image, sheet: Sheet, scale: float) -> None:
    draw = ImageDraw.Draw(picture)
    size = sheet.text_height_mm * scale
    font = ImageFont.load_default(size=max(size, 4.0))
    x, y = 5 * scale, picture.height - LEGEND_HEIGHT_MM * scale + (LEGEND_HEIGHT_MM * scale - size) / 2 - size / 3
    for text, color in sheet.legend:
        if color:
            draw.rectangle((x, y + 0.35 * size, x + 0.8 * size, y + 1.05 * size), fill=color)
            x += 1.2 * size
        draw.text((x, y), text, fill=TEXT_COLOR, font=font)
        x += draw.textlength(text, font=font) + 1.5 * size
