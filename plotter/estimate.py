"""What a plan consists of: distances, strokes, lifts and pauses, in all and layer by layer, counted as the plan passes by."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from output.ebb.estimate import Estimate, Times
from planning.motion.plan import Action, Dip, Draw, LayerStart, Lift, Motion, OperatorPause, Travel

# Speed is the root of a quartic in time: five points integrate its length to well under a micrometre a piece.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)


@dataclass(slots=True)
class Tally:
    """Millimetres of pen travel, and counts."""

    pen_down_mm: float = 0.0
    pen_up_mm: float = 0.0
    pen_lifts: int = 0
    strokes: int = 0
    pauses: int = 0


@dataclass(frozen=True, slots=True)
class PlannedPause:
    """Where the plan stops for the operator: before which stroke (from 1), in which layer."""

    message: str
    before_stroke: int
    layer: int


@dataclass(slots=True)
class LayerTally(Tally):
    """The tally of one layer: from its start to the next one's."""

    number: int = 0
    name: str = ""


@dataclass(slots=True)
class PlanTally:
    """Counts what passes through `watch`."""

    total: Tally = field(default_factory=Tally)
    layers: list[LayerTally] = field(default_factory=list)
    pauses: list[PlannedPause] = field(default_factory=list)
    low_mm: NDArray[np.float64] = field(default_factory=lambda: np.full(2, np.inf))
    high_mm: NDArray[np.float64] = field(default_factory=lambda: np.full(2, -np.inf))

    @property
    def bounds_mm(self) -> tuple[float, float, float, float]:
        """(left, top, right, bottom) of where the pen is down, machine millimetres."""
        return float(self.low_mm[0]), float(self.low_mm[1]), float(self.high_mm[0]), float(self.high_mm[1])

    def watch(self, actions: Iterable[Action]) -> Iterator[Action]:
        """The same actions; distances, strokes, lifts and pauses are counted as they pass."""
        for action in actions:
            match action:
                case LayerStart(number=number, name=name):
                    self.layers.append(LayerTally(number=number, name=name))
                case Draw(motion=motion, last=last):
                    self._count(pen_down_mm=length_mm(motion), strokes=int(last))
                    self._see(motion)
                case Travel(motion=motion):
                    self._count(pen_up_mm=length_mm(motion))
                case Lift() | Dip():
                    self._count(pen_lifts=1)
                case OperatorPause(message=message):
                    layer = self.layers[-1].number if self.layers else 0
                    self.pauses.append(PlannedPause(message, self.total.strokes + 1, layer))
                    self._count(pauses=1)
            yield action

    def _count(self, **amounts: float) -> None:
        for tally in (self.total, *self.layers[-1:]):
            for name, amount in amounts.items():
                setattr(tally, name, getattr(tally, name) + amount)

    def _see(self, motion: Motion) -> None:
        for points in (motion.position_mm, motion.end_mm[None]):
            if len(points):
                self.low_mm = np.minimum(self.low_mm, points.min(axis=0))
                self.high_mm = np.maximum(self.high_mm, points.max(axis=0))


def facts(tally: PlanTally, estimate: Estimate) -> dict[str, Any]:
    """`preview --json`'s values: the plan's distances and the program's board time, in all and by layer."""
    times = {layer.number: layer for layer in estimate.layers}
    return {
        **_together(tally.total, estimate),
        "pauses_at": [asdict(pause) for pause in tally.pauses],
        "layers": [
            {"number": layer.number, "name": layer.name, **_together(layer, times.get(layer.number, Times()))}
            for layer in tally.layers
        ],
        "bounds_mm": [round(value, 4) for value in tally.bounds_mm],
        "commands": estimate.commands,
        "slowed_s": round(estimate.slowed_s, 4),
    }


def _together(tally: Tally, times: Times) -> dict[str, float]:
    values = {
        "duration_s": times.duration_s,
        "pen_down_s": times.pen_down_s,
        "pen_up_s": times.pen_up_s,
        "pen_lift_s": times.pen_lift_s,
        "pen_down_mm": tally.pen_down_mm,
        "pen_up_mm": tally.pen_up_mm,
        "pen_lifts": tally.pen_lifts,
        "strokes": tally.strokes,
        "pauses": tally.pauses,
    }
    return {name: round(value, 4) for name, value in values.items()}


def length_mm(motion: Motion) -> float:
    """How far the pen goes along the motion."""
    if not len(motion):
        return 0.0
    half = motion.duration_s[:, None] / 2
    t = (half * (1 + _NODES))[:, :, None]
    v = motion.velocity_mm_s[:, None] + t * (motion.acceleration_mm_s2[:, None] + t * motion.jerk_mm_s3[:, None] / 2)
    return float((np.hypot(v[..., 0], v[..., 1]) * _WEIGHTS * half).sum())
