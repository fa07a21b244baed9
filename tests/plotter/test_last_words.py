"""What is said when a plot does not come to its end: what was drawn of the whole drawing, where the pen is, how to go on."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from output.ebb.control import StopFlag
from output.ebb.progress import Progress, State
from output.ebb.safe_stop import StopReport
from output.ebb.session import StreamResult, connect
from output.errors import BoardRefused, LinkLost
from plotter.board_setup import board_setup
from plotter.cli import parts
from plotter.cli.main import run
from plotter.cli.parts import plot_in_parts
from plotter.cli.say import Bar
from plotter.cli.streaming import Ended, finish, told_how_to_go_on
from plotter.errors import Interrupted, Paused
from plotter.journals import Part
from tests.output.board_in_memory import MemoryBoard
from tests.output.inline_producer import inline_producer  # noqa: F401 - a fixture
from tests.plotter.test_pauses import job_of

pytestmark = pytest.mark.usefixtures("inline_producer")

# Two strokes were drawn before; the carriage was pushed home.
RESUMED = Part(2, 0.0, (0.0, 0.0), (0.0, 0.0), True)


def plotted(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    operator: Callable[[MemoryBoard, StopFlag], None],
    part: Part | None = None,
    resumable: bool = True,
) -> Ended:
    job, memory, flags = job_of(tmp_path, "3.0.3"), MemoryBoard(), []

    @contextlib.contextmanager
    def keys(stop: StopFlag) -> Iterator[bool]:
        flags.append(stop)
        yield True

    monkeypatch.setattr(parts, "keys", keys)
    board = connect(memory, clock=memory.clock)
    memory.on_receive = lambda memory: operator(memory, flags[0]) if flags else None
    setup = board_setup(job.settings, job.machine, board.firmware)
    with told_how_to_go_on(lambda: resumable):
        return plot_in_parts(board, job, setup, None, part)


def pull_at(time_s: float) -> Callable[[MemoryBoard, StopFlag], None]:
    def pull(memory: MemoryBoard, _stop: StopFlag) -> None:
        memory.gone = memory.gone or memory.clock() > time_s

    return pull


def test_a_link_that_is_lost_in_a_pause_has_left_the_pen_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def pause_and_pull(memory: MemoryBoard, stop: StopFlag) -> None:
        if stop.pause_reason is None and memory.clock() > 3.0:
            stop.pause("paused by key")
        memory.gone = memory.gone or memory.clock() > 8.0

    with pytest.raises(LinkLost) as lost:
        plotted(tmp_path, monkeypatch, pause_and_pull)
    assert "the plot was paused with the pen up" in str(lost.value)
    assert "by hand" not in str(lost.value)


def test_a_link_that_is_lost_in_a_stroke_may_have_left_it_down(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(LinkLost, match=r"may be down: lift it by hand; .* `plotter resume` goes on, or asks for home$"):
        plotted(tmp_path, monkeypatch, pull_at(3.0))
    with pytest.raises(LinkLost, match=r"lift it by hand$"):
        plotted(tmp_path, monkeypatch, pull_at(3.0), resumable=False)


def test_what_was_drawn_before_a_resume_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(LinkLost, match="2 strokes were drawn for certain"):
        plotted(tmp_path, monkeypatch, pull_at(1.0), RESUMED)

    def stop_soon(memory: MemoryBoard, stop: StopFlag) -> None:
        if memory.clock() > 1.0 and not stop.requested:
            stop.stop("stopped by key")

    ended = plotted(tmp_path, monkeypatch, stop_soon, RESUMED)
    with pytest.raises(Interrupted, match="stopped by key: x after 2 strokes"):
        finish(ended, "x")


def test_the_bar_counts_the_whole_drawing(monkeypatch: pytest.MonkeyPatch) -> None:
    class Shown:
        described = ""

        def start(self) -> None: ...

        def update(self, _task: object, *, description: str, **_others: Any) -> None:
            self.described = description

    monkeypatch.setattr("plotter.cli.say.in_front", lambda _terminal: True)
    bar, shown = Bar([1.0, 1.0]), Shown()
    bar.progress, bar._task, bar.drawn_before = shown, 0, 2  # type: ignore[assignment]
    for done, words in ((0, "stroke 3 of 4"), (1, "stroke 4 of 4"), (2, "stroke 4 of 4")):
        bar.show(replace(Progress(), strokes_done=done, state=State.RUNNING), StopFlag())
        assert shown.described == words


@pytest.mark.parametrize("event", ["power", "reboot"])
def test_a_position_that_is_lost_is_not_looked_for_by_the_counters(
    event: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    happened: list[float] = []

    def happen(memory: MemoryBoard, _stop: StopFlag) -> None:
        if not happened and memory.clock() > 3.0:
            happened.append(memory.clock())
            if event == "power":
                memory.board.switch_supply(False)
            else:
                memory.board.reboot()
                memory.board.usb_dropped = False

    with pytest.raises(BoardRefused) as refused:
        plotted(tmp_path, monkeypatch, happen)
    told = str(refused.value)
    assert told.endswith("run `plotter align` and push the carriage to its home corner, then `plotter resume --homed`")
    assert "check " in told
    happened.clear()
    with pytest.raises(BoardRefused, match=r"push the carriage to its home corner$"):
        plotted(tmp_path, monkeypatch, happen, resumable=False)


def test_ctrl_c_while_the_drawing_is_read_is_answered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("plotter.pipeline.read_drawing", interrupted)
    (tmp_path / "a.svg").write_text("<svg/>")
    assert run(["plot", str(tmp_path / "a.svg"), "--port", "sim"]) == 130
    assert capsys.readouterr().err.split("\n") == ["", "plotter: interrupted", ""]


def ended_as(outcome: str, **result: Any) -> Ended:
    return Ended(StreamResult(outcome, "stopped by key", Progress(), None, **result), Progress(strokes_done=1), 1.0)


@pytest.mark.parametrize("outcome", ["paused", "left", "held"])
def test_a_plot_that_ends_in_a_pause_has_its_pen_up_and_its_motors_on(outcome: str) -> None:
    with pytest.raises(Paused, match=r"x after 1 stroke; the pen is up and the motors hold: `plotter resume` goes on$"):
        finish(ended_as(outcome), "x")
    told = r"the pen is up and the motors hold; a file cannot be resumed: `plotter home` .* `plotter disable` lets go of it$"
    with pytest.raises(Paused, match=told):
        finish(ended_as(outcome), "x", not_resumed="a file")
    with pytest.raises(Interrupted, match=r"stopped by Ctrl-C: x after 1 stroke; the pen is up$"):
        finish(ended_as(outcome), "x", not_resumed="a file", board_stays=False)


def test_an_end_that_nobody_knows_is_no_stop() -> None:
    with pytest.raises(ValueError, match="'gone' is no way"):
        finish(ended_as("gone"), "x")


def test_what_the_board_has_not_confirmed_is_not_said_of_pen_and_motors() -> None:
    """It answered nothing: the motors may be on as well as the pen down."""
    unconfirmed = StopReport(False, None, 0.5, "it answers nothing")
    for not_resumed, after in (("", "then `plotter resume --homed` to go on with it"), ("a file", "before the next plot")):
        with pytest.raises(Interrupted) as told:
            finish(ended_as("stopped", stop=unconfirmed), "x", not_resumed=not_resumed)
        assert "THE PEN MAY BE DOWN: lift it by hand" in str(told.value)
        assert "the motors may be on: run `plotter align`, push the carriage to its home corner" in str(told.value)
        assert "are off" not in str(told.value)
        assert str(told.value).endswith(after)
