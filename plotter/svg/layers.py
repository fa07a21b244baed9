"""Which part of a document is which layer: Inkscape's layers, else top-level groups, else one.

Names follow AxiDraw's conventions: `%` first means documentation, never drawn; `!` first means a pause before the layer, or,
where nothing of it is drawn, before the next one that is.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from plotter.svg.document import INKSCAPE, SODIPODI
from plotter.svg.names import in_one_line
from plotter.svg.notes import Notes
from plotter.svg.options import LayerRule

_MODE = f"{{{INKSCAPE}}}groupmode"
_LABEL = f"{{{INKSCAPE}}}label"
_LOCKED = f"{{{SODIPODI}}}insensitive"
# Generated drawings may wrap every shape in a group of its own; that many layers are no layers.
_MOST_LAYERS = 200
OUTSIDE = "outside layers"


@dataclass(slots=True)
class FileLayer:
    """A layer of the file, drawn or not."""

    name: str
    locked: bool = False
    hidden: bool = False
    stray: bool = False

    @property
    def is_documentation(self) -> bool:
        return self.name.lstrip().startswith("%")

    @property
    def pause_before(self) -> bool:
        return self.name.lstrip().startswith("!")


class Layering:
    """Assigns shapes to layers while the document is walked. `layers` grows in document order."""

    def __init__(self, root: Any, rule: LayerRule, notes: Notes) -> None:
        self.layers: list[FileLayer] = []
        self._mode = self._choose(root, rule, notes)

    @staticmethod
    def _choose(root: Any, rule: LayerRule, notes: Notes) -> LayerRule:
        if rule == "one":
            return rule
        if rule in ("auto", "inkscape"):
            group = root.tag.replace("}svg", "}g") if "}" in root.tag else "g"
            if any(element.get(_MODE) == "layer" for element in root.iter(group)):
                return "inkscape"
            if rule == "inkscape":
                return "one"
        if next(root.iterchildren("{*}g"), None) is None:
            return "one"
        kinds = [_is_group(child) for child in root if isinstance(child.tag, str)]
        runs = sum(kinds) + sum(1 for i, kind in enumerate(kinds) if not kind and (i == 0 or kinds[i - 1]))
        if rule == "auto" and runs > _MOST_LAYERS:
            notes.add(
                f"the drawing has {sum(kinds)} top-level groups and no layers; they were taken as one layer "
                "(--layers groups keeps them apart)"
            )
            return "one"
        return "groups"

    def enter(self, element: Any, level: int, current: int | None, hidden: bool) -> int | None:
        """The layer of a group's content; `level` is 1 for the root's children, `current` the layer around it."""
        if current is not None:
            return current
        if (self._mode == "inkscape" and element.get(_MODE) == "layer") or (self._mode == "groups" and level == 1):
            given = (in_one_line(element.get(name) or "") for name in (_LABEL, "id"))
            name = next(filter(None, given), f"group {len(self.layers) + 1}")
            self.layers.append(FileLayer(name, element.get(_LOCKED) == "true", hidden))
            return len(self.layers) - 1
        return None

    def outside(self) -> int:
        """The layer of a shape that lies in none: one for each run of such shapes."""
        if not self.layers or not self.layers[-1].stray:
            name = OUTSIDE if self._mode in ("inkscape", "groups") else "drawing"
            self.layers.append(FileLayer(name, stray=True))
        return len(self.layers) - 1


def pauses(layers: Iterable[tuple[FileLayer, int]]) -> list[tuple[str, ...] | None]:
    """For each layer, given with its number of strokes, None or the empty layers for which there is a pause before it as well.

    A layer with strokes pauses for itself and for the empty ones before it; an empty one never, and what no strokes follow
    not at all. A hidden layer asks for nothing.
    """
    found: list[tuple[str, ...] | None] = []
    waiting: tuple[str, ...] = ()
    for layer, strokes in layers:
        found.append(waiting if strokes and (layer.pause_before or waiting) else None)
        if strokes:
            waiting = ()
        elif layer.pause_before and not layer.hidden:
            waiting = (*waiting, layer.name)
    return found


def _is_group(element: Any) -> bool:
    return bool(element.tag.rpartition("}")[2] == "g")
