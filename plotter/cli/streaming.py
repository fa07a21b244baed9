"""What plot, send and resume share: a program streamed with a progress bar and keys, and how it ended."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial

import numpy as np

from output.ebb.control import StopFlag, signals_end_here
from output.ebb.program import Program
from output.ebb.progress import Progress
from output.ebb.safe_stop import StopReport
from output.ebb.session import Board, StreamResult
from output.errors import LinkLost, PositionLost
from output.wording import counted
from planning.ordering.opening import Pace
from plotter.cli.keys import keys
from plotter.cli.say import progress_bar
from plotter.errors import Interrupted, Paused
from plotter.pipeline import Job, stroke_guess_s

# How a plot goes on whose motors have let go, and what else comes after it.
_PUSH_HOME = "push the carriage to its home corner"
FROM_HOME = f"{_PUSH_HOME}, then `plotter resume --homed`"
# What cannot be resumed for want of a journal.
WITHOUT_JOURNAL = "a plot without a journal"


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
    """Stream a program that is sent as it is, with a progress bar and keys; Ctrl-C stops it. Nobody knows where its home is."""
    stop, started = StopFlag(), time.monotonic()
    stop.knows_home = False
    with signals_end_here(stop), progress_bar(guess_s) as bar, keys(stop) as listening:
        bar.without_keys = "" if listening else "Ctrl-C ends it"
        result = board.stream(items, on_progress=partial(bar.show, stop=stop), stop=stop)
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
            error.args = (f"{error}; once the board can be reached again, `plotter resume` goes on, or asks for home",)
        raise


def finish(ended: Ended, where: str, *, not_resumed: str = "", board_stays: bool = True) -> None:
    """Raises Paused or Interrupted for a plot that did not come to its end: what became of pen and motors, and what next.

    `not_resumed` names what it is, where that cannot be resumed. Without `board_stays`, as the built-in virtual board goes with
    this program, there is nothing to be done.
    """
    result = ended.result
    if result.outcome == "done":
        return
    so_far = f"{where} after {counted(ended.drawn_before + ended.total.strokes_done, 'stroke')}"
    if result.outcome == "stopped":
        raise Interrupted(f"{result.reason}: {so_far}; {_after_a_stop(result.stop, not_resumed, board_stays)}")
    if result.outcome not in ("paused", "left", "held"):
        raise ValueError(f"{result.outcome!r} is no way for a plot to end")
    if not board_stays:
        raise Interrupted(f"stopped by Ctrl-C: {so_far}; the pen is up")
    after = ": `plotter resume` goes on"
    if not_resumed:
        after = f"; {not_resumed} cannot be resumed: `plotter home` brings the carriage home, `plotter disable` lets go of it"
    raise Paused(f"paused: {so_far}; the pen is up and the motors hold{after}")


def _after_a_stop(report: StopReport | None, not_resumed: str, board_stays: bool) -> str:
    """What the board has confirmed, and the next step."""
    after = f"{_PUSH_HOME} before the next plot" if not_resumed else f"{FROM_HOME} to go on with it"
    if report is not None and report.pen_up:
        return "the pen is up and the motors are off" + (f": {after}" if board_stays else "")
    return (
        "THE PEN MAY BE DOWN: lift it by hand; the board has not confirmed the stop, so that the motors may be on: "
        f"run `plotter align`, {after}"
    )
