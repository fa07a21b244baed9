"""Shapes as the walk meets them, flattened in batches, so that what comes in between takes little memory."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from output.errand import Errand
from plotter.errors import BadInput
from plotter.svg.batch import BadOutline, Batch, Made, made
from plotter.svg.clip import Clip
from plotter.svg.dashes import Dashes
from plotter.svg.flatten import PointBudget, Polylines
from plotter.svg.matrix import Matrix
from plotter.svg.notes import Notes
from plotter.svg.options import ReadOptions
from plotter.svg.run import Run
from plotter.svg.shapes import Ellipse, Outline
from plotter.svg.style import Style

_BATCH_CHARACTERS = 500_000
_BATCH_NUMBERS = 200_000
# So many batches are made beside the walk, numpy letting other threads run while it is at work; and no more points in each, so
# that what is made before the budget is found to be exceeded stays small.
_BESIDE, _BESIDE_POINTS = 2, 2_000_000
# Dashes are cut by length, and a polyline is a little shorter than its curve; this much finer, it no longer shows.
_DASHED_FINER = 16.0


@dataclass(slots=True)
class Shape:
    """What there is to a drawn shape besides its outline; many shapes may have it in common. `order` is its place in the
    painting order, -1 where that is its index; `color` overrides the style's."""

    style: Style
    layer: int
    matrix: Matrix
    clips: tuple[Clip, ...] = ()
    dashes: Dashes | None = None
    order: int = -1
    color: str | None = None


def different_shapes(shapes: list[Shape]) -> tuple[list[Shape], NDArray[np.int64]]:
    """Each of `shapes` once, and which of these each one is: most drawings have few, each very often."""
    _, first, which = np.unique(np.fromiter(map(id, shapes), np.int64, len(shapes)), return_index=True, return_inverse=True)
    return [shapes[i] for i in first.tolist()], which.ravel()


@dataclass(slots=True)
class Spent:
    """What one reading has made so far, shared by all its collectors."""

    points: int = 0


class Collector:
    """Takes outlines in document order; `finish` gives polylines, whose `path` is an index into `shapes`."""

    def __init__(self, options: ReadOptions, notes: Notes, name_of: Callable[[Any], str], spent: Spent) -> None:
        self.shapes: list[Shape] = []
        # What each shape is named after: its element, or the run it is in and the number of the shape that the run begins with.
        self._elements: list[Any | tuple[Run, int]] = []
        self._done: list[Polylines] = []
        self._batch = Batch()
        self._beside: deque[tuple[Errand[Made], Callable[[int], Made]]] = deque()
        self._options = options
        self._notes = notes
        self._name_element = name_of
        self._spent = spent

    def add(self, element: Any, shape: Shape, outline: str | Outline | Ellipse) -> None:
        """One outline, as `shapes.outline` gives it; `element` is what messages name it after."""
        if isinstance(outline, str):
            self.add_path(element, shape, outline)
        elif len(outline) == 2:
            self.add_commands(element, shape, *outline)
        else:
            self.add_ellipse(element, shape, outline)

    def add_path(self, element: Any, shape: Shape, data: str) -> None:
        batch = self._batch
        batch.texts.append(data)
        batch.text_shapes.append(len(self.shapes))
        batch.characters += len(data)
        self.shapes.append(shape)
        self._elements.append(element)
        if batch.characters > _BATCH_CHARACTERS:
            self._flush()

    def add_commands(self, element: Any, shape: Shape, codes: bytes, numbers: Sequence[float]) -> None:
        """Absolute commands, a move before each subpath."""
        batch = self._batch
        batch.codes.append(codes)
        batch.numbers.extend(numbers)
        batch.number_shapes.append(len(self.shapes))
        self.shapes.append(shape)
        self._elements.append(element)
        if len(batch.numbers) > _BATCH_NUMBERS:
            self._flush()

    def add_ellipse(self, element: Any, shape: Shape, ellipse: Ellipse) -> None:
        """`ellipse` is its centre, x and y, and its two radii, both positive."""
        batch = self._batch
        batch.ellipses.extend(ellipse)
        batch.ellipse_shapes.append(len(self.shapes))
        self.shapes.append(shape)
        self._elements.append(element)
        if len(batch.ellipses) > _BATCH_NUMBERS // 4:
            self._flush()

    def add_run(self, run: Run, shape: Shape, texts: list[str]) -> None:
        """The path data of all elements of a run; of some it may be empty."""
        place = (run, len(self.shapes))
        for text in texts:
            self.add_path(place, shape, text)

    def reserve(self, element: Any, shape: Shape) -> int:
        """A place in the painting order for a shape whose outline comes later, or never."""
        self.shapes.append(shape)
        self._elements.append(element)
        return len(self.shapes) - 1

    def _name_of(self, index: int) -> str:
        element = self._elements[index]
        if isinstance(element, tuple):
            run, first = element
            element = run.element(index - first)
        return self._name_element(element)

    def finish(self) -> list[Polylines]:
        """Raises BadInput for an outline that cannot be drawn, and for more points than the budget."""
        self._keep_beside(0)
        self._keep_alone(self._next())
        return self._done

    def _flush(self) -> None:
        of_numbers = self._batch.characters < _BATCH_CHARACTERS
        make = self._next()
        if of_numbers:  # which a thread would make with the interpreter's lock held
            self._keep_beside(0)
            self._keep_alone(make)
            return
        self._beside.append((Errand(partial(make, _BESIDE_POINTS)), make))
        self._keep_beside(_BESIDE)

    def _next(self) -> Callable[[int], Made]:
        """What makes the batch that was gathered, given how many points it may have; another one begins."""
        batch, self._batch = self._batch, Batch(len(self.shapes))
        different, which = different_shapes(self.shapes[batch.first :])
        matrix = np.array([shape.matrix for shape in different]).reshape(-1, 6)[which]
        tolerance_mm = np.array([self._tolerance_mm(shape) for shape in different])[which]
        return partial(made, batch, matrix, tolerance_mm)

    def _keep_beside(self, left: int) -> None:
        """Keeps what was made beside the walk, but for the `left` batches that were begun last."""
        while len(self._beside) > left:
            beside, make = self._beside.popleft()
            try:
                self._keep(beside.result)
            except PointBudget:
                self._keep_alone(make)

    def _keep_alone(self, make: Callable[[int], Made]) -> None:
        left = self._options.budgets.points - self._spent.points
        try:
            self._keep(partial(make, left))
        except PointBudget as error:
            raise BadInput(
                f"the drawing has at least {self._spent.points + error.args[0]} points and the limit is "
                f"{self._options.budgets.points}; raise --max-points or --tolerance-curve"
            ) from None

    def _keep(self, result: Callable[[], Made]) -> None:
        try:
            found = result()
        except BadOutline as error:
            raise BadInput(f"{self._name_of(error.shape)} {error}") from None
        if self._spent.points + found.points > self._options.budgets.points:
            raise PointBudget(found.points)
        for shape, what in found.damage.items():
            self._notes.add(
                "{count} [path is|paths are] damaged and drawn up to the damage ({names})", f"{self._name_of(shape)}: {what}"
            )
        self._spent.points += found.points
        self._done.extend(found.polylines)

    def _tolerance_mm(self, shape: Shape) -> float:
        return self._options.tolerance_mm / (_DASHED_FINER if shape.dashes is not None else 1.0)
