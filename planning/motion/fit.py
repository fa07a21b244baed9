"""What the tube finds for a section: whole ticks and the states at the knots between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from planning.motion.path import Array, Ints


@dataclass(frozen=True, eq=False, slots=True)
class Fit:
    """A motion found for a section: whole ticks of each piece (n,), states at the n + 1 knots, and how far along the path

    each knot is.
    """

    ticks: Ints
    position_mm: Array
    velocity_mm_s: Array
    acceleration_mm_s2: Array
    along_mm: Array

    def between(self, low: int, high: int) -> Fit:
        """The part from knot `low` to knot `high`."""
        knots = slice(low, high + 1)
        return Fit(self.ticks[low:high], self.position_mm[knots], self.velocity_mm_s[knots], self.acceleration_mm_s2[knots],
                   self.along_mm[knots])  # fmt: skip

    def moved(self, by_mm: float) -> Fit:
        """The same with `by_mm` added to how far along it is."""
        return replace(self, along_mm=self.along_mm + by_mm)


def joined(parts: Sequence[Fit]) -> Fit:
    """Fits that follow each other, as one."""
    return Fit(
        np.concatenate([p.ticks for p in parts]),
        np.concatenate([p.position_mm[:-1] for p in parts] + [parts[-1].position_mm[-1:]]),
        np.concatenate([p.velocity_mm_s[:-1] for p in parts] + [parts[-1].velocity_mm_s[-1:]]),
        np.concatenate([p.acceleration_mm_s2[:-1] for p in parts] + [parts[-1].acceleration_mm_s2[-1:]]),
        np.concatenate([p.along_mm[:-1] for p in parts] + [parts[-1].along_mm[-1:]]),
    )
