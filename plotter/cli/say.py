"""What a person is told besides the result: notes on stderr, and progress when stderr is a terminal."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

import click
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn

from output.ebb.board_time import board_time_s
from output.ebb.commands import Command
from output.ebb.program import Mark
from output.ebb.stream import Progress as StreamProgress
from plotter.units import spoken_duration


def notes(sentences: Iterable[str]) -> None:
    """Each sentence once, on stderr."""
    for sentence in dict.fromkeys(sentences):
        click.echo(f"note: {sentence}", err=True)


class Bar:
    """A progress bar in board time: how much of the plot the board has executed, and how long the rest takes."""

    def __init__(self, total_strokes: int) -> None:
        self.total_strokes = total_strokes
        self.progress: Progress | None = None
        self.total_s = 0.0
        self._planned = False
        if sys.stderr.isatty():
            self.progress = Progress(
                TextColumn("{task.description}"),
                BarColumn(),
                TaskProgressColumn(),
                TextColumn("{task.fields[left]}"),
                console=Console(file=sys.stderr),
                transient=True,
            )
            self._task = self.progress.add_task("plotting", total=max(total_strokes, 1), left="")

    def watch(self, items: Iterable[Command | Mark]) -> Iterator[Command | Mark]:
        """The same items, adding up their board time: the bar counts strokes until all is planned, and time from then on."""
        total_s = 0.0
        for item in items:
            if isinstance(item, Command):
                total_s += board_time_s(item)
            yield item
        self.total_s, self._planned = total_s, True

    def show(self, done: StreamProgress) -> None:
        """Called by the stream; must never fail for a terminal that went away."""
        if self.progress is None:
            return
        name = done.layer.name if done.layer is not None else ""
        text = f"{name} stroke {min(done.strokes_done + 1, self.total_strokes)} of {self.total_strokes}"
        try:
            if self._planned:
                left = f"{spoken_duration(max(self.total_s - done.board_time_s, 0.0))} left"
                total, completed = max(self.total_s, 1e-9), done.board_time_s
            else:
                left, total, completed = "planning ahead", float(max(self.total_strokes, 1)), float(done.strokes_done)
            self.progress.update(self._task, description=text, total=total, completed=completed, left=left)
        except OSError:
            self.progress = None


@contextmanager
def progress_bar(total_strokes: int) -> Iterator[Bar]:
    """A bar on stderr while the context lasts, when stderr is a terminal."""
    bar = Bar(total_strokes)
    if bar.progress is None:
        yield bar
        return
    with bar.progress:
        yield bar
