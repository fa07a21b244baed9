"""What a picture covers and how it is inked, whether it is made of pixels or of lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from plotter.preview.table import Outline

TRAVEL_COLOR = "#dd8aa3"
TRAVEL_WIDTH_MM = 0.12
INK_WIDTH_MM = 0.3
OUTLINE_WIDTH_MM = 0.2
LEGEND_HEIGHT_MM = 8.0
TEXT_HEIGHT_MM = 3.2
TEXT_COLOR = "#555555"


@dataclass(frozen=True, slots=True)
class Sheet:
    """Machine millimetres from `left, top` to `right, bottom`, with what lies on the table under the ink and a legend below.

    `legend` is texts, each with the colour of the swatch before it, or None.
    """

    left: float
    top: float
    right: float
    bottom: float
    outlines: Sequence[Outline]
    legend: tuple[tuple[str, str | None], ...]

    @property
    def width_mm(self) -> float:
        return self.right - self.left

    @property
    def height_mm(self) -> float:
        """With the legend."""
        return self.bottom - self.top + LEGEND_HEIGHT_MM

    @property
    def text_height_mm(self) -> float:
        """Of the legend; smaller where it would not fit, a letter being about 0.55 of its height wide."""
        letters = sum(len(text) + 3 for text, _ in self.legend)
        return min(TEXT_HEIGHT_MM, (self.width_mm - 10.0) / (0.55 * max(letters, 1)))
