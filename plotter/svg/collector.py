"""Shapes as the walk meets them, flattened in batches so that memory stays bounded."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plotter.errors import BadInput
from plotter.svg.clip import Clip
from plotter.svg.dashes import Dashes
from plotter.svg.ellipses import flatten_ellipses, point_counts, usual
from plotter.svg.flatten import FARTHEST_MM, BeyondNumbers, PointBudget, Polylines, flatten
from plotter.svg.matrix import Matrix
from plotter.svg.notes import Notes
from plotter.svg.options import ReadOptions
from plotter.svg.path_segments import Floats, resolve
from plotter.svg.path_tokens import ARITY, Commands, parse_paths, with_moves
from plotter.svg.shapes import Ellipse, Outline, ellipses_as_path
from plotter.svg.style import Style

_BATCH_CHARACTERS = 2_000_000
_BATCH_NUMBERS = 200_000
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


@dataclass(slots=True)
class _Batch:
    texts: list[str] = field(default_factory=list)
    text_shapes: list[int] = field(default_factory=list)
    codes: list[bytes] = field(default_factory=list)
    numbers: list[float] = field(default_factory=list)
    number_shapes: list[int] = field(default_factory=list)
    ellipses: list[float] = field(default_factory=list)
    ellipse_shapes: list[int] = field(default_factory=list)
    characters: int = 0


class Collector:
    """Takes outlines in document order; `finish` gives polylines, whose `path` is an index into `shapes`."""

    def __init__(self, options: ReadOptions, notes: Notes, name_of: Callable[[Any], str], spent: Spent) -> None:
        self.shapes: list[Shape] = []
        self._elements: list[Any] = []  # what each shape is named after
        self._done: list[Polylines] = []
        self._batch = _Batch()
        self._options = options
        self._notes = notes
        self._name_element = name_of
        self._spent = spent
        self._first = 0

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

    def reserve(self, element: Any, shape: Shape) -> int:
        """A place in the painting order for a shape whose outline comes later, or never."""
        self.shapes.append(shape)
        self._elements.append(element)
        return len(self.shapes) - 1

    def _name_of(self, index: int) -> str:
        return self._name_element(self._elements[index])

    def finish(self) -> list[Polylines]:
        self._flush()
        return self._done

    def _flush(self) -> None:
        batch, self._batch = self._batch, _Batch()
        first, self._first = self._first, len(self.shapes)
        different, which = different_shapes(self.shapes[first:])
        matrix = np.array([shape.matrix for shape in different]).reshape(-1, 6)[which]
        tolerance = np.array([self._tolerance_mm(shape) for shape in different])[which]
        self._flush_ellipses(batch, first, matrix, tolerance)
        commands, damage = _commands(batch, first)
        for shape, what in damage.items():
            self._notes.add(
                "{count} [path is|paths are] damaged and drawn up to the damage ({names})",
                f"{self._name_of(first + shape)}: {what}",
            )
        self._check_finite(commands, first)
        with np.errstate(over="ignore", invalid="ignore"):
            segments = resolve(commands)
        try:
            with np.errstate(over="ignore", invalid="ignore"):
                made = flatten(segments, matrix, tolerance, self._options.budgets.points - self._spent.points)
        except BeyondNumbers as error:
            name = self._name_of(first + error.args[0])
            raise BadInput(f"{name} is larger than {FARTHEST_MM / 1e6:g} km; correct its outline or its transform") from None
        except PointBudget as error:
            raise self._too_many(error.args[0]) from None
        self._keep(made, first)

    def _flush_ellipses(self, batch: _Batch, first: int, matrix: Floats, tolerance_mm: Floats) -> None:
        """The batch's ellipses, but for those of a size that needs to be judged, which stay in the batch."""
        if not batch.ellipses:
            return
        ellipses, shapes = np.array(batch.ellipses).reshape(-1, 4), np.array(batch.ellipse_shapes, dtype=np.int64)
        own = shapes - first
        well = usual(ellipses, matrix[own])
        batch.ellipses, batch.ellipse_shapes = ellipses[~well].ravel().tolist(), shapes[~well].tolist()
        ellipses, own = ellipses[well], own[well]
        points = int(point_counts(ellipses, matrix[own], tolerance_mm[own]).sum())
        if points > self._options.budgets.points - self._spent.points:
            raise self._too_many(points)
        made = flatten_ellipses(ellipses, matrix[own], tolerance_mm[own])
        made.path[:] = own
        self._keep(made, first)

    def _keep(self, made: Polylines, first: int) -> None:
        self._spent.points += len(made.points)
        made.path[:] += first
        self._done.append(made)

    def _too_many(self, points: int) -> BadInput:
        return BadInput(
            f"the drawing has at least {self._spent.points + points} points and the limit is {self._options.budgets.points}; "
            "raise --max-points or --tolerance-curve"
        )

    def _tolerance_mm(self, shape: Shape) -> float:
        return self._options.tolerance_mm / (_DASHED_FINER if shape.dashes is not None else 1.0)

    def _check_finite(self, commands: Commands, first: int) -> None:
        if np.isfinite(commands.numbers).all():
            return
        at = int(np.flatnonzero(~np.isfinite(commands.numbers))[0])
        order = np.argsort(commands.first, kind="stable")
        owner = order[np.searchsorted(commands.first[order], at, "right") - 1]
        raise BadInput(
            f"{self._name_of(first + int(commands.path[owner]))} has a number too large to be finite; correct its outline"
        )


def _commands(batch: _Batch, first: int) -> tuple[Commands, dict[int, str]]:
    """All kinds of outlines as one list of commands in document order, `path` counted from `first`; and the damages."""
    parsed, damage = parse_paths(batch.texts) if batch.texts else (_NONE, {})
    text_shapes = np.array(batch.text_shapes, np.int64) - first
    damage = {int(text_shapes[i]): what for i, what in damage.items()}
    parts = [Commands(parsed.code, parsed.first, text_shapes[parsed.path], parsed.numbers)] if batch.texts else []
    if batch.codes:
        code = np.frombuffer(b"".join(batch.codes), np.uint8)
        count = np.array([len(codes) for codes in batch.codes])
        path = np.repeat(np.array(batch.number_shapes, np.int64) - first, count)
        parts.append(with_moves(_one_after_the_other(code, path, np.array(batch.numbers))))
    if batch.ellipses:
        codes, numbers = ellipses_as_path(np.array(batch.ellipses).reshape(-1, 4))
        path = np.repeat(np.array(batch.ellipse_shapes, np.int64) - first, len(codes))
        parts.append(_one_after_the_other(np.tile(np.frombuffer(codes, np.uint8), len(numbers)), path, numbers.ravel()))
    if len(parts) < 2:
        return parts[0] if parts else _NONE, damage
    merged = np.concatenate([part.path for part in parts])
    order = np.argsort(merged, kind="stable")
    before = np.cumsum([0, *(len(part.numbers) for part in parts)]).tolist()
    return (
        Commands(
            np.concatenate([part.code for part in parts])[order],
            np.concatenate([part.first + start for part, start in zip(parts, before, strict=False)])[order],
            merged[order],
            np.concatenate([part.numbers for part in parts]),
        ),
        damage,
    )


def _one_after_the_other(code: NDArray[np.uint8], path: NDArray[np.int64], numbers: NDArray[np.float64]) -> Commands:
    arity = ARITY[code]
    return Commands(code, np.cumsum(arity) - arity, path, numbers)


_NONE = Commands(np.zeros(0, np.uint8), np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0))
