"""The door of motion planning: layers of strokes in, a Plan out, a chunk of strokes at a time."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from planning.errors import OutsideMachine
from planning.geometry.stroke import Layer, Stroke
from planning.motion.clearance import LEAST_LEAD_S, PenHeight, PenTiming
from planning.motion.draw import draw_parts
from planning.motion.limits import Kinematics, Limits
from planning.motion.path import Array
from planning.motion.plan import (
    TICK_S,
    Action,
    Dip,
    Draw,
    Dwell,
    LayerStart,
    Lift,
    Lower,
    Motion,
    OperatorPause,
    Travel,
    plan_seconds,
)
from planning.motion.reinking import Ink, Reinking, check_well
from planning.motion.travel import Bounds, travel

# A drawing may stick out by this much: arithmetic of page and machine coordinates, far below a motor step.
OUTSIDE_MM = 1e-6

__all__ = ["MotionSettings", "PenTiming", "check_bounds", "plan"]


@dataclass(frozen=True, eq=False, slots=True)
class MotionSettings:
    """What the planner must keep: limits pen down and up, motors, pen times, the machine's travel ((x0, y0), (x1, y1)) in mm.

    `travel` limits hold for each motor's own belt; `draw` limits for the norm of the XY motion. `constant_speed` draws each
    stroke as evenly as its bends allow. `reinking` says when the pen is re-inked and where. `first_chunk_vertices` is small, so
    that the first stroke is out quickly; chunks grow to `chunk_vertices`.
    """

    draw: Limits
    travel: Limits
    kinematics: Kinematics
    pen: PenTiming
    bounds_mm: Bounds
    constant_speed: bool = False
    first_chunk_vertices: int = 64
    chunk_vertices: int = 4096
    reinking: Reinking | None = None


def check_bounds(layers: Iterable[Layer], bounds_mm: Bounds) -> None:
    """Raise OutsideMachine, naming the stroke that sticks out furthest, its number in its layer from 1, unless every point lies
    inside `bounds_mm`.

    O(points).
    """
    (x0, y0), (x1, y1) = bounds_mm
    worst = OUTSIDE_MM
    message = ""
    for layer in layers:
        for number, stroke in enumerate(layer.strokes, 1):
            low, high = stroke.points_mm.min(axis=0), stroke.points_mm.max(axis=0)
            out = {"left": x0 - low[0], "top": y0 - low[1], "right": high[0] - x1, "bottom": high[1] - y1}
            side, by = max(out.items(), key=lambda item: float(item[1]))
            if by > worst:
                worst = float(by)
                message = (
                    f"layer {layer.number} ({layer.name}), stroke {number} sticks out {_rounded(worst)} mm beyond the "
                    f"machine's travel x {x0:g} to {x1:g} mm, y {y0:g} to {y1:g} mm ({side}); "
                    "move or scale the drawing (--fit does), or choose a larger machine"
                )
    if message:
        raise OutsideMachine(message)


def _rounded(length_mm: float) -> str:
    """To three digits, or whole where there are more before the point."""
    return f"{length_mm:.0f}" if length_mm >= 999.5 else f"{max(length_mm, 0.001):.3g}"


def plan(layers: Iterable[Layer], settings: MotionSettings, start_mm: Array, end_mm: Array | None) -> Iterator[Action]:
    """The plan of `layers`, drawn in order from `start_mm` (2,), ending at `end_mm` or over the last stroke's end when None.

    Actions come as soon as their chunk is planned, the Draws of a long stroke window by window; memory is bounded by a chunk.
    Raises ImpossiblePlan naming the stroke that cannot be planned (its number in the plan, from 1) and OutsideMachine for one
    that leaves the machine's travel, or a well that is outside.
    """
    check_well(settings.reinking, settings.bounds_mm)
    ink = Ink(settings.reinking)
    for action in _actions(layers, settings, np.array(start_mm, dtype=np.float64), end_mm, ink):
        ink.passed(plan_seconds(action))
        yield action


def _actions(layers: Iterable[Layer], settings: MotionSettings, at: Array, end_mm: Array | None, ink: Ink) -> Iterator[Action]:
    number = 0
    budget = settings.first_chunk_vertices
    lift = Lift(np.inf)
    for layer in layers:
        yield LayerStart(layer.number, layer.name)
        if layer.pause_before:
            name = layer.name or f"layer {layer.number}"
            said = f"next: {name}" + (f", pen {layer.color}" if layer.color else "")
            yield OperatorPause(", ".join((*layer.pause_for, said)))
            ink.paused()
        strokes = list(layer.strokes)
        done = 0
        reink = bool(strokes) and ink.due(strokes[0].length_mm)
        while done < len(strokes):
            take = _chunk(strokes, done, budget)
            budget = min(settings.chunk_vertices, budget * 8)
            chunk = strokes[done : done + take]
            check_bounds([replace(layer, strokes=tuple(chunk))], settings.bounds_mm)
            begun = number == 0 and not reink and len(chunk[0].points_mm) > settings.first_chunk_vertices
            if begun:  # the plot's first stroke takes a while to be planned: the pen travels to it meanwhile
                start_mm = chunk[0].points_mm[0]
                yield Travel(travel(at, start_mm, settings.travel, settings.kinematics, settings.bounds_mm))
                yield Lower(settings.pen.lower_wait_s(lift.height), number)
            for i, motion, last in draw_parts(
                chunk, settings.draw, settings.kinematics, number, settings.constant_speed, soon=number == 0
            ):
                if not begun:
                    if reink:
                        at, lift = yield from _reink(at, lift, settings)
                        ink.inked()
                    way = travel(at, motion.start_mm, settings.travel, settings.kinematics, settings.bounds_mm)
                    yield from _approach(way, lift, settings.pen, number + i)
                yield Draw(motion, number + i, last)
                begun = not last
                if begun:
                    continue
                ink.drew(chunk[i].length_mm)
                if chunk[i].is_dot and settings.pen.dot_dwell_s > 0:
                    yield Dwell(float(np.ceil(settings.pen.dot_dwell_s / TICK_S - 1e-6) * TICK_S))
                at = motion.end_mm
                following = strokes[done + i + 1] if done + i + 1 < len(strokes) else None
                reink = following is not None and ink.due(following.length_mm)
                lift = _lift(at, None if reink else following, settings.pen)
                yield lift
            number += take
            done += take
    if end_mm is not None:
        yield Travel(travel(at, np.array(end_mm, dtype=np.float64), settings.travel, settings.kinematics, settings.bounds_mm))


def _lift(at_mm: Array, following: Stroke | None, pen: PenTiming) -> Lift:
    """As high as the travel to the `following` stroke asks for; all the way up when something else comes first."""
    height: PenHeight = "up"
    if following is not None:
        height = pen.height_for(float(np.hypot(*(following.points_mm[0] - at_mm))))
    return Lift(pen.lift_wait_s(height), height)


def _reink(at_mm: Array, lift: Lift, settings: MotionSettings) -> Generator[Action, None, tuple[Array, Lift]]:
    """A visit to the well, or a pause; returns where the pen is then, and the lift it was raised by."""
    rules, pen = settings.reinking, settings.pen
    if rules is None or rules.well_mm is None:
        yield OperatorPause("re-ink the pen")
        return at_mm, lift
    yield Travel(travel(at_mm, rules.well_mm, settings.travel, settings.kinematics, settings.bounds_mm))
    raised = Lift(pen.lift_wait_s("up"))
    yield Dip(pen.lower_wait_s("up"), float(np.ceil(rules.dip_s / TICK_S - 1e-6) * TICK_S), raised.wait_s)
    return rules.well_mm, raised


def _approach(way: Motion, lift: Lift, pen: PenTiming, number: int) -> Iterator[Action]:
    """The travel to stroke `number`, after `lift`, and the lowering, which begins on the way where the clearance allows it."""
    lead_s = pen.lead_s(lift.wait_s + way.total_s, lift.height)
    total = round(way.total_s / TICK_S)
    lead = min(int(lead_s / TICK_S), total)
    wait_s = pen.lower_wait_s(lift.height)
    if lead * TICK_S < LEAST_LEAD_S:
        yield Travel(way)
        yield Lower(wait_s, number)
        return
    at = _clear_of_borders(way, total - lead)
    if at == total:
        yield Travel(way)
        yield Lower(wait_s, number)
        return
    yield Travel(way, at * TICK_S)
    yield Lower(max(wait_s - (total - at) * TICK_S, 0.0), number)


def _clear_of_borders(way: Motion, at: int) -> int:
    """The first tick from `at` on that cuts no piece shorter than LEAST_LEAD_S off another: a board could not take those."""
    least = round(LEAST_LEAD_S / TICK_S)
    borders = np.concatenate(([0], np.cumsum(np.rint(way.duration_s / TICK_S)))).astype(np.int64)
    while at not in borders and (near := borders[np.abs(borders - at) < least]).size:
        border = int(near.max())
        at = border if at < border else border + least
    return min(at, int(borders[-1]))


def _chunk(strokes: list[Stroke], start: int, vertices: int) -> int:
    """How many strokes from `start` have about `vertices` vertices together; at least one."""
    total, count = 0, 0
    for stroke in strokes[start:]:
        total += len(stroke.points_mm)
        if count and total > vertices:
            break
        count += 1
    return max(1, count)
