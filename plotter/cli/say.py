"""What a person is told besides the result: notes on stderr, and progress when stderr is a terminal."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from typing import TYPE_CHECKING

import click
import numpy as np

from output.ebb.control import StopFlag
from output.ebb.progress import Progress as StreamProgress
from output.ebb.progress import State
from plotter.cli.standard_streams import aside, in_front, in_time
from plotter.units import spoken_duration

if TYPE_CHECKING:
    from rich.progress import Progress

# The message of a pause at the home position.
AT_HOME = "paused at home"


def notes(sentences: Iterable[str]) -> None:
    """Each sentence once, on stderr."""
    for sentence in dict.fromkeys(sentences):
        aside(f"note: {sentence}")


def meanwhile(sentence: str) -> None:
    """What is being done while nothing moves, for somebody who waits for it at a terminal."""
    if sys.stderr.isatty():
        aside(sentence)


def ways_on(stop: StopFlag) -> str:
    """What can be pressed in its pause."""
    home = "h goes home, " if stop.knows_home and stop.pause_reason != AT_HOME else ""
    return f"p or the board's button goes on, {home}q or Ctrl-C ends the plot"


def passed_over(message: str) -> str:
    """What is said of a pause that nobody could end."""
    return f"the pause '{message}' is passed over: nobody is at a keyboard"


class Bar:
    """A progress bar on stderr, when that is a terminal and while it is ours: strokes done and board time left.

    `guess_s` is a guess for each stroke with its travel and lifts; it is corrected by how long the strokes done have taken.
    """

    def __init__(self, guess_s: Sequence[float]) -> None:
        self.expect(guess_s)
        self._paused = ""
        self.drawn_before = 0  # strokes of the drawing that are none of this run's
        self.without_keys = ""  # where no key can be pressed, what Ctrl-C does in a pause
        self.progress: Progress | None = None
        if sys.stderr.isatty():
            self.progress = _drawn_bar()
            self._task = self.progress.add_task("plotting", total=1.0, left="")
        self._drawn = False

    def expect(self, guess_s: Sequence[float]) -> None:
        """How long the strokes take: what is known by now."""
        self._until_s = np.concatenate(([0.0], np.cumsum(np.asarray(guess_s, dtype=np.float64))))
        self._strokes = len(guess_s)

    def left_s(self, done: StreamProgress) -> float:
        """Board time left: what was guessed for the strokes to come, scaled by guess and truth of those done."""
        at = min(done.strokes_done, self._strokes)
        guessed_s, all_s = float(self._until_s[at]), float(self._until_s[-1])
        pace = done.board_time_s / guessed_s if guessed_s else 1.0
        return max(all_s * pace - done.board_time_s, 0.0)

    def show(self, done: StreamProgress, stop: StopFlag) -> None:
        """Called by the stream; must never fail for a terminal that went away. By what `stop` was asked for, a pause
        that is left as soon as it begins is not told, and the bar is taken away for the shell."""
        paused = done.message if done.state is State.PAUSED else ""
        try:
            if paused and paused != self._paused and not stop.leave_asked:
                keyless = f"the board's button goes on, {self.without_keys}"
                self.tell(f"{paused}: {keyless if self.without_keys else ways_on(stop)}")
            self._paused = paused
            if self.progress is not None:
                left_s = self.left_s(done)
                share = done.board_time_s / max(done.board_time_s + left_s, 1e-9)
                layer = f"{done.layer.name}: " if done.layer is not None else ""
                stroke = self.drawn_before + min(done.strokes_done + 1, self._strokes)
                text = f"{layer}stroke {stroke} of {self.drawn_before + self._strokes}"
                pausing = done.message or stop.pause_reason is not None
                left = "paused" if paused else "pausing" if pausing else f"{spoken_duration(left_s)} left"
                self.progress.update(self._task, description=text, completed=share, left=left)
                self.draw(in_front(sys.stderr.fileno()) and not (paused and stop.suspend_asked))
        except OSError:
            self.progress = None

    def draw(self, wanted: bool) -> None:
        """Draws the bar from now on, or takes it away: in the background it would be drawn over what is typed there."""
        if self.progress is not None and wanted != self._drawn:
            self._drawn = wanted
            in_time(self.progress.start if wanted else self.progress.stop)

    def tell(self, sentence: str) -> None:
        """A line on stderr, above the bar where there is one. Raises OSError when the terminal is gone."""
        if self.progress is None:
            in_time(lambda: click.echo(sentence, err=True))
        else:
            above = partial(self.progress.console.print, markup=False, highlight=False, soft_wrap=True)
            in_time(lambda: above(sentence))


def _drawn_bar() -> Progress:
    # Loaded where there is a terminal to draw on only: it takes as long as reading 10,000 strokes.
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn

    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TextColumn("{task.fields[left]}"),
        console=Console(file=sys.stderr),
        transient=True,
        redirect_stdout=False,  # what is said there is said when the bar has gone, and may go elsewhere
    )


@contextmanager
def progress_bar(guess_s: Sequence[float]) -> Iterator[Bar]:
    """A bar on stderr while the context lasts, when stderr is a terminal."""
    bar = Bar(guess_s)
    bar.draw(bar.progress is not None and in_front(sys.stderr.fileno()))
    try:
        yield bar
    finally:
        with suppress(OSError):  # the terminal may have been closed meanwhile
            bar.draw(False)
