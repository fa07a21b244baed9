"""What was read from a file, before arranging, ordering and planning."""

from __future__ import annotations

from dataclasses import dataclass

from planning.geometry.stroke import Layer


@dataclass(frozen=True, slots=True)
class Drawing:
    """A page and its layers in document order. Page millimetres: origin top left, x right, y down.

    `warnings` says, once each and with counts, what was left out and which flag changes that.
    """

    width_mm: float
    height_mm: float
    layers: tuple[Layer, ...]
    warnings: tuple[str, ...] = ()

    @property
    def stroke_count(self) -> int:
        return sum(len(layer.strokes) for layer in self.layers)
