"""Small drawings for the reader's tests: user units are millimetres on a 100 mm page."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from plotter.svg.drawing import Drawing
from plotter.svg.options import ReadOptions
from plotter.svg.read import read_drawing

HEAD = (
    '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" '
    'xmlns:inkscape="http://www.inkscape.org/namespaces/inkscape" '
    'xmlns:sodipodi="http://sodipodi.sourceforge.net/DTD/sodipodi-0.dtd" '
    'width="100mm" height="100mm" viewBox="0 0 100 100" stroke="black" fill="none">'
)


def page(body: str, **options: Any) -> Drawing:
    """The drawing of `body` on the page."""
    return read_drawing(f"{HEAD}{body}</svg>".encode(), ReadOptions(**options))


def polylines(drawing: Drawing) -> list[NDArray[np.float64]]:
    return [stroke.points_mm for layer in drawing.layers for stroke in layer.strokes]


def rounded(drawing: Drawing, digits: int = 6) -> list[list[list[float]]]:
    """Polylines as lists, -0.0 made 0.0."""
    return [(np.round(points, digits) + 0.0).tolist() for points in polylines(drawing)]


def marks(drawing: Drawing) -> list[list[bool]]:
    return [stroke.corners.tolist() for layer in drawing.layers for stroke in layer.strokes if stroke.corners is not None]
