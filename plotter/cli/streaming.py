"""What plot, send and resume share: a program streamed with a progress bar and keys, and how it ended."""

from __future__ import annotations

import time

from output.ebb.control import StopFlag, ignore_signals
from output.ebb.journal import Journal
from output.ebb.program import Program
from output.ebb.session import Board, StreamResult
from plotter.cli.keys import keys
from plotter.cli.say import progress_bar
from plotter.errors import Interrupted
from plotter.pipeline import Job


def patience_s(speed: float) -> float:
    """How long the virtual board waits for this computer before it runs dry: in real time not at all, as a board would."""
    return 0.0 if speed <= 1 else 120.0


def streamed(board: Board, items: Program, guess_s: list[float], journal: Journal | None) -> tuple[StreamResult, float]:
    """Stream with a progress bar and keys; returns how it ended and how long it took by the clock."""
    stop, started = StopFlag(), time.monotonic()
    with progress_bar(guess_s) as bar, keys(stop):
        result = board.stream(items, on_progress=bar.show, stop=stop, journal=journal)
    if result.outcome != "done":
        ignore_signals()  # the pen is up; a late Ctrl-C would only take the message and the exit code away
    if journal is not None:
        journal.end(result.outcome, result.steps)
    return result, time.monotonic() - started


def guesses_s(job: Job) -> list[float]:
    """About how long each stroke takes, lifts included; the bar corrects the common factor."""
    lifts_s = job.settings.lift_time + job.settings.lower_time + 0.2
    return [lifts_s + stroke.length_mm / job.settings.draw_speed for layer in job.layers for stroke in layer.strokes]


def finish(result: StreamResult, where: str) -> None:
    """Raises Interrupted for a plot that was stopped, saying what became of the pen."""
    if result.outcome == "done":
        return
    report = result.stop
    pen = "the pen is up" if report is not None and report.pen_up else "THE PEN MAY BE DOWN: lift it by hand"
    raise Interrupted(f"{result.reason}: {where} after {result.progress.strokes_done} strokes; {pen} and the motors are off")
