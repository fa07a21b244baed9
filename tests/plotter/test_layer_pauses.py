"""A layer's own pause is made once, however the plot is paused, left and gone on with around it."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from output.ebb.control import StopFlag
from output.ebb.journal import Journal, load
from output.ebb.session import connect
from plotter.board_setup import board_setup
from plotter.cli import parts
from plotter.cli.parts import plot_in_parts
from plotter.cli.streaming import Ended
from plotter.journals import Part
from plotter.pipeline import Job
from tests.output.board_in_memory import MemoryBoard
from tests.output.inline_producer import inline_producer  # noqa: F401 - a fixture
from tests.plotter.test_pauses import Operator, check_whole, job_of, plotted

pytestmark = pytest.mark.usefixtures("inline_producer")

LAYERS = """<svg xmlns="http://www.w3.org/2000/svg" xmlns:i="http://www.inkscape.org/namespaces/inkscape" stroke="black"
  width="290mm" height="200mm" viewBox="0 0 290 200" fill="none"><g i:groupmode="layer" i:label="1"><path d="M10 10h20"/></g>
  <g i:groupmode="layer" i:label="!2"><path d="M250 180h20"/><path d="M250 170h20"/></g>
  <g i:groupmode="layer" i:label="!3"><path d="M20 20h20"/></g></svg>"""


class InTravel(Operator):
    """Presses the key a moment after the layer's first pause was ended: on the way to its first stroke."""

    def __call__(self, memory: MemoryBoard) -> None:
        before = len(self.rests)
        super().__call__(memory)
        if before == 0 and self.rests and self._began is not None:
            self.at_s = [memory.clock() - self._began + 0.25]


@pytest.mark.parametrize("key", ["p", "h"])
def test_a_pause_on_the_way_from_it(
    key: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    job, memory, operator = job_of(tmp_path, "3.0.3", LAYERS), MemoryBoard(), InTravel([], key=key)
    assert plotted(job, memory, operator, monkeypatch).result.outcome == "done"
    check_whole(memory, job)
    where, _, when = pauses(capsys)
    assert where.startswith("next: !2")
    assert when.startswith("next: !3")
    assert len(operator.rests) == 3


def pauses(capsys: pytest.CaptureFixture[str]) -> list[str]:
    return [line for line in capsys.readouterr().err.splitlines() if line.startswith(("next", "paused"))]


def unattended(
    job: Job, memory: MemoryBoard, journal: Path, part: Part | None, monkeypatch: pytest.MonkeyPatch, *, leave: bool = True
) -> tuple[Ended, Part | None]:
    """Without a terminal: Ctrl-C in a pause of the drawing's own, or in that before the part has begun, ends the plot there."""
    flags: list[StopFlag] = []

    @contextlib.contextmanager
    def no_keys(stop: StopFlag) -> Iterator[bool]:
        flags.append(stop)
        yield False

    def interrupt(_memory: MemoryBoard) -> None:
        if leave and flags and flags[0].pause_reason is not None and flags[0].pause_signal is None:
            flags[0].pause(flags[0].pause_reason, signal.SIGINT)

    monkeypatch.setattr(parts, "keys", no_keys)
    memory.on_receive = interrupt
    board = connect(memory, clock=memory.clock, clear=False)
    setup = board_setup(job.settings, job.machine, board.firmware)
    with Journal.begin(journal, {}) as kept:
        ended = plot_in_parts(board, job, setup, kept, part)
    state = load(journal)
    assert state is not None
    return ended, Part.of(state.part)


@pytest.mark.parametrize("drawing", [LAYERS, LAYERS.replace('"!2">', '"!wash"/><g i:groupmode="layer" i:label="2">')])
def test_ended_in_it_without_a_terminal_and_resumed(drawing: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody could go on from it: the same pause again would be the end of every resume. It may be an empty layer's."""
    job, memory, part = job_of(tmp_path, "3.0.3", drawing), MemoryBoard(), None
    outcomes = []
    for _ in range(3):
        ended, part = unattended(job, memory, tmp_path / "journal", part, monkeypatch)
        outcomes.append(ended.result.outcome)
    assert outcomes == ["paused", "paused", "done"]
    check_whole(memory, job)
