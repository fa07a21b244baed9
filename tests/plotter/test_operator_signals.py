"""Signals that come late or often: between the streams of a plot and in its last moments they take nothing away."""

from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from output.ebb.control import StopFlag
from output.ebb.journal import Journal, load
from output.ebb.session import connect
from plotter.board_setup import board_setup
from plotter.cli import parts
from plotter.cli.parts import plot_in_parts
from plotter.cli.streaming import Ended
from tests.output.board_in_memory import MemoryBoard
from tests.output.inline_producer import inline_producer  # noqa: F401 - a fixture
from tests.plotter.test_pauses import Operator, job_of

pytestmark = pytest.mark.usefixtures("inline_producer")


def ctrl_c() -> None:
    os.kill(os.getpid(), signal.SIGINT)


def plotted(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    *,
    listening: bool = True,
    on_receive: Callable[[MemoryBoard, StopFlag], None] = lambda _memory, _stop: None,
    at_the_end: Callable[[], None] = lambda: None,
) -> tuple[Ended, MemoryBoard]:
    """A plot on a board in memory. `on_receive` is called where the stream waits, `at_the_end` while the keys are put away."""
    job, memory, flags = job_of(tmp_path, "3.0.3"), MemoryBoard(), []

    @contextlib.contextmanager
    def keys(stop: StopFlag) -> Iterator[bool]:
        flags.append(stop)
        yield listening
        at_the_end()

    monkeypatch.setattr(parts, "keys", keys)
    board = connect(memory, clock=memory.clock)
    memory.on_receive = lambda memory: on_receive(memory, flags[0]) if flags else None
    with Journal.begin(tmp_path / "journal", {}) as journal:
        ended = plot_in_parts(board, job, board_setup(job.settings, job.machine, board.firmware), journal, None)
    state = load(tmp_path / "journal")
    assert state is not None
    assert state.ended == ended.result.outcome
    return ended, memory


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("stopped", [True, False])
def test_in_the_last_moments_signals_are_ignored(
    stopped: bool, number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The stream is over; the keys are put away, the journal is ended, and something is still to be said."""

    def stop_soon(memory: MemoryBoard, stop: StopFlag) -> None:
        if stopped and memory.clock() > 3.0 and not stop.requested:
            stop.stop("stopped by key")

    ended, memory = plotted(tmp_path, monkeypatch, on_receive=stop_soon, at_the_end=lambda: os.kill(os.getpid(), number))
    os.kill(os.getpid(), number)  # while the last message is being said
    assert ended.result.outcome == ("stopped" if stopped else "done")
    assert ended.result.reason == ("stopped by key" if stopped else "")
    assert memory.board.state()["pen_up"]


def test_a_hangup_that_is_ignored_does_not_end_a_plot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By nohup: the terminal may go."""
    signal.signal(signal.SIGHUP, signal.SIG_IGN)

    def hang_up(memory: MemoryBoard, _stop: StopFlag) -> None:
        if memory.clock() > 3.0:
            os.kill(os.getpid(), signal.SIGHUP)

    ended, _ = plotted(tmp_path, monkeypatch, on_receive=hang_up)
    assert ended.result.outcome == "done"


def test_ctrl_c_between_two_streams_of_a_plot_stops_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A pause has just brought the pen to rest; the part that follows is being noted."""
    operator, note, noted = Operator([3.0]), parts._note_part, []

    def note_and_be_interrupted(*arguments: object) -> None:
        note(*arguments)  # type: ignore[arg-type]
        noted.append(arguments)
        if len(noted) == 2:
            ctrl_c()

    def press(memory: MemoryBoard, stop: StopFlag) -> None:
        operator.stop = stop
        operator(memory)

    monkeypatch.setattr(parts, "_note_part", note_and_be_interrupted)
    ended, memory = plotted(tmp_path, monkeypatch, on_receive=press)
    assert len(noted) == 2
    assert (ended.result.outcome, ended.result.reason) == ("stopped", "stopped by Ctrl-C")
    assert memory.board.state()["pen_up"]


@pytest.mark.parametrize("times", [1, 2])
def test_ctrl_c_in_a_pause_that_nobody_can_leave_by_key_ends_the_plot_there(
    times: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """After the board's button, with no terminal: motors on, so that it can be resumed. The second one stops, as ever."""
    pressed: list[float] = []

    def press(memory: MemoryBoard, _stop: StopFlag) -> None:
        if not pressed and memory.clock() > 3.0:
            pressed.append(memory.clock())
            memory.board.press_button()
        elif len(pressed) == 1 and memory.clock() > pressed[0] + 4.0:
            pressed.append(memory.clock())
            for _ in range(times):
                ctrl_c()

    ended, memory = plotted(tmp_path, monkeypatch, listening=False, on_receive=press)
    assert ended.result.outcome == ("paused" if times == 1 else "stopped")
    assert memory.board.state()["pen_up"]
    assert all(memory.board.state()["motors_on"]) == (times == 1)
    said = capsys.readouterr().err
    assert said == "the board's button was pressed: the board's button goes on, Ctrl-C ends the plot in the pause\n"
