"""The door of motion planning: layers of strokes in, a Plan out, a chunk of strokes at a time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from planning.errors import OutsideMachine
from planning.geometry.stroke import Layer, Stroke
from planning.motion.draw import draw_parts
from planning.motion.limits import Kinematics, Limits
from planning.motion.path import Array
from planning.motion.plan import TICK_S, Action, Draw, Dwell, LayerStart, Lift, Lower, OperatorPause, Travel
from planning.motion.travel import Bounds, travel

# A drawing may stick out by this much: arithmetic of page and machine coordinates, far below a motor step.
OUTSIDE_MM = 1e-6


@dataclass(frozen=True, slots=True)
class PenTiming:
    """How long the plan waits after starting to lower and to lift the pen, and how long a dot is held.

    Raises ValueError for a time that is negative or not finite.
    """

    lower_s: float
    lift_s: float
    dot_dwell_s: float = 0.0

    def __post_init__(self) -> None:
        for name in ("lower_s", "lift_s", "dot_dwell_s"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise ValueError(f"{name} must be finite and not negative, not {value}")


@dataclass(frozen=True, eq=False, slots=True)
class MotionSettings:
    """What the planner must keep: limits pen down and up, motors, pen times, the machine's travel ((x0, y0), (x1, y1)) in mm.

    `travel` limits hold for each motor's own belt; `draw` limits for the norm of the XY motion. `constant_speed` draws each
    stroke as evenly as its bends allow. `first_chunk_vertices` is small, so that the first stroke is out quickly; chunks grow
    to `chunk_vertices`.
    """

    draw: Limits
    travel: Limits
    kinematics: Kinematics
    pen: PenTiming
    bounds_mm: Bounds
    constant_speed: bool = False
    first_chunk_vertices: int = 64
    chunk_vertices: int = 4096


def check_bounds(layers: Iterable[Layer], bounds_mm: Bounds) -> None:
    """Raise OutsideMachine, naming the stroke that sticks out furthest, unless every point lies inside `bounds_mm`.

    O(points).
    """
    (x0, y0), (x1, y1) = bounds_mm
    worst = OUTSIDE_MM
    message = ""
    number = 0
    for layer in layers:
        for stroke in layer.strokes:
            low, high = stroke.points_mm.min(axis=0), stroke.points_mm.max(axis=0)
            out = {"left": x0 - low[0], "top": y0 - low[1], "right": high[0] - x1, "bottom": high[1] - y1}
            side, by = max(out.items(), key=lambda item: float(item[1]))
            if by > worst:
                worst = float(by)
                message = (
                    f"layer {layer.number} ({layer.name}), stroke {number} sticks out {worst:.3g} mm beyond the machine's "
                    f"travel x {x0:g} to {x1:g} mm, y {y0:g} to {y1:g} mm ({side}); "
                    "move or scale the drawing, or choose a larger machine"
                )
            number += 1
    if message:
        raise OutsideMachine(message)


def plan(layers: Iterable[Layer], settings: MotionSettings, start_mm: Array, end_mm: Array | None) -> Iterator[Action]:
    """The plan of `layers`, drawn in order from `start_mm` (2,), ending at `end_mm` or over the last stroke's end when None.

    Actions come as soon as their chunk is planned, the Draws of a long stroke window by window; memory is bounded by a chunk.
    Raises ImpossiblePlan naming the stroke that cannot be planned (its number in the plan, from 0) and OutsideMachine for one
    that leaves the machine's travel.
    """
    at = np.array(start_mm, dtype=np.float64)
    number = 0
    budget = settings.first_chunk_vertices
    for layer in layers:
        yield LayerStart(layer.number, layer.name)
        if layer.pause_before:
            name = layer.name or f"layer {layer.number}"
            yield OperatorPause(f"next: {name}" + (f", pen {layer.color}" if layer.color else ""))
        strokes = list(layer.strokes)
        done = 0
        while done < len(strokes):
            take = _chunk(strokes, done, budget)
            budget = min(settings.chunk_vertices, budget * 4)
            chunk = strokes[done : done + take]
            check_bounds([replace(layer, strokes=tuple(chunk))], settings.bounds_mm)
            begun = False
            for i, motion, last in draw_parts(chunk, settings.draw, settings.kinematics, number, settings.constant_speed):
                if not begun:
                    yield Travel(travel(at, motion.start_mm, settings.travel, settings.kinematics, settings.bounds_mm))
                    yield Lower(settings.pen.lower_s, number + i)
                yield Draw(motion, number + i, last)
                begun = not last
                if begun:
                    continue
                if chunk[i].is_dot and settings.pen.dot_dwell_s > 0:
                    yield Dwell(float(np.ceil(settings.pen.dot_dwell_s / TICK_S - 1e-6) * TICK_S))
                yield Lift(settings.pen.lift_s)
                at = motion.end_mm
            number += take
            done += take
    if end_mm is not None:
        yield Travel(travel(at, np.array(end_mm, dtype=np.float64), settings.travel, settings.kinematics, settings.bounds_mm))


def _chunk(strokes: list[Stroke], start: int, vertices: int) -> int:
    """How many strokes from `start` have about `vertices` vertices together; at least one."""
    total, count = 0, 0
    for stroke in strokes[start:]:
        total += len(stroke.points_mm)
        if count and total > vertices:
            break
        count += 1
    return max(1, count)
