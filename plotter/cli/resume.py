"""`plotter resume`: go on with a plot that was interrupted, every line drawn once."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import click
import numpy as np

from output.ebb.abilities import Abilities
from output.ebb.commands import Command
from output.ebb.encode import BoardSetup
from output.ebb.firmware import firmware
from output.ebb.journal import PlotState
from output.ebb.ports import choose_port, find_ports, wait_for_board
from output.ebb.program import Mark
from output.ebb.resume import Place, find_place, position_lost, ran_out
from output.ebb.session import Board, connect
from output.errors import BoardRefused, LinkLost
from plotter.board_setup import board_setup
from plotter.cli.awake import awake
from plotter.cli.journal import gone_on_with, nothing_else_running
from plotter.cli.parts import plot_in_parts
from plotter.cli.say import meanwhile
from plotter.cli.standard_streams import done
from plotter.cli.streaming import FROM_HOME, WITHOUT_JOURNAL, finish, told_how_to_go_on
from plotter.journals import Part, interrupted_plot, made_again, part_after, part_program, settings_of
from plotter.pipeline import Job
from plotter.units import spoken_duration

_BACK_TIMEOUT_S = 5.0
_HOME = f"run `plotter align`, {FROM_HOME}"
# Terminals that Unix numbers: the next one that is opened, anybody's, gets the number of one that has gone.
_TERMINAL = re.compile(r"/dev/(pts/|ttys)[0-9]+")


@click.command()
@click.option("--port", help="Serial port or nickname of the board. Default: the plot's own, else the only one there is.")
@click.option("--homed", is_flag=True, help="The carriage was pushed to its home corner: count from there.")
def resume(port: str | None, homed: bool) -> None:
    """Go on with the plot that was interrupted: killed, cut off, or stopped.

    \b
    plotter resume
    plotter resume --homed          when the motors or the board were off in between
    """
    with nothing_else_running():
        _resume(port, homed)


def _resume(port: str | None, homed: bool) -> None:
    state = interrupted_plot()
    settings = settings_of(state)
    device = _port(state, port)
    checksums, pen_pin = settings.checksums, settings.pen_lift().other_pin
    with awake(), connect(device, clear=False, checksums=checksums, pen_pin=pen_pin) as board:
        board.wait_until_still()
        board.clear()
        # To read, order and plan a large drawing again takes half a minute: what the board alone can tell comes first.
        lost = None if homed else position_lost(board, state)
        again = cache(partial(_job_again, state))
        if lost and not _all_drawn(again, state, board):
            raise BoardRefused(f"{lost}: {_HOME}")
        if not lost:
            board.watch_supply()
        job = again()
        setup = board_setup(job.settings, job.machine, board.firmware)
        if lost:
            with gone_on_with() as journal:
                journal.end("done", None)
            done(f"resumed {job.name}: all of it had been drawn; the pen is up")
            return
        place = _place(job, setup, state, board, homed)
        part = part_after(setup, Part.of(state.part), place, homed)
        with told_how_to_go_on(lambda: not journal.trouble), gone_on_with() as journal:
            ended = plot_in_parts(board, job, setup, journal, part)
    finish(ended, f"{job.name} on {board.port_name}", not_resumed=WITHOUT_JOURNAL if journal.trouble else "")
    took = spoken_duration(ended.took_s)
    where = f"at stroke {part.stroke + 1} of {job.stroke_count}" if part.stroke < job.stroke_count else "after its last stroke"
    done(f"resumed {job.name} {where} and finished it in {took}")


def _port(state: PlotState, wanted: str | None) -> str:
    """The port to open: unless one is wanted, the plot's own where no list of boards has it (a virtual board, a link to one);
    else that of the board with the plot's nickname, under whatever name it is back, else of the only board there is. Whether
    it is the plot's board its token tells."""
    nickname, port = state.part.get("nickname"), state.part.get("port")
    if wanted is None and isinstance(port, str) and _is_there_unlisted(port):
        return port
    if wanted is None and isinstance(nickname, str) and nickname:
        with suppress(LinkLost):
            return wait_for_board(nickname, _BACK_TIMEOUT_S)
    if wanted is None and not find_ports():
        raise LinkLost(
            f"no EiBotBoard is plugged in; the plot was on {_named(state)}: check the USB cable and that it carries data, then "
            "`plotter resume` (--port names one that no list has)"
        )
    return choose_port(wanted)


