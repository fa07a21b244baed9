"""From the drawing's page to the machine: turned, scaled and moved. Page millimetres in, machine millimetres out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from planning.geometry.stroke import Layer, Points, Stroke
from planning.geometry.strokes import Strokes, all_points_mm, box_mm
from plotter.errors import BadInput
from plotter.machines.profile import Machine
from plotter.settings import Settings
from plotter.svg.drawing import Drawing


@dataclass(frozen=True, eq=False, slots=True)
class Placement:
    """machine_mm = page_mm @ matrix.T + offset. A similarity: it turns by quarter turns, scales evenly and moves."""

    matrix: Points
    offset: Points

    def apply(self, points_mm: Points) -> Points:
        x, y = points_mm.T
        (a, b), (c, d) = self.matrix.tolist()
        # By column: numpy's product of many points with a small matrix takes ten times as long.
        return np.stack((a * x + b * y + self.offset[0], c * x + d * y + self.offset[1]), axis=1)

    def back(self, points_mm: Points) -> Points:
        """Machine millimetres (n, 2) back to page millimetres."""
        return np.asarray(np.linalg.solve(self.matrix, (points_mm - self.offset).T).T)

    def written(self) -> str:
        """Six numbers: the matrix by rows, then the offset in mm."""
        return " ".join(f"{value:.12g}" for value in (*self.matrix.ravel(), *self.offset))

    @classmethod
    def parse(cls, text: str) -> Placement:
        """What `written` wrote. Raises ValueError for anything else, or a matrix that cannot be inverted."""
        values = np.array([float(word) for word in text.split()])
        if values.shape != (6,) or not np.isfinite(values).all() or abs(np.linalg.det(values[:4].reshape(2, 2))) < 1e-12:
            raise ValueError(f"placement '{text}' is not the six numbers of an invertible map")
        return cls(values[:4].reshape(2, 2), values[4:])

    @property
    def is_identity(self) -> bool:
        return bool(np.array_equal(self.matrix, np.eye(2)) and not self.offset.any())


@dataclass(frozen=True, eq=False, slots=True)
class Arranged:
    """The drawing's layers in machine millimetres, their bounds (left, top, right, bottom), where the page lies there, and what

    was done without being asked.
    """

    layers: tuple[Layer, ...]
    bounds_mm: tuple[float, float, float, float]
    page_mm: tuple[float, float]
    placement: Placement
    notes: tuple[str, ...]


def arrange(drawing: Drawing, settings: Settings, machine: Machine) -> Arranged:
    """Place `drawing` on `machine` as the settings say. Raises BadInput when nothing is to be drawn."""
    bounds = bounds_mm(drawing.layers)
    if bounds is None:
        raise BadInput(
            "the drawing has no strokes to draw: give it visible lines, or see --hidden, --fills and --text", drawing.warnings
        )
    page = (drawing.width_mm, drawing.height_mm)
    turn, notes = _turn(page, bounds, settings, machine)
    matrix, offset, page = _quarter_turns(turn, page)
    matrix, offset = matrix * settings.scale, offset * settings.scale
    page = (page[0] * settings.scale, page[1] * settings.scale)
    if settings.fit:
        matrix, offset, page = _fitted(matrix, offset, page, bounds, settings, machine)
    placement = Placement(matrix, offset + np.array([settings.offset_x, settings.offset_y]))
    if placement.is_identity:
        return Arranged(drawing.layers, bounds, page, placement, notes)
    layers = tuple(replace(layer, strokes=_placed(layer.strokes, placement)) for layer in drawing.layers)
    placed = box_mm(placement.apply(np.array([bounds[:2], bounds[2:]])))  # by quarter turns a box stays a box
    return Arranged(layers, placed, page, placement, notes)


def bounds_mm(layers: tuple[Layer, ...]) -> tuple[float, float, float, float] | None:
    """(left, top, right, bottom) of all strokes, or None when there are none."""
    found = [points for points in (all_points_mm(layer.strokes) for layer in layers) if len(points)]
    if not found:
        return None
    left, top, right, bottom = zip(*map(box_mm, found), strict=True)
    return min(left), min(top), max(right), max(bottom)


def _placed(strokes: Sequence[Stroke], placement: Placement) -> Sequence[Stroke]:
    if isinstance(strokes, Strokes):
        return strokes.moved_to(placement.apply(strokes.points_mm))
    return tuple(Stroke(placement.apply(stroke.points_mm), stroke.corners, stroke.color) for stroke in strokes)


def _turn(
    page: tuple[float, float], bounds: tuple[float, float, float, float], settings: Settings, machine: Machine
) -> tuple[int, tuple[str, ...]]:
    if settings.rotate != "auto":
        return int(settings.rotate), ()
    width, height = max(page[0], bounds[2]) * settings.scale, max(page[1], bounds[3]) * settings.scale
    fits = width <= machine.width_mm and height <= machine.height_mm
    fits_turned = height <= machine.width_mm and width <= machine.height_mm
    portrait_on_landscape = (page[1] > page[0]) != (machine.height_mm > machine.width_mm) and page[0] != page[1]
    if (fits_turned and not fits) or (not fits and settings.fit and portrait_on_landscape):
        note = f"the page ({page[0]:.0f} x {page[1]:.0f} mm) is turned by 90 degrees to fit {machine.name}; --rotate 0 keeps it"
        return 90, (note,)
    return 0, ()


def _quarter_turns(degrees: int, page: tuple[float, float]) -> tuple[Points, Points, tuple[float, float]]:
    """Clockwise as seen on the page (y down), the page's corner staying at the origin."""
    width, height = page
    if degrees == 90:  # (x, y) -> (height - y, x)
        return np.array([[0.0, -1.0], [1.0, 0.0]]), np.array([height, 0.0]), (height, width)
    if degrees == 180:
        return np.array([[-1.0, 0.0], [0.0, -1.0]]), np.array([width, height]), page
    if degrees == 270:  # (x, y) -> (y, width - x)
        return np.array([[0.0, 1.0], [-1.0, 0.0]]), np.array([0.0, width]), (height, width)
    return np.eye(2), np.zeros(2), page


def _fitted(
    matrix: Points,
    offset: Points,
    page: tuple[float, float],
    bounds: tuple[float, float, float, float],
    settings: Settings,
    machine: Machine,
) -> tuple[Points, Points, tuple[float, float]]:
    """Scaled and centred so that the strokes' bounds fill the machine's travel less the margin on every side."""
    room = np.array([machine.width_mm, machine.height_mm]) - 2 * settings.margin
    if (room <= 0).any():
        raise BadInput(f"--margin {settings.margin:g}mm leaves no room on {machine.name}: give a smaller one")
    corners = np.array([bounds[:2], bounds[2:]]) @ matrix.T + offset
    low, high = corners.min(axis=0), corners.max(axis=0)
    extent = np.maximum(high - low, 1e-9)
    factor = float((room / extent).min())
    centre = np.array([machine.width_mm, machine.height_mm]) / 2
    return matrix * factor, (offset - (low + high) / 2) * factor + centre, (page[0] * factor, page[1] * factor)
