"""Plotting in parts: from the beginning, or from where a pause on the path, or an interruption, has left the pen.

    part --stream--> done
                 `-> held: the pen rests on the path, up --journal the place--> next part --PauseMark, go--> stream ...

Every part is a program of its own whose facts are in the journal, so that a plot that is killed in a pause, or after one, is
resumed like any other. The pause itself is the streamer's, before the part's first command.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import numpy as np

from output.ebb.commands import Command
from output.ebb.control import StopFlag, signals_end_here
from output.ebb.encode import BoardSetup, encode, prologue
from output.ebb.held import PausableProgram
from output.ebb.journal import Journal
from output.ebb.program import Mark, PauseMark
from output.ebb.progress import Progress, State
from output.ebb.session import Board, StreamResult
from planning.motion.plan import Action, OperatorPause, Travel
from planning.motion.travel import travel
from plotter.board_setup import HOME_MM
from plotter.cli.keys import keys
from plotter.cli.say import AT_HOME, Bar, notes, passed_over, progress_bar
from plotter.cli.start import must_still_be_wanted
from plotter.cli.streaming import Ended, guesses_s
from plotter.journals import Part, layers_left, part_actions, part_after, part_beginning, position_mm
from plotter.pipeline import Job, motion_settings


def plot_in_parts(
    board: Board, job: Job, setup: BoardSetup, journal: Journal | None, part: Part | None, *, pauses: bool = True
) -> Ended:
    """Draw what is left from `part` on (None: everything), with a progress bar, keys and pauses.

    `pauses` False passes over the drawing's own pauses: nobody could end them. The first Ctrl-C pauses; where there is no
    terminal to go on from, the plot ends there as "paused".
    """
    must_still_be_wanted()
    stop, started, total = StopFlag(), time.monotonic(), Progress()
    settings = motion_settings(job.settings, job.machine)
    drawn_before = 0 if part is None else part.stroke
    outlook = _Outlook(job, drawn_before)
    with signals_end_here(stop, pauses=True), progress_bar(outlook.guesses_s()) as bar, keys(stop) as listening:
        bar.drawn_before = drawn_before
        stop.unattended = not listening
        bar.without_keys = "" if listening else "Ctrl-C ends the plot in the pause"
        while True:
            _note_part(board, journal, part)
            actions = part_actions(job, part)
            items = PausableProgram(
                _beginning(setup, part, stop),
                actions if pauses else _without_pauses(actions),
                setup,
                settings.draw,
                settings.travel,
                settings.pen.lift_s,
            )
            show = partial(_show, bar, outlook, stop, total)
            drawn = drawn_before + total.strokes_done
            result = board.stream(items, on_progress=show, stop=stop, journal=journal, hold=items.hold, drawn_before=drawn)
            total = _together(total, result.progress)
            if result.outcome == "held" and items.place is not None:
                part = part_after(setup, part, items.place, pause_over=True)  # it was travelled to that stroke
                if layers_left(job.ordering, part)[1] > part.stroke:  # it came to rest on the stroke's very end
                    total = replace(total, strokes_done=total.strokes_done + 1)
            elif result.outcome == "left" and result.steps is not None:
                part = _part_left(job, setup, part, result.progress, result.steps)
            else:
                break
            if _ends_here(stop):
                _note_part(board, journal, part)
                result = replace(result, outcome="paused")
                break
            if stop.home_asked:
                with suppress(OSError):  # the terminal may have been closed meanwhile
                    bar.tell("the pen is up: going home")
                _note_part(board, journal, part)  # on the way, nothing of it having been sent
                way = _go_home(board, setup, job, part, stop)
                if way.outcome != "done":
                    result = way
                    break
                part = replace(part, start_mm=(0.0, 0.0))
    if journal is not None:
        journal.end(result.outcome, result.steps)
    return Ended(result, total, time.monotonic() - started, drawn_before)


def _note_part(board: Board, journal: Journal | None, part: Part | None) -> None:
    if journal is not None:
        facts = {} if part is None else asdict(part)
        port = Path(board.port_name)
        place = str(port.absolute()) if port.exists() else board.port_name
        board_facts = {"firmware": board.firmware, "nickname": board.nickname() or "", "port": place}
        journal.part({**facts, "token": board.begin_job(), **board_facts})


def _beginning(setup: BoardSetup, part: Part | None, stop: StopFlag) -> Iterator[Command | Mark]:
    """A part that follows a pause waits for go before anything is sent."""
    if stop.pause_reason is not None:
        yield PauseMark(stop.pause_reason)
    yield from part_beginning(setup, part)


class _Outlook:
    """What the bar expects of the strokes from number `first` on: a guess, until the order of all of them is found."""

    def __init__(self, job: Job, first: int) -> None:
        self._job = job
        self._first = first
        self._complete = job.ordering.complete

    def guesses_s(self) -> list[float]:
        return guesses_s(self._job)[self._first :]

    def tell(self, bar: Bar) -> None:
        """Once, when everything is known."""
        if not self._complete and self._job.ordering.complete:
            self._complete = True
            bar.expect(self.guesses_s())


def _show(bar: Bar, outlook: _Outlook, stop: StopFlag, before: Progress, progress: Progress) -> None:
    outlook.tell(bar)
    if progress.state is State.PAUSED and _ends_here(stop):
        stop.leave()
    bar.show(_together(before, progress), stop)


def _ends_here(stop: StopFlag) -> bool:
    """Ctrl-C with no terminal: nobody could press a key to go on."""
    return stop.pause_signal is not None and stop.pause_reason is not None and stop.unattended


def _together(before: Progress, progress: Progress) -> Progress:
    """Progress of a part as progress of all parts since the program was started."""
    sums = ("commands_sent", "commands_executed", "strokes_done", "board_time_s", "stalls", "stalled_s")
    changes = {name: getattr(before, name) + getattr(progress, name) for name in sums}
    return replace(progress, layer=progress.layer or before.layer, **changes)


def _part_left(job: Job, setup: BoardSetup, part: Part | None, progress: Progress, steps: tuple[int, int]) -> Part:
    """What is left when a part is left in a pause between strokes: in the drawing's own one before its next stroke, or after
    that, or before the part has begun."""
    here = position_mm(setup, steps)
    first = 0 if part is None else layers_left(job.ordering, part)[1]
    if part is not None and progress.strokes_done == 0:
        begun = progress.layer is not None
        return replace(part, start_mm=here, homed=False, pause_over=part.pause_over or begun)
    return Part(first + progress.strokes_done, 0.0, here, here, False, pause_over=True)


def _go_home(board: Board, setup: BoardSetup, job: Job, part: Part, stop: StopFlag) -> StreamResult:
    """Travel home from where the part begins, and stay in the pause. The carriage is there only when that is "done"."""
    settings = motion_settings(job.settings, job.machine)
    way = travel(np.array(part.start_mm), HOME_MM, settings.travel, settings.kinematics, settings.bounds_mm)
    stop.home_asked = stop.leave_asked = False

    def items() -> Iterator[Command | Mark]:
        yield from prologue(setup, keep_counters=True)
        yield from encode([Travel(way)], setup)

    result = board.stream(items(), on_progress=lambda _: None, stop=stop, drawn_before=part.stroke)
    if stop.pause_reason is not None:  # else the operator has said go meanwhile
        stop.pause(AT_HOME, stop.pause_signal)
    return result


def _without_pauses(actions: Iterator[Action]) -> Iterator[Action]:
    """A virtual board with nobody at a keyboard: a pause would never end, so it is said, once for each, and passed over."""
    said: set[str] = set()
    for action in actions:
        if not isinstance(action, OperatorPause):
            yield action
        elif action.message not in said:
            said.add(action.message)
            notes([passed_over(action.message)])