def _named(state: PlotState) -> str:
    """The plot's board, as far as the journal knows it."""
    nickname, port = state.part.get("nickname"), state.part.get("port")
    board = f"the board {nickname!r}" if nickname else "a board without a nickname"
    return f"{board} at {port}" if port else "a board that is not known"


def _is_there_unlisted(port: str) -> bool:
    if _TERMINAL.fullmatch(port) or not Path(port).is_char_device():
        return False
    return all(board.device != port for board in find_ports())


def _as_it_was(setup: BoardSetup, state: PlotState) -> BoardSetup:
    """The set-up by which the journal's commands are numbered: the board's firmware may have been changed since."""
    name = state.part.get("firmware")
    return replace(setup, firmware=firmware(name)) if isinstance(name, str) else setup


def _job_again(state: PlotState) -> Job:
    meanwhile(f"reading {state.head.get('file')} again, and looking for the place where it was left ...")
    return made_again(state)


def _all_drawn(again: Callable[[], Job], state: PlotState, board: Board) -> bool:
    """Whether no line is left to draw, whatever became of the position: by the journal, or by what the board did on its own.

    The job is made `again` only where it may be so.
    """

    def program() -> Iterator[Command | Mark]:
        job = again()
        setup = _as_it_was(board_setup(job.settings, job.machine, board.firmware), state)
        yield from part_program(job, setup, Part.of(state.part))

    between_strokes = bool(state.strokes_done) and state.stroke is None
    return (between_strokes and _is_all(len(state.strokes_done), again())) or ran_out(board, state, program())


def _is_all(strokes: int, job: Job) -> bool:
    """Whether the drawing has no more strokes than that; of a large one it is known long before all of it is in order."""
    for piece in job.ordering:
        strokes -= len(piece.strokes)
        if strokes < 0:
            return False
    return strokes == 0


def _place(job: Job, setup: BoardSetup, state: PlotState, board: Board, homed: bool) -> Place:
    """Where the plot stands. Raises BoardRefused when the board's counters fit nowhere, and home was not confirmed."""
    part, setup = Part.of(state.part), _as_it_was(setup, state)
    start, first = ((0, 0), 0) if part is None else (_steps_at(part, setup), part.stroke)
    steps = _stopped_at(state, setup) if homed else board.steps()
    if steps is not None and part is not None and _on_the_way(part, state):
        start = steps
    place = find_place(part_program(job, setup, part), setup.firmware, state, steps, start, first)
    if place is None and homed:  # nor where it was stopped: after what is executed for certain, then
        place = find_place(part_program(job, setup, part), setup.firmware, state, None, start, first)
    if place is None:
        raise BoardRefused(f"the board does not stand where this plot can have left it: {_HOME}")
    return place


def _on_the_way(part: Part, state: PlotState) -> bool:
    """Whether nothing of the part has been sent yet, so that the board may stand anywhere on the way home in a pause.

    Not after a stop, which lets go of the motors: firmware before 2.8.0 cannot say that it did.
    """
    return not (part.homed or state.sent or state.damaged or state.ended == "stopped")


def _stopped_at(state: PlotState, setup: BoardSetup) -> tuple[int, int] | None:
    """Where the motors stood when the operator stopped the plot; None when that is not known. Before firmware 3 a move that is
    queued is made after the stop, from wherever the one before it was cut off."""
    counts_on = Abilities(setup.firmware.name, setup.firmware.version).stop_clears
    return state.stopped_at if state.ended == "stopped" and counts_on else None


def _steps_at(part: Part, setup: BoardSetup) -> tuple[int, int]:
    one, two = np.rint(setup.kinematics.steps(np.array(part.start_mm) - setup.origin_mm))
    return int(one), int(two)
