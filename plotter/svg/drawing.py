"""What was read from a file, before arranging, ordering and planning."""

from __future__ import annotations

from dataclasses import dataclass

from planning.geometry.stroke import Layer


@dataclass(frozen=True, slots=True)
class LayerFacts:
    """A layer as the file has it, drawn or not: its number in the file's order, from 1, its name, and its states."""

    number: int
    name: str
    strokes: int
    hidden: bool = False
    locked: bool = False
    documentation: bool = False
    pause_before: bool = False


@dataclass(frozen=True, slots=True)
class Drawing:
    """A page and its layers in document order. Page millimetres: origin top left, x right, y down.

    `warnings` says, once each and with counts, what was left out and which flag changes that.
    `layers` has those layers that hold strokes; `file_layers` all that the file has, also hidden, empty and documentation ones.
    """

    width_mm: float
    height_mm: float
    layers: tuple[Layer, ...]
    warnings: tuple[str, ...] = ()
    file_layers: tuple[LayerFacts, ...] = ()

    @property
    def stroke_count(self) -> int:
        return sum(len(layer.strokes) for layer in self.layers)
