"""The whole job as a chain of values: drawing, arranged and ordered layers, Plan, program."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from output.ebb.commands import Command
from output.ebb.encode import BoardSetup, encode, epilogue, prologue
from output.ebb.program import Mark
from planning.geometry.stroke import Layer, Points
from planning.motion.plan import Action, LayerStart
from planning.motion.planner import MotionSettings, check_bounds, plan
from planning.motion.reinking import check_well
from planning.ordering.arrange import OrderOptions, merged, order_in_turn
from planning.ordering.metric import travel_time
from planning.ordering.opening import Pace
from plotter.arrange import Arranged, arrange
from plotter.board_setup import HOME_MM
from plotter.errors import BadInput
from plotter.machines.profile import Machine
from plotter.settings import Settings
from plotter.svg.drawing import Drawing
from plotter.svg.options import ReadOptions
from plotter.svg.read import read_drawing, source_bytes


class Ordering:
    """The order of a drawing while it is being found: pieces of layers, each found when somebody asks for it, and then kept.

    May be asked from several threads; who asks for a piece that another one is at waits for it.
    """

    def __init__(self, pieces: Iterator[Layer]) -> None:
        self._pieces = pieces
        self._lock = threading.Lock()
        self.found: list[Layer] = []
        self.complete = False

    def __iter__(self) -> Iterator[Layer]:
        at = 0
        while self._has(at):
            yield self.found[at]
            at += 1

    def _has(self, at: int) -> bool:
        if at < len(self.found):  # what is there already waits for nobody
            return True
        with self._lock:
            if at == len(self.found) and not self.complete:
                piece = next(self._pieces, None)
                if piece is None:
                    self.complete = True
                else:
                    self.found.append(piece)
            return at < len(self.found)


@dataclass(frozen=True, eq=False, slots=True)
class Job:
    """A drawing ready to be planned: its strokes in machine millimetres, in the order they are drawn from `start_mm` (2,).

    `ordering` gives them as they are needed, so that drawing can begin before the order of all of them is known; `layers` and
    `stroke_count` wait for all of it.
    """

    name: str
    digest: str
    drawing: Drawing
    arranged: Arranged
    ordering: Ordering
    settings: Settings
    machine: Machine
    start_mm: np.ndarray = field(default_factory=lambda: HOME_MM)

    @property
    def layers(self) -> tuple[Layer, ...]:
        return merged(list(self.ordering))

    @property
    def stroke_count(self) -> int:
        return sum(len(piece.strokes) for piece in self.ordering)

    @property
    def notes(self) -> tuple[str, ...]:
        """What was left out or done unasked, a sentence each."""
        return (*self.drawing.warnings, *self.arranged.notes)


def prepare(file: str, reading: ReadOptions, settings: Settings, start_mm: np.ndarray | None = None) -> Job:
    """Read and arrange a drawing, check that all of it lies on the machine, and begin to order it.

    `start_mm` (2,) is where the pen is, in machine millimetres; None is at home.
    Raises BadInput for a drawing that cannot be used, OutsideMachine for one that leaves the machine's travel.
    """
    if start_mm is None:
        if settings.start != "home":
            raise BadInput("--start here: only a connected board knows where the pen is; leave it out, or use `plotter plot`")
        start_mm = HOME_MM
    machine = settings.machine_profile()
    name, content = source_bytes(file, reading)
    drawing = read_drawing(content, reading)
    arranged = arrange(drawing, settings, machine)
    low, high = _travel_bounds(machine)
    left, top, right, bottom = arranged.bounds_mm
    if left < low[0] or top < low[1] or right > high[0] or bottom > high[1]:
        check_bounds(arranged.layers, (low, high))  # names the stroke, which takes longer
    check_well(settings.reinking(), (low, high))
    options = OrderOptions(
        order=settings.order,
        time_budget_s=settings.order_time,
        join_tolerance_mm=settings.join,
        keep_duplicates=settings.keep_duplicates,
        seams=settings.seams,
        overdraw_mm=settings.overdraw,
        reverse=settings.reverse,
        interleave=settings.interleave,
        max_stroke_mm=settings.longest_stroke_mm,
        by=settings.group,
        seed=settings.seed,
        pace=Pace(stroke_guess_s(settings), settings.draw_speed),
    )
    metric = travel_time(machine.kinematics(), settings.travel_limits())
    ordering = Ordering(order_in_turn(arranged.layers, options, start_mm, metric, settings.end_mm()))
    return Job(name, hashlib.sha256(content).hexdigest(), drawing, arranged, ordering, settings, machine, start_mm)


def stroke_guess_s(settings: Settings) -> float:
    """About how long a stroke takes besides being drawn: its lifts and the travel to it."""
    return settings.lift_time + settings.lower_time + 0.2


def motion_settings(settings: Settings, machine: Machine) -> MotionSettings:
    """The planner's limits from the settings."""
    return MotionSettings(
        draw=settings.draw_limits(),
        travel=settings.travel_limits(),
        kinematics=machine.kinematics(),
        pen=settings.pen_timing(),
        bounds_mm=_travel_bounds(machine),
        constant_speed=settings.constant_speed,
        reinking=settings.reinking(),
    )


def planned(job: Job) -> Iterator[Action]:
    """The Plan, as it is being made."""
    return planned_from(job, job.ordering, job.start_mm)


def planned_from(job: Job, pieces: Iterable[Layer], start_mm: Points) -> Iterator[Action]:
    """The Plan of these pieces of layers from `start_mm` (2,) on; a layer starts once, however many pieces it comes in."""
    number = None
    for action in plan(pieces, motion_settings(job.settings, job.machine), start_mm, job.settings.end_mm()):
        if isinstance(action, LayerStart):
            if action.number == number:
                continue
            number = action.number
        yield action


def program(actions: Iterator[Action], setup: BoardSetup) -> Iterator[Command | Mark]:
    """Everything that is sent for a Plan: the board's set-up, the plan's commands, and pen up with motors off."""
    yield from prologue(setup)
    yield from encode(actions, setup)
    yield from epilogue(setup)


def _travel_bounds(machine: Machine) -> tuple[tuple[float, float], tuple[float, float]]:
    return (0.0, 0.0), (machine.width_mm, machine.height_mm)
