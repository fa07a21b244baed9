"""A batch of outlines to polylines.

Nothing here knows elements, notes or other batches, so that one can be made beside the walk that gathers the next.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from plotter.svg.ellipses import flatten_ellipses, point_counts, usual
from plotter.svg.flatten import FARTHEST_MM, BeyondNumbers, PointBudget, Polylines, flatten
from plotter.svg.path_segments import Floats, resolve
from plotter.svg.path_tokens import ARITY, Commands, parse_paths, with_moves
from plotter.svg.shapes import ellipses_as_path


@dataclass(slots=True)
class Batch:
    """Outlines of the shapes from number `first` on, in lists by their kind; each has the numbers of its shapes beside it.

    `texts` are path data, `codes` commands with their `numbers` one after the other, `ellipses` four numbers each.
    """

    first: int = 0
    texts: list[str] = field(default_factory=list)
    text_shapes: list[int] = field(default_factory=list)
    codes: list[bytes] = field(default_factory=list)
    numbers: list[float] = field(default_factory=list)
    number_shapes: list[int] = field(default_factory=list)
    ellipses: list[float] = field(default_factory=list)
    ellipse_shapes: list[int] = field(default_factory=list)
    characters: int = 0


@dataclass(frozen=True, eq=False, slots=True)
class Made:
    """A batch's polylines, whose `path` is the number of a shape, and what was damaged, by the number of the shape."""

    polylines: list[Polylines]
    damage: dict[int, str]

    @property
    def points(self) -> int:
        return sum(len(polylines.points) for polylines in self.polylines)


class BadOutline(Exception):
    """An outline that cannot be drawn: `shape` is its shape's number."""

    def __init__(self, shape: int, what: str) -> None:
        super().__init__(what)
        self.shape = shape


def made(batch: Batch, matrix: Floats, tolerance_mm: Floats, point_budget: int) -> Made:
    """The polylines of a batch; `matrix` (n, 6) and `tolerance_mm` (n,) are those of its shapes.

    Raises BadOutline, and PointBudget for more than `point_budget` points, before they are made.
    """
    found = []
    if batch.ellipses:
        round_ones, batch = _ellipses(batch, matrix, tolerance_mm, point_budget)
        found.append(round_ones)
        point_budget -= len(round_ones.points)
    commands, damage = _commands(batch)
    _check_finite(commands, batch.first)
    with np.errstate(over="ignore", invalid="ignore"):
        segments = resolve(commands)
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            found.append(flatten(segments, matrix, tolerance_mm, point_budget))
    except BeyondNumbers as error:
        what = f"is larger than {FARTHEST_MM / 1e6:g} km; correct its outline or its transform"
        raise BadOutline(batch.first + error.args[0], what) from None
    for polylines in found:
        polylines.path[:] += batch.first
    return Made(found, {batch.first + shape: what for shape, what in damage.items()})


def _ellipses(batch: Batch, matrix: Floats, tolerance_mm: Floats, point_budget: int) -> tuple[Polylines, Batch]:
    """The batch's ellipses, and the batch without them but for those of a size that needs to be judged."""
    ellipses, shapes = np.array(batch.ellipses).reshape(-1, 4), np.array(batch.ellipse_shapes, dtype=np.int64)
    own = shapes - batch.first
    well = usual(ellipses, matrix[own])
    rest = replace(batch, ellipses=ellipses[~well].ravel().tolist(), ellipse_shapes=shapes[~well].tolist())
    ellipses, own = ellipses[well], own[well]
    points = int(point_counts(ellipses, matrix[own], tolerance_mm[own]).sum())
    if points > point_budget:
        raise PointBudget(points)
    polylines = flatten_ellipses(ellipses, matrix[own], tolerance_mm[own])
    polylines.path[:] = own
    return polylines, rest


def _check_finite(commands: Commands, first: int) -> None:
    if np.isfinite(commands.numbers).all():
        return
    at = int(np.flatnonzero(~np.isfinite(commands.numbers))[0])
    order = np.argsort(commands.first, kind="stable")
    owner = order[np.searchsorted(commands.first[order], at, "right") - 1]
    raise BadOutline(first + int(commands.path[owner]), "has a number too large to be finite; correct its outline")


def _commands(batch: Batch) -> tuple[Commands, dict[int, str]]:
    """All outlines as one list of commands in document order, `path` counted from the batch's first; and the damages."""
    first = batch.first
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
