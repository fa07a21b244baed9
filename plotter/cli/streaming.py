"""What plot, send and resume share: a program streamed with a progress bar and keys, and how it ended."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from output.ebb.control import StopFlag, signals_end_here
from output.ebb.program import Program
from output.ebb.progress import Progress
from output.ebb.session import Board, StreamResult
from output.errors import LinkLost, PositionLost
from output.wording import counted
from planning.ordering.opening import Pace
from plotter.cli.keys import keys
from plotter.cli.say import progress_bar
from plotter.errors import Interrupted, Paused
from plotter.pipeline import Job, stroke_guess_s

# How a plot goes on whose motors have let go.
FROM_HOME = "push the carriage to its home corner, then `plotter resume --homed`"


def patience_s(speed: float) -> float:
    """How long the virtual board waits for this computer before it runs dry: in real time not at all, as a board would."""
    return 0.0 if speed <= 1 else 120.0


@dataclass(frozen=True, slots=True)
class Ended:
    """How a plot ended: its last stream's result, progress since the program was started, how long that took (clock), and how
    many strokes of the drawing were drawn before."""

    result: StreamResult
    total: Progress
    took_s: float
    drawn_before: int = 0


def streamed(board: Board, items: Program, guess_s: list[float]) -> Ended:
    """Stream a program that is sent as it is, with a progress bar and keys; Ctrl-C stops it."""
    stop, started = StopFlag(), time.monotonic()
    with signals_end_here(stop), progress_bar(guess_s) as bar, keys(stop) as listening:
        bar.without_keys = "" if listening else "Ctrl-C ends it"
        result = board.stream(items, on_progress=bar.show, stop=stop)
    return Ended(result, result.progress, time.monotonic() - started)


def guesses_s(job: Job) -> list[float]:
    """About how long each stroke takes, lifts included; the bar corrects the common factor.

    While the order is still being found, those that are not in it yet are taken to be as they are in the file on average.
    """
    complete, pace = job.ordering.complete, Pace(stroke_guess_s(job.settings), job.settings.draw_speed)
    found = [pace.seconds(piece.strokes) for piece in list(job.ordering.found)]
    if complete:
        return [seconds for piece in found for seconds in piece.tolist()]
    in_file = np.concatenate([pace.seconds(layer.strokes) for layer in job.arranged.layers])
    left = max(len(in_file) - sum(map(len, found)), 0)
    return [seconds for piece in found for seconds in piece.tolist()] + [float(in_file.mean())] * left


@contextmanager
def told_how_to_go_on(resumable: Callable[[], bool]) -> Iterator[None]:
    """Errors that a plot can be gone on with after say how, where it is `resumable` (asked then)."""
    try:
        yield
    except PositionLost as error:
        if resumable():
            error.args = (f"{error}, then `plotter resume --homed`",)
        raise
    except LinkLost as error:
        if resumable():
            error.args = (f"{error}; once the board can be reached again, `plotter resume` goes on",)
        raise


def finish(ended: Ended, where: str, *, resumable: bool = True) -> None:
    """Raises Paused or Interrupted for a plot that did not come to its end, saying what became of the pen, and, where it is
    `resumable`, how to go on."""
    result, drawn = ended.result, ended.drawn_before + ended.total.strokes_done
    strokes = f"after {counted(drawn, 'stroke')}"
    if result.outcome == "done":
        return
    if result.outcome == "paused":
        if resumable:
            raise Paused(f"paused: {where} {strokes}; the pen is up and the motors hold: `plotter resume` goes on")
        raise Interrupted(f"stopped by Ctrl-C: {where} {strokes}; the pen is up")
    report = result.stop
    pen = "the pen is up" if report is not None and report.pen_up else "THE PEN MAY BE DOWN: lift it by hand"
    again = f"; {FROM_HOME} to go on with it" if resumable else ""
    raise Interrupted(f"{result.reason}: {where} {strokes}; {pen} and the motors are off{again}")
