"""Shapes as the walk meets them, flattened in batches so that memory stays bounded."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from plotter.errors import BadInput
from plotter.svg.clip import Clip
from plotter.svg.dashes import Dashes
from plotter.svg.flatten import FARTHEST_MM, BeyondNumbers, PointBudget, Polylines, flatten
from plotter.svg.matrix import Matrix
from plotter.svg.notes import Notes
from plotter.svg.options import ReadOptions
from plotter.svg.path_segments import resolve
from plotter.svg.path_tokens import ARITY, Commands, parse_paths, with_moves
from plotter.svg.style import Style

_BATCH_CHARACTERS = 2_000_000
_BATCH_NUMBERS = 200_000
# Dashes are cut by length, and a polyline is a little shorter than its curve; this much finer, it no longer shows.
_DASHED_FINER = 16.0


@dataclass(slots=True)
class Shape:
    """One drawn shape: all but its outline. `order` is its place in the painting order, -1 where that is its index;
    `color` overrides the style's."""

    element: Any
    style: Style
    layer: int
    matrix: Matrix
    clips: tuple[Clip, ...] = ()
    dashes: Dashes | None = None
    order: int = -1
    color: str | None = None


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
    characters: int = 0


class Collector:
    """Takes outlines in document order; `finish` gives polylines, whose `path` is an index into `shapes`."""

    def __init__(self, options: ReadOptions, notes: Notes, name_of: Callable[[Any], str], spent: Spent) -> None:
        self.shapes: list[Shape] = []
        self._done: list[Polylines] = []
        self._batch = _Batch()
        self._options = options
        self._notes = notes
        self._name_element = name_of
        self._spent = spent
        self._first = 0

    def add_path(self, shape: Shape, data: str) -> None:
        batch = self._batch
        batch.texts.append(data)
        batch.text_shapes.append(len(self.shapes))
        batch.characters += len(data)
        self.shapes.append(shape)
        if batch.characters > _BATCH_CHARACTERS:
            self._flush()

    def add_commands(self, shape: Shape, codes: bytes, numbers: list[float]) -> None:
        """Absolute commands, a move before each subpath."""
        batch = self._batch
        batch.codes.append(codes)
        batch.numbers.extend(numbers)
        batch.number_shapes.append(len(self.shapes))
        self.shapes.append(shape)
        if len(batch.numbers) > _BATCH_NUMBERS:
            self._flush()

    def reserve(self, shape: Shape) -> int:
        """A place in the painting order for a shape whose outline comes later, or never."""
        self.shapes.append(shape)
        return len(self.shapes) - 1

    def _name_of(self, index: int) -> str:
        return self._name_element(self.shapes[index].element)

    def finish(self) -> list[Polylines]:
        self._flush()
        return self._done

    def _flush(self) -> None:
        batch, self._batch = self._batch, _Batch()
        first, self._first = self._first, len(self.shapes)
        commands, damage = _commands(batch, first)
        for shape, what in damage.items():
            self._notes.add(
                "{count} [path is|paths are] damaged and drawn up to the damage ({names})",
                f"{self._name_of(first + shape)}: {what}",
            )
        self._check_finite(commands, first)
        with np.errstate(over="ignore", invalid="ignore"):
            segments = resolve(commands)
        shapes = self.shapes[first:]
        matrix = np.array([shape.matrix for shape in shapes]).reshape(-1, 6)
        tolerance = np.array([self._tolerance_mm(shape) for shape in shapes])
        budget = self._options.budgets.points
        try:
            with np.errstate(over="ignore", invalid="ignore"):
                made = flatten(segments, matrix, tolerance, budget - self._spent.points)
        except BeyondNumbers as error:
            name = self._name_of(first + error.args[0])
            raise BadInput(f"{name} is larger than {FARTHEST_MM / 1e6:g} km; correct its outline or its transform") from None
        except PointBudget as error:
            raise BadInput(
                f"the drawing has at least {self._spent.points + error.args[0]} points and the limit is {budget}; "
                "raise --max-points or --tolerance-curve"
            ) from None
        self._spent.points += len(made.points)
        made.path[:] += first
        self._done.append(made)

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
    """Both kinds of outlines as one list of commands in document order, `path` counted from `first`; and the damages."""
    parsed, damage = parse_paths(batch.texts) if batch.texts else (_NONE, {})
    text_shapes = np.array(batch.text_shapes, np.int64) - first
    damage = {int(text_shapes[i]): what for i, what in damage.items()}
    if not batch.codes:
        return _with(parsed, text_shapes[parsed.path] if len(text_shapes) else parsed.path), damage
    code = np.frombuffer(b"".join(batch.codes), np.uint8)
    count = np.array([len(codes) for codes in batch.codes])
    arity = ARITY[code]
    begin = np.cumsum(arity) - arity
    path = np.repeat(np.array(batch.number_shapes, np.int64) - first, count)
    given = with_moves(Commands(code, begin, path, np.array(batch.numbers)))
    if not batch.texts:
        return given, damage
    merged = np.concatenate((text_shapes[parsed.path], given.path))
    order = np.argsort(merged, kind="stable")
    return (
        Commands(
            np.concatenate((parsed.code, given.code))[order],
            np.concatenate((parsed.first, given.first + len(parsed.numbers)))[order],
            merged[order],
            np.concatenate((parsed.numbers, given.numbers)),
        ),
        damage,
    )


def _with(commands: Commands, path: Any) -> Commands:
    return Commands(commands.code, commands.first, path, commands.numbers)


_NONE = Commands(np.zeros(0, np.uint8), np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0))
