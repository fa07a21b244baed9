"""A picture as SVG: true millimetres, one Inkscape layer for travels and one for each layer of the drawing."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from xml.sax.saxutils import escape, quoteattr

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


def write_svg(path: Path, seen: Trace, sheet: Sheet) -> None:
    """Writes the picture line by line. Raises OSError when the file cannot be written."""
    with path.open("w", encoding="utf-8", newline="\n") as out:
        for text in _document(seen, sheet):
            out.write(text)


def _document(seen: Trace, sheet: Sheet) -> Iterator[str]:
    size = f'width="{sheet.width_mm:.3f}mm" height="{sheet.height_mm:.3f}mm"'
    box = f'viewBox="{sheet.left:.3f} {sheet.top:.3f} {sheet.width_mm:.3f} {sheet.height_mm:.3f}"'
    yield '<?xml version="1.0" encoding="UTF-8"?>\n'
    yield '<svg xmlns="http://www.w3.org/2000/svg" xmlns:inkscape="http://www.inkscape.org/namespaces/inkscape" '
    yield f'version="1.1" {size} {box}>\n'
    yield f'<rect x="{sheet.left:.3f}" y="{sheet.top:.3f}" width="100%" height="100%" fill="#ffffff"/>\n'
    for outline in sheet.outlines:
        yield f'<polyline class="{outline.kind}" points={_points(outline.points_mm)} fill="none" stroke="{outline.color}" '
        yield f'stroke-width="{OUTLINE_WIDTH_MM}"/>\n'
    yield _group("travel", "pen up", TRAVEL_COLOR, TRAVEL_WIDTH_MM)
    for points in seen.travels:
        yield f"<polyline points={_points(points)}/>\n"
    yield "</g>\n"
    for number, lines in groupby(seen.ink, key=lambda line: line.layer):
        run = list(lines)
        yield _group("ink", seen.layers.get(number) or "pen down", run[0].color, INK_WIDTH_MM)
        for line in run:
            own = "" if line.color == run[0].color else f' stroke="{line.color}"'
            # a dot needs a second point, or nothing is painted
            points = line.points_mm if len(line.points_mm) > 1 else line.points_mm.repeat(2, axis=0)
            yield f"<polyline{own} points={_points(points)}/>\n"
        yield "</g>\n"
    yield from _legend(sheet)
    yield "</svg>\n"


def _group(kind: str, label: str, color: str, width_mm: float) -> str:
    return (
        f'<g class="{kind}" inkscape:groupmode="layer" inkscape:label={quoteattr(label)} fill="none" stroke="{color}" '
        f'stroke-width="{width_mm}" stroke-linecap="round" stroke-linejoin="round">\n'
    )


def _points(points_mm: Points) -> str:
    return '"' + " ".join(f"{x:.3f},{y:.3f}" for x, y in points_mm.tolist()) + '"'


def _legend(sheet: Sheet) -> Iterator[str]:
    y = sheet.bottom + (LEGEND_HEIGHT_MM - sheet.text_height_mm) / 2
    yield f'<text x="{sheet.left + 5:.3f}" y="{y:.3f}" font-family="sans-serif" '
    yield f'font-size="{sheet.text_height_mm:.3f}" fill="{TEXT_COLOR}">'
    for text, color in sheet.legend:
        swatch = f'<tspan fill="{color}">&#9632;</tspan> ' if color else ""
        yield f"{swatch}{escape(text)} &#160; "
    yield "</text>\n"
