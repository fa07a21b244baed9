"""What lies under the pen, besides ink: the machine's travel, the drawing's page, and the well."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from planning.geometry.stroke import Points

if TYPE_CHECKING:
    from plotter.pipeline import Job

MACHINE_COLOR = "#d4d4d4"
PAGE_COLOR = "#8a8a8a"
WELL_COLOR = "#2a7f9e"
WELL_RADIUS_MM = 2.5


@dataclass(frozen=True, eq=False, slots=True)
class Outline:
    """A polyline (n, 2) in machine millimetres, `kind` being its class in an .svg, and what the legend says of it."""

    kind: str
    points_mm: Points
    color: str
    label: str


@dataclass(frozen=True, eq=False, slots=True)
class Table:
    """Machine millimetres: the travel from home to `travel_mm` (width, height), `page_mm` (2, 2) two opposite corners of the
    drawing's page, and `well_mm` (2,), where the pen is re-inked; None where there is none.
    """

    travel_mm: tuple[float, float]
    page_mm: Points | None = None
    well_mm: Points | None = None

    def outlines(self) -> list[Outline]:
        """In the order in which they are drawn, one over the other."""
        reach = _rectangle(np.array([(0.0, 0.0), self.travel_mm]))
        found = [Outline("machine", reach, MACHINE_COLOR, f"machine {_size(*self.travel_mm)}")]
        if self.page_mm is not None:
            size = np.ptp(self.page_mm, axis=0).tolist()
            found.append(Outline("page", _rectangle(self.page_mm), PAGE_COLOR, f"page {_size(*size)}"))
        if self.well_mm is not None:
            x, y = self.well_mm.tolist()
            found.append(Outline("well", self.well_mm + _TARGET * WELL_RADIUS_MM, WELL_COLOR, f"well at {x:g}, {y:g} mm"))
        return found

    def seen_mm(self) -> Points:
        """Points (n, 2) that a picture should show: all of the travel, and the page as far as it is not very much larger."""
        travel = np.array([(0.0, 0.0), self.travel_mm])
        if self.page_mm is None:
            return travel
        return np.vstack((travel, np.clip(self.page_mm, -travel[1] / 2, travel[1] * 3 / 2)))


def table_of(job: Job) -> Table:
    """The machine's table with the drawing's page on it."""
    drawing, machine, reinking = job.drawing, job.machine, job.settings.reinking()
    page_mm = job.arranged.placement.apply(np.array([[0.0, 0.0], [drawing.width_mm, drawing.height_mm]]))
    return Table((machine.width_mm, machine.height_mm), page_mm, None if reinking is None else reinking.well_mm)


def _rectangle(corners: Points) -> Points:
    (x0, y0), (x1, y1) = corners
    return np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)], dtype=np.float64)


def _target() -> Points:
    """A circle of radius 1 with a cross in it, in one line."""
    turn = np.linspace(0.0, 2 * np.pi, 49)
    return np.vstack((np.column_stack((np.cos(turn), np.sin(turn))), [(-1, 0), (0, 0), (0, -1), (0, 1)]))


_TARGET = _target()


def _size(width: float, height: float) -> str:
    return " x ".join(f"{value:.1f}".removesuffix(".0") for value in (width, height)) + " mm"
