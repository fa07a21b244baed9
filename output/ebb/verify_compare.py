"""How far two sets of strokes are from each other: every point of each to the other's nearest point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from planning.motion.late import tree_of

Array = NDArray[np.float64]

SAMPLE_MM = 0.02
# Beyond this many samples a side the spacing grows: memory stays bounded, and so does the error it adds.
_MOST_SAMPLES = 4_000_000


@dataclass(frozen=True, slots=True)
class Deviation:
    """Distances in mm: mean, 99th percentile and greatest."""

    mean_mm: float
    p99_mm: float
    max_mm: float


@dataclass(frozen=True, slots=True)
class Comparison:
    """`drawn` is what is drawn to the nearest of what was wanted (ink too much); `wanted` the other way (ink missing).

    Sampled every `sample_mm`; a distance is at most half of that too long.
    """

    drawn: Deviation
    wanted: Deviation
    sample_mm: float

    def as_dict(self) -> dict[str, object]:
        return asdict(self)


def compare(drawn: Sequence[Array], wanted: Sequence[Array], sample_mm: float = SAMPLE_MM) -> Comparison:
    """Deviation both ways between polylines (n, 2), one-point ones included, in the same millimetres.

    Raises ValueError when either side has no point.
    """
    total = max(_length(drawn), _length(wanted))
    spacing = max(sample_mm, total / _MOST_SAMPLES)
    one, two = sampled(drawn, spacing), sampled(wanted, spacing)
    if not len(one) or not len(two):
        raise ValueError("there is nothing to compare: one of the two has no strokes")
    return Comparison(_deviation(one, two), _deviation(two, one), spacing)


def sampled(strokes: Sequence[Array], spacing_mm: float) -> Array:
    """Points (m, 2) along the polylines, all vertices and at most `spacing_mm` apart."""
    parts = [np.zeros((0, 2))]
    for stroke in strokes:
        points = np.asarray(stroke, dtype=np.float64)
        lengths = np.hypot(*np.diff(points, axis=0).T) if len(points) > 1 else np.zeros(0)
        count = np.maximum(np.ceil(lengths / spacing_mm), 1).astype(np.int64)
        owner = np.repeat(np.arange(len(count)), count)
        share = (np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)) / count[owner]
        parts.append(points[:-1][owner] + share[:, None] * np.diff(points, axis=0)[owner])
        parts.append(points[-1:])
    return np.vstack(parts)


def _length(strokes: Sequence[Array]) -> float:
    return float(sum(np.hypot(*np.diff(stroke, axis=0).T).sum() for stroke in strokes if len(stroke) > 1))


def _deviation(points: Array, others: Array) -> Deviation:
    distance = np.asarray(tree_of(others).query(points)[0])
    return Deviation(float(distance.mean()), float(np.percentile(distance, 99)), float(distance.max()))
