"""What an element inherits from where it stands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from plotter.svg.clip import Clip
from plotter.svg.lengths import Frame
from plotter.svg.matrix import Matrix
from plotter.svg.style import Style


@dataclass(frozen=True, slots=True)
class Context:
    """`matrix` maps user units to page millimetres; `level` counts nesting; `uses` are the elements being expanded here,
    and the `<use>` elements that refer to them."""

    matrix: Matrix
    style: Style
    frame: Frame
    layer: int | None = None
    clips: tuple[Clip, ...] = ()
    level: int = 0
    uses: tuple[Any, ...] = ()


@dataclass(frozen=True, slots=True)
class PendingText:
    """A text whose outlines are made after the walk, all texts at once; `order` is its place in the painting order."""

    element: Any
    context: Context
    order: int
    layer: int
