"""How high the pen is while it rises and falls, as far as it is known.

Heights are shares of the way from pen down (0) to pen up (1). The servo's pulse moves in steps; the tip is between `early_s`
ahead of an even way and `late_s` behind it. Where the paper is, nobody has told the program: somewhere between `touch_low` and
`touch_high`.

    1 ____                       _______________
          \\ earliest           / latest
    touch_high - - \\ - - - - - / - - - - -           above this the pen is clear of the paper for certain
                    \\         /
    touch_low - - - -\\- - - -/ - - - - - -           below this it touches for certain
    0                 \\_____/

So travel may begin when the latest rise has passed `touch_high`, the earliest fall may pass it when travel ends, and a stroke
may begin when the latest fall has passed `touch_low` and the tip has come to rest (`settle_s`).
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal

import numpy as np

PenHeight = Literal["up", "low"]

# An earlier start of lowering than this is not worth two more commands.
LEAST_LEAD_S = 0.005


@dataclass(frozen=True, slots=True)
class Clearance:
    """A pen lift: seconds for the whole way up and down at the servo's rates, and the heights between which the paper lies.

    `drop_s` is the whole way down when it goes fastest, `fall_s` when it goes slowest; `early_s` is how far the tip may be
    ahead of that. `low` is the height to which a low lift goes. Raises ValueError for a time that is negative or heights out of
    order.
    """

    rise_s: float
    fall_s: float
    drop_s: float
    late_s: float
    settle_s: float
    touch_low: float
    touch_high: float
    low: float = 1.0
    early_s: float = 0.0

    def __post_init__(self) -> None:
        for name in (field.name for field in fields(self)):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise ValueError(f"clearance: {name} must be finite and not negative, not {value}")
        if not (self.touch_low <= self.touch_high <= 1.0 and 0.0 < self.low <= 1.0):
            heights = f"touch_low {self.touch_low:g}, touch_high {self.touch_high:g}, low {self.low:g}"
            raise ValueError(f"clearance: {heights} must lie in order between 0 and 1")

    def top(self, height: PenHeight) -> float:
        """How high a lift to `height` goes."""
        return 1.0 if height == "up" else self.low

    def lifted_s(self, height: PenHeight) -> float:
        """From the command to lift until the pen is off the paper for certain."""
        return self.late_s + min(self.touch_high, self.top(height)) * self.rise_s

    def lead_s(self, since_lift_s: float, height: PenHeight) -> float:
        """How long before a travel's end lowering may begin, the travel ending `since_lift_s` after the command to lift.

        The pen may still be rising then: it is taken to be as low as it can be when it turns back.
        """
        clear = (self.top(height) - self.touch_high) * self.drop_s - self.early_s
        if self.rise_s <= 0 or self.drop_s <= 0:
            return max(clear, 0.0)
        # Lowered at since - lead, it has risen to (since - lead - late) / rise at least, from where it must still be at
        # touch_high after (lead + early) / drop.
        spare_s = since_lift_s - self.late_s - self.touch_high * self.rise_s - self.early_s * self.rise_s / self.drop_s
        return max(min(clear, spare_s * self.drop_s / (self.rise_s + self.drop_s)), 0.0)

    def down_s(self, height: PenHeight) -> float:
        """From the command to lower until the pen is on the paper for certain, and quiet."""
        return self.late_s + max(self.top(height) - self.touch_low, 0.0) * self.fall_s + self.settle_s


@dataclass(frozen=True, slots=True)
class PenTiming:
    """How long the plan waits after starting to lower and to lift the pen over its whole way, and how long a dot is held.

    `overlap` (0 to 1) is how much of what `clearance` allows is used: 0 waits for the whole of every lift and lowering, 1 goes
    as far as it says. Travels shorter than `low_below_mm` lift to the low height only. Without a clearance there is neither.

    Raises ValueError for a time that is negative or not finite, and for an overlap outside 0 to 1.
    """

    lower_s: float
    lift_s: float
    dot_dwell_s: float = 0.0
    overlap: float = 0.0
    low_below_mm: float = 0.0
    clearance: Clearance | None = None

    def __post_init__(self) -> None:
        for name in ("lower_s", "lift_s", "dot_dwell_s", "low_below_mm"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise ValueError(f"{name} must be finite and not negative, not {value}")
        if not 0.0 <= self.overlap <= 1.0:
            raise ValueError(f"overlap must be 0 to 1, not {self.overlap}")

    def height_for(self, distance_mm: float) -> PenHeight:
        """How high to lift for a travel this long."""
        return "low" if self.clearance is not None and distance_mm < self.low_below_mm and self.clearance.low < 1.0 else "up"

    def lift_wait_s(self, height: PenHeight) -> float:
        """From the command to lift until the travel begins."""
        whole = self.whole_lift_s(height)
        return whole if self.clearance is None else whole - self.overlap * max(whole - self.clearance.lifted_s(height), 0.0)

    def whole_lift_s(self, height: PenHeight) -> float:
        """The whole way from the paper to `height`."""
        if self.clearance is None:
            return self.lift_s
        least = min(self.clearance.lifted_s(height), self.lift_s)
        return max(self.lift_s - (1.0 - self.clearance.top(height)) * self.clearance.rise_s, least)

    def lower_wait_s(self, height: PenHeight) -> float:
        """From the command to lower, from `height`, until the stroke begins."""
        if self.clearance is None:
            return self.lower_s
        least = min(self.clearance.down_s(height), self.lower_s)
        whole = max(self.lower_s - (1.0 - self.clearance.top(height)) * self.clearance.fall_s, least)
        return whole - self.overlap * max(whole - self.clearance.down_s(height), 0.0)

    def lead_s(self, since_lift_s: float, height: PenHeight) -> float:
        """How long before the end of a travel, which ends `since_lift_s` after the command to lift, lowering begins."""
        if self.clearance is None:
            return 0.0
        lead = self.overlap * self.clearance.lead_s(since_lift_s, height)
        return min(lead, self.lower_wait_s(height))
