"""What a reader may be asked to do, and how much it may spend doing it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

Hidden = Literal["skip", "unpainted", "all"]
Fills = Literal["outline", "close", "skip"]
Text = Literal["outline", "single", "skip"]
LayerRule = Literal["auto", "inkscape", "groups", "one"]


@dataclass(frozen=True, slots=True)
class Budgets:
    """Counts at which reading stops with BadInput, made while the document is expanded, never after.

    `document_bytes` holds for the file and, again, for what a `.svgz` unpacks to.
    """

    document_bytes: int = 128_000_000
    elements: int = 2_000_000
    nesting: int = 256
    uses: int = 100_000
    markers: int = 40_000
    points: int = 20_000_000
    dashes: int = 300_000
    characters: int = 100_000
    selector_tests: int = 2_000_000

    def __post_init__(self) -> None:
        for name in self.__slots__:
            if getattr(self, name) < 1:
                raise ValueError(f"the budget {name} must be at least 1, not {getattr(self, name)}")
        if self.nesting > 400:
            raise ValueError(f"the nesting budget must be at most 400, not {self.nesting}: the reader recurses once per level")


@dataclass(frozen=True, slots=True)
class ReadOptions:
    """How to read.

    `tolerance_mm`  greatest distance between a curve and its polyline, page millimetres.
    `hidden`        skip: only what is painted; unpainted: also shapes with neither fill nor stroke; all: also display:none and
                    visibility:hidden.
    `fills`         outline: a filled shape is drawn as its outline; close: and the fill's implied closing line is drawn too;
                    skip: shapes that are only filled are left out.
    `text`          outline: glyph outlines by a font engine; single: single-line strokes; skip.
    `occlude`       opaque fills hide what lies under them.
    `crop`          cut at the page's edge.
    `px_per_in`     96 by the standard; 72 for files of old Illustrator.
    `layers`        auto: Inkscape's layers, else top-level groups, else one layer.
    """

    tolerance_mm: float = 0.01
    hidden: Hidden = "skip"
    fills: Fills = "outline"
    text: Text = "outline"
    occlude: bool = False
    crop: bool = False
    px_per_in: float = 96.0
    layers: LayerRule = "auto"
    budgets: Budgets = field(default_factory=Budgets)

    def __post_init__(self) -> None:
        if not 0.0001 <= self.tolerance_mm <= 10:
            raise ValueError(f"the curve tolerance must lie between 0.0001 mm and 10 mm, not {self.tolerance_mm} mm")
        if not 1 <= self.px_per_in <= 10_000:
            raise ValueError(f"pixels per inch must lie between 1 and 10000, not {self.px_per_in}")
