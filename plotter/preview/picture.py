"""Pictures of a plan, or of the ink that a board's record shows, as .png or .svg."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from output.wording import counted
from planning.geometry.stroke import Points
from planning.motion.plan import Action
from plotter.errors import BadInput
from plotter.preview.formats import picture_format
from plotter.preview.raster import write_png
from plotter.preview.sheet import TRAVEL_COLOR, Sheet
from plotter.preview.table import Table
from plotter.preview.trace import PALETTE, Line, Trace, thin_polyline, trace, visible
from plotter.preview.vector import write_svg

TOLERANCE_MM = 0.01
MARGIN_MM = 5.0


def draw_picture(
    path: Path,
    actions: Iterable[Action],
    table: Table,
    *,
    bounds_mm: tuple[float, float, float, float] | None = None,
    dpi: float = 150.0,
    layer_colors: Mapping[int, str | None] | None = None,
    stroke_colors: Sequence[str | None] | None = None,
) -> None:
    """Draws where the pen goes: down in colour, up thin and pale, on the machine's `table`.

    `actions` is read once. `bounds_mm` (left, top, right, bottom) widens the picture beyond the table and the pen's way.
    `layer_colors` is by layer number, `stroke_colors` by stroke index, `#rrggbb` each; a stroke's goes before its layer's, and
    where both are None a palette's is taken.
    `dpi` is for .png, and less on a page where it would make more than 36 million pixels.
    The lines are within 0.01 mm of the plan's motion.

    Raises BadInput when the name ends neither in .png nor .svg, or the file cannot be written.
    """
    write = _writer(path, dpi)
    seen = trace(actions, tolerance_mm=TOLERANCE_MM, layer_colors=layer_colors, stroke_colors=stroke_colors)
    colors: dict[int, str] = {}
    for line in seen.ink:
        colors.setdefault(line.layer, line.color)
    legend: list[tuple[str, str | None]] = [(seen.layers.get(number) or "pen down", color) for number, color in colors.items()]
    legend += [(f"pen down {seen.down_mm / 1000:.2f} m in {counted(len(seen.ink), 'stroke')}", None)]
    legend += [(f"pen up {seen.up_mm / 1000:.2f} m", TRAVEL_COLOR)]
    _write(path, write, seen, table, bounds_mm, legend)


def draw_ink(
    path: Path,
    strokes_mm: Iterable[Points],
    table: Table,
    *,
    dpi: float = 150.0,
    colors: Sequence[str | None] | None = None,
) -> None:
    """Draws pen-down polylines (n, 2), such as a virtual board's record of its ink, on the machine's `table`.

    `colors` is by stroke; None is black. Empty polylines are left out. Raises BadInput as `draw_picture` does.
    """
    write = _writer(path, dpi)
    seen = Trace()
    for index, points in enumerate(strokes_mm):
        if len(points):
            own = colors[index] if colors and index < len(colors) else None
            seen.ink.append(Line(thin_polyline(points, TOLERANCE_MM), visible(own or PALETTE[0]), 0))
    drawn = f"ink {seen.down_mm / 1000:.2f} m in {counted(len(seen.ink), 'stroke')}"
    _write(path, write, seen, table, None, [(drawn, None)])


Writer = Callable[[Path, Trace, Sheet], None]


def _writer(path: Path, dpi: float) -> Writer:
    if picture_format(path) == ".svg":
        return write_svg
    return lambda where, seen, sheet: write_png(where, seen, sheet, dpi)


def _write(
    path: Path,
    write: Writer,
    seen: Trace,
    table: Table,
    bounds_mm: tuple[float, float, float, float] | None,
    legend: list[tuple[str, str | None]],
) -> None:
    outlines, corners = table.outlines(), list(table.seen_mm())
    if bounds_mm is not None:
        corners += [np.array(bounds_mm[:2]), np.array(bounds_mm[2:])]
    boxes = [line.points_mm for line in seen.ink] + seen.travels
    corners += [points.min(axis=0) for points in boxes] + [points.max(axis=0) for points in boxes]
    (left, top), (right, bottom) = np.min(corners, axis=0), np.max(corners, axis=0)
    sheet = Sheet(
        float(left) - MARGIN_MM,
        float(top) - MARGIN_MM,
        float(right) + MARGIN_MM,
        float(bottom) + MARGIN_MM,
        outlines,
        (*((outline.label, outline.color) for outline in outlines), *legend),
    )
    try:
        write(path, seen, sheet)
    except OSError as error:
        raise BadInput(f"the picture {path} cannot be written: {error.strerror or error}; give another place") from error
