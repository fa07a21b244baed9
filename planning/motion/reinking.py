"""When the pen is re-inked on the way: after so much ink or so much time, by the operator or by a dip in a well.

    ... draw, lift | travel to the well, lower, dwell, lift | travel, lower, draw ...

It is done between strokes only. A stroke that would go beyond `every_mm` is begun freshly inked, so that no more than that is
drawn between two re-inkings as long as no stroke is longer (`planning.ordering.cutting`); `every_s` counts plan time, and what
is due during a stroke is done after it. With a well the plan begins with a visit, and so does what follows a pause: the pen may
have dried. Without one, a pause for another reason is taken for a chance to re-ink.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planning.errors import OutsideMachine
from planning.motion.path import Array
from planning.motion.travel import Bounds


@dataclass(frozen=True, eq=False, slots=True)
class Reinking:
    """`every_mm` of ink or `every_s` of plan time (infinite: not counted); `well_mm` (2,) in machine millimetres, where the pen

    is held down for `dip_s`, or None for a pause of the operator's.
    Raises ValueError for an amount that is not positive, or a dwell that is negative or not finite.
    """

    every_mm: float = np.inf
    every_s: float = np.inf
    well_mm: Array | None = None
    dip_s: float = 0.0

    def __post_init__(self) -> None:
        for name in ("every_mm", "every_s"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be positive, not {getattr(self, name)}")
        if not (np.isfinite(self.dip_s) and self.dip_s >= 0):
            raise ValueError(f"dip_s must be finite and not negative, not {self.dip_s}")
        if self.well_mm is not None and not (self.well_mm.shape == (2,) and np.isfinite(self.well_mm).all()):
            raise ValueError(f"well_mm must be two finite numbers, not {self.well_mm}")


def check_well(reinking: Reinking | None, bounds_mm: Bounds) -> None:
    """Raise OutsideMachine for a well that the machine cannot reach."""
    if reinking is None or reinking.well_mm is None:
        return
    x, y = reinking.well_mm.tolist()
    (x0, y0), (x1, y1) = bounds_mm
    if not (x0 <= x <= x1 and y0 <= y <= y1):
        raise OutsideMachine(
            f"the well at {x:g}, {y:g} mm is outside the machine's travel x {x0:g} to {x1:g} mm, y {y0:g} to {y1:g} mm; "
            "put it inside, or choose a larger machine"
        )


class Ink:
    """What the pen has drawn and for how long since it was inked; no re-inking (None) is never due."""

    def __init__(self, reinking: Reinking | None) -> None:
        self.rules = Reinking() if reinking is None else reinking
        self.drawn_mm = self.passed_s = 0.0
        # Nobody knows when a brush was last wet; a pen without a well is taken to be full.
        self.dry = self.rules.well_mm is not None

    def due(self, next_mm: float) -> bool:
        """Whether to re-ink before a stroke of this length."""
        over = self.drawn_mm > 0 and self.drawn_mm + next_mm > self.rules.every_mm * (1 + 1e-9)
        return self.dry or over or self.passed_s >= self.rules.every_s

    def drew(self, length_mm: float) -> None:
        self.drawn_mm += length_mm

    def passed(self, seconds: float) -> None:
        self.passed_s += seconds

    def inked(self) -> None:
        self.drawn_mm = self.passed_s = 0.0
        self.dry = False

    def paused(self) -> None:
        """The plan stops for the operator."""
        self.inked()
        self.dry = self.rules.well_mm is not None
