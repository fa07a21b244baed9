"""The whole job as a chain of values: drawing, arranged and ordered layers, Plan, program."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from output.ebb.commands import Command
from output.ebb.encode import BoardSetup, encode, epilogue, prologue
from output.ebb.program import Mark
from planning.geometry.stroke import Layer
from planning.motion.plan import Action
from planning.motion.planner import MotionSettings, check_bounds, plan
from planning.motion.reinking import check_well
from planning.ordering.arrange import OrderOptions, order_layers
from planning.ordering.metric import travel_time
from plotter.arrange import Arranged, arrange
from plotter.board_setup import HOME_MM
from plotter.errors import BadInput
from plotter.machines.profile import Machine
from plotter.settings import Settings
from plotter.svg.drawing import Drawing
from plotter.svg.options import ReadOptions
from plotter.svg.read import read_drawing, source_bytes


@dataclass(frozen=True, eq=False, slots=True)
class Job:
    """A drawing ready to be planned: its strokes in machine millimetres, in the order they are drawn from `start_mm` (2,)."""

    name: str
    digest: str
    drawing: Drawing
    arranged: Arranged
    layers: tuple[Layer, ...]
    settings: Settings
    machine: Machine
    start_mm: np.ndarray = field(default_factory=lambda: HOME_MM)

    @property
    def stroke_count(self) -> int:
        return sum(len(layer.strokes) for layer in self.layers)

    @property
    def notes(self) -> tuple[str, ...]:
        """What was left out or done unasked, a sentence each."""
        return (*self.drawing.warnings, *self.arranged.notes)


def prepare(file: str, reading: ReadOptions, settings: Settings, start_mm: np.ndarray | None = None) -> Job:
    """Read, arrange and order a drawing, and check that all of it lies on the machine.

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
    check_bounds(arranged.layers, _travel_bounds(machine))
    check_well(settings.reinking(), _travel_bounds(machine))
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
    )
    metric = travel_time(machine.kinematics(), settings.travel_limits())
    layers = order_layers(arranged.layers, options, start_mm, metric, settings.end_mm())
    return Job(name, hashlib.sha256(content).hexdigest(), drawing, arranged, layers, settings, machine, start_mm)


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
    return plan(job.layers, motion_settings(job.settings, job.machine), job.start_mm, job.settings.end_mm())


def program(actions: Iterator[Action], setup: BoardSetup) -> Iterator[Command | Mark]:
    """Everything that is sent for a Plan: the board's set-up, the plan's commands, and pen up with motors off."""
    yield from prologue(setup)
    yield from encode(actions, setup)
    yield from epilogue(setup)


def _travel_bounds(machine: Machine) -> tuple[tuple[float, float], tuple[float, float]]:
    return (0.0, 0.0), (machine.width_mm, machine.height_mm)
