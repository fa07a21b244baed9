"""How long a plot takes and what it consists of: a tally of the program that would be sent, not a model of it.

Every command is counted with the board time it takes, so that the estimate is wrong only by what the host makes the board wait.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from output.ebb.board_time import board_time_s
from output.ebb.commands import SP, Command
from output.ebb.program import LayerMark, Mark, StrokeEnd, StrokeMark
from planning.motion.plan import Action, Draw, LayerStart, Lift, Motion, Travel

# Speed is the root of a quartic in time: five points integrate its length to well under a micrometre a piece.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)


@dataclass(slots=True)
class Tally:
    """Seconds of board time, millimetres of pen travel, and counts."""

    pen_down_s: float = 0.0
    pen_up_s: float = 0.0
    pen_lift_s: float = 0.0
    pen_down_mm: float = 0.0
    pen_up_mm: float = 0.0
    pen_lifts: int = 0
    strokes: int = 0

    @property
    def duration_s(self) -> float:
        return self.pen_down_s + self.pen_up_s + self.pen_lift_s


@dataclass(slots=True)
class LayerTally(Tally):
    """The tally of one layer: from its start to the next one's."""

    number: int = 0
    name: str = ""


@dataclass(slots=True)
class Estimate:
    """Fills itself while a plan and its program pass through it: `program(encode(estimate.plan(actions)))`."""

    total: Tally = field(default_factory=Tally)
    layers: list[LayerTally] = field(default_factory=list)
    commands: int = 0
    low_mm: np.ndarray = field(default_factory=lambda: np.full(2, np.inf))
    high_mm: np.ndarray = field(default_factory=lambda: np.full(2, -np.inf))
    _planned: LayerTally | None = None
    _sent: LayerTally | None = None

    @property
    def bounds_mm(self) -> tuple[float, float, float, float]:
        """(left, top, right, bottom) of where the pen is down, machine millimetres."""
        return float(self.low_mm[0]), float(self.low_mm[1]), float(self.high_mm[0]), float(self.high_mm[1])

    def plan(self, actions: Iterable[Action]) -> Iterator[Action]:
        """The same actions; distances, strokes and lifts are counted as they pass."""
        for action in actions:
            match action:
                case LayerStart(number=number, name=name):
                    self._planned = LayerTally(number=number, name=name)
                    self.layers.append(self._planned)
                case Draw(motion=motion):
                    self._count(pen_down_mm=length_mm(motion), strokes=1)
                    self._see(motion)
                case Travel(motion=motion):
                    self._count(pen_up_mm=length_mm(motion))
                case Lift():
                    self._count(pen_lifts=1)
            yield action

    def program(self, items: Iterable[Command | Mark]) -> Iterator[Command | Mark]:
        """The same items; board time is counted as they pass."""
        drawing = False
        for item in items:
            match item:
                case LayerMark(number=number):
                    self._sent = next((layer for layer in self.layers if layer.number == number), None)
                case StrokeMark():
                    drawing = True
                case StrokeEnd():
                    drawing = False
                case Command():
                    self.commands += 1
                    seconds = board_time_s(item)
                    phase = "pen_lift_s" if isinstance(item, SP) else "pen_down_s" if drawing else "pen_up_s"
                    for tally in self._tallies(self._sent):
                        setattr(tally, phase, getattr(tally, phase) + seconds)
            yield item

    def _count(self, **amounts: float) -> None:
        for tally in self._tallies(self._planned):
            for name, amount in amounts.items():
                setattr(tally, name, getattr(tally, name) + amount)

    def _see(self, motion: Motion) -> None:
        for points in (motion.position_mm, motion.end_mm[None]):
            if len(points):
                self.low_mm = np.minimum(self.low_mm, points.min(axis=0))
                self.high_mm = np.maximum(self.high_mm, points.max(axis=0))

    def _tallies(self, layer: LayerTally | None) -> tuple[Tally, ...]:
        return (self.total,) if layer is None else (self.total, layer)


def length_mm(motion: Motion) -> float:
    """How far the pen goes along the motion."""
    if not len(motion):
        return 0.0
    half = motion.duration_s[:, None] / 2
    t = (half * (1 + _NODES))[:, :, None]
    v = motion.velocity_mm_s[:, None] + t * (motion.acceleration_mm_s2[:, None] + t * motion.jerk_mm_s3[:, None] / 2)
    return float((np.hypot(v[..., 0], v[..., 1]) * _WEIGHTS * half).sum())
