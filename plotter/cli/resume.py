"""`plotter resume`: go on with a plot that was interrupted, every line drawn once."""

from __future__ import annotations

from dataclasses import asdict

import click
import numpy as np

from output.ebb.encode import BoardSetup
from output.ebb.journal import Journal, PlotState
from output.ebb.ports import choose_port
from output.ebb.resume import Place, find_place, position_lost
from output.ebb.session import Board, connect
from output.errors import BoardRefused
from planning.geometry.remainder import OVERLAP_MM
from plotter.board_setup import board_setup
from plotter.cli.streaming import finish, guesses_s, streamed
from plotter.errors import BadInput
from plotter.journals import Part, interrupted_plot, journal_path, made_again, part_program
from plotter.pipeline import Job, planned, program
from plotter.units import spoken_duration

_STILL_TIMEOUT_S = 10.0
_HOME = "run `plotter align`, push the carriage to its home corner, then `plotter resume --homed`"


@click.command()
@click.option("--port", help="Serial port or nickname of the board. Default: the only board there is.")
@click.option("--homed", is_flag=True, help="The carriage was pushed to its home corner: count from there.")
def resume(port: str | None, homed: bool) -> None:
    """Go on with the plot that was interrupted: killed, cut off, or stopped.

    \b
    plotter resume
    plotter resume --homed          when the motors or the board were off in between
    """
    state = interrupted_plot()
    device = choose_port(port)
    job = made_again(state)
    with connect(device, clear=False) as board:
        board.wait_until_still(_STILL_TIMEOUT_S)
        board.clear()
        setup = board_setup(job.settings, job.machine, board.firmware)
        part = _part(job, setup, state, _place(job, setup, state, board, homed), homed)
        with Journal.reopen(journal_path()) as journal:
            journal.part({**asdict(part), "token": board.begin_job()})
            result, took_s = streamed(board, part_program(job, setup, part), guesses_s(job)[part.stroke :], journal)
    finish(result, f"{job.name} on {board.port_name}")
    click.echo(
        f"resumed {job.name} at stroke {part.stroke + 1} of {job.stroke_count} and finished it in {spoken_duration(took_s)}"
    )


def _place(job: Job, setup: BoardSetup, state: PlotState, board: Board, homed: bool) -> Place:
    """Where the plot stands. Raises BoardRefused when the board's counters cannot tell, and home was not confirmed."""
    lost = None if homed else position_lost(board, state)
    if lost:
        raise BoardRefused(f"{lost}: {_HOME}")
    part = Part.of(state.part)
    items = program(planned(job), setup) if part is None else part_program(job, setup, part)
    start = (0, 0) if part is None else _steps_at(part, setup)
    place = find_place(items, setup.firmware, state, None if homed else board.steps(), start)
    if place is None:
        raise BoardRefused(f"the board does not stand where this plot can have left it: {_HOME}")
    return place


def _steps_at(part: Part, setup: BoardSetup) -> tuple[int, int]:
    one, two = np.rint(setup.kinematics.steps(np.array(part.start_mm) - setup.origin_mm))
    return int(one), int(two)


def _part(job: Job, setup: BoardSetup, state: PlotState, place: Place, homed: bool) -> Part:
    """What is left to draw from `place` on. Raises BadInput when nothing is."""
    if place.next_stroke >= job.stroke_count:
        raise BadInput("every stroke of the interrupted plot is drawn: there is nothing to resume")
    scale = float(np.sqrt(abs(np.linalg.det(setup.kinematics.steps_per_mm))))
    drawn_mm = place.drawn_steps / scale if place.stroke is not None else 0.0
    before = Part.of(state.part)
    if drawn_mm and before is not None and before.stroke == place.next_stroke and before.drawn_mm:
        drawn_mm += max(before.drawn_mm - OVERLAP_MM, 0.0)
    left = setup.kinematics.millimetres(np.array([place.steps], dtype=float))[0] + setup.origin_mm
    left_mm = (float(left[0]), float(left[1]))
    return Part(place.next_stroke, drawn_mm, left_mm, (0.0, 0.0) if homed else left_mm, homed)
