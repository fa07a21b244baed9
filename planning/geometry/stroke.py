"""A stroke: what the pen draws between one lowering and the next lift."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False, slots=True)
class Stroke:
    """One pen-down polyline, in millimetres, x right and y down.

    `points_mm` is (n, 2), n >= 1; one point is a dot. A closed stroke repeats its first point as its last.
    `corners` is (n,) and True where the drawing itself has a corner (its tangent jumps) or an end; False where the vertex was
    put there by flattening a smooth curve. None when nothing is known: the planner then judges by the angles alone.
    `color` is `#rrggbb` or None.

    Raises ValueError for a shape that is not (n, 2) or for a coordinate that is not finite.
    """

    points_mm: Points
    corners: Mask | None = None
    color: str | None = None

    def __post_init__(self) -> None:
        shape = self.points_mm.shape
        if len(shape) != 2 or shape[1] != 2 or shape[0] < 1:
            raise ValueError(f"a stroke's points must be (n, 2) with n >= 1, not {shape}")
        if not np.isfinite(self.points_mm).all():
            raise ValueError("a stroke's points must be finite")
        if self.corners is not None and self.corners.shape != (shape[0],):
            raise ValueError(f"corner marks {self.corners.shape} do not match {shape[0]} points")

    @property
    def is_dot(self) -> bool:
        return bool((self.points_mm == self.points_mm[0]).all())

    @property
    def is_closed(self) -> bool:
        return len(self.points_mm) > 2 and bool((self.points_mm[0] == self.points_mm[-1]).all())

    @property
    def length_mm(self) -> float:
        return float(np.hypot(*np.diff(self.points_mm, axis=0).T).sum())

    def reversed(self) -> Stroke:
        corners = None if self.corners is None else self.corners[::-1]
        return Stroke(self.points_mm[::-1], corners, self.color)


@dataclass(frozen=True, slots=True)
class Layer:
    """Strokes that are drawn together, in the order given: a tuple, or `Strokes`, which holds very many of them in arrays.

    `number` is the layer's own number in the file's order, from 1. `pause_for` names what else the pause before it is for.
    """

    number: int
    name: str
    strokes: Sequence[Stroke]
    color: str | None = None
    pause_before: bool = False
    pause_for: tuple[str, ...] = ()
