"""Pauses on the path: the pen slows down where it is, lifts, and comes back to that point; the drawing is whole afterwards."""

from __future__ import annotations

import contextlib
import random
import re
import signal
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from output.ebb.command_file import read_command_file
from output.ebb.control import StopFlag
from output.ebb.firmware import firmware as firmware_named
from output.ebb.gates import LEAD_S
from output.ebb.held import PausableProgram
from output.ebb.journal import Journal, load
from output.ebb.resume import position_lost
from output.ebb.session import connect
from output.ebb.verify import Report, verify
from output.ebb.verify_compare import compare
from output.errors import BoardRefused, LinkLost
from plotter.board_setup import board_setup
from plotter.cli import parts
from plotter.cli.keys import press
from plotter.cli.parts import plot_in_parts
from plotter.cli.plot import ink_mm
from plotter.cli.resume import _place as find_left
from plotter.cli.streaming import Ended, finish
from plotter.errors import Interrupted
from plotter.journals import Part, part_after
from plotter.pipeline import Job, prepare
from plotter.settings import resolve
from plotter.svg.options import ReadOptions
from tests.output.board_in_memory import MemoryBoard
from tests.output.inline_producer import inline_producer  # noqa: F401 - a fixture

pytestmark = pytest.mark.usefixtures("inline_producer")

DRAWING = """<svg xmlns="http://www.w3.org/2000/svg" width="100mm" height="60mm" viewBox="0 0 100 60" stroke="black">
  <path d="M10 10C40 -10 60 50 90 20"/><circle cx="50" cy="30" r="12"/><path d="M12 30h.01"/>
  <path d="M10 50L30 45L50 55L70 45L90 50L10 55L90 58L10 59L20 30L40 10L20 50L60 2"/>
  <path d="M70 8l1 2 1-2 1 2 1-2 1 2 1-2 1 2 1-2 1 2 1-2 1 2 1-2 1 2 1-2 1 2 1-2 1 2 1-2"/></svg>"""
# Every next one at the other end of the machine, so that the order does not matter.
FAR_APART = """<svg xmlns="http://www.w3.org/2000/svg" width="290mm" height="200mm" viewBox="0 0 290 200" stroke="black">
  <path d="M20 20l8 3"/><path d="M262 175l9 2l-5 6"/><path d="M270 20c5 0 5 9 0 9"/><path d="M20 180h5"/>
  <path d="M140 100h.01"/></svg>"""
DENSE = (
    FAR_APART.splitlines()[0]
    + '<path d="M10 10'
    + "".join(f"L{10 + 0.12 * k:.2f} {10 + 0.25 * (k % 2) + 0.02 * k:.2f}" for k in range(400))
    + '"/><path d="M10 40'
    + "".join(f"q0.5 {1.2 if k % 2 else -1.2} 1 0" for k in range(60))
    + '"/></svg>'
)
# Round and round, each lap an eighth of a millimetre outside the one before.
LAPS = DRAWING.splitlines()[0].replace("<svg", '<svg fill="none"') + (
    '<path d="M'
    + " ".join(f"{40 + (8 + 0.002 * t) * np.cos(t / 10):.3f},{30 + (8 + 0.002 * t) * np.sin(t / 10):.3f}" for t in range(500))
    + '"/></svg>'
)
# The pen comes to rest within the motion on the board, what braking takes, and the lift.
LATEST_S = LEAD_S + 1.0


class Operator:
    """Presses keys at given times of the board's clock, and goes on when the pen has been up and still for a while."""

    def __init__(self, at_s: list[float], key: str = "p") -> None:
        self.at_s = sorted(at_s)
        self.key = key
        self.stop: StopFlag | None = None
        self.rests: list[tuple[int, int]] = []
        self.latency_s: list[float] = []
        self._began: float | None = None
        self._asked = 0.0
        self._resting: float | None = None

    @contextlib.contextmanager
    def keys(self, stop: StopFlag) -> Iterator[bool]:
        self.stop = stop
        yield True

    def __call__(self, memory: MemoryBoard) -> None:
        if self.stop is None or self.stop.requested:
            return
        now, state = memory.clock(), memory.board.state()
        self._began = now if self._began is None else self._began
        if self.stop.pause_reason is None:
            self._resting = None
            if self.at_s and now - self._began >= self.at_s[0]:
                self.at_s.pop(0)
                self._asked = now
                press(self.key, self.stop)
        elif not (state["pen_up"] and state["idle"]):
            self._resting = None
        elif self._resting is None:
            self._resting = now
        elif now - self._resting > 1.0:
            self.latency_s.append(self._resting - self._asked)
            self.rests.append(tuple(state["position"]))
            self.stop.go()


def job_of(tmp_path: Path, firmware: str, drawing: str = DRAWING, **settings: str) -> Job:
    file = tmp_path / "drawing.svg"
    file.write_text(drawing)
    return prepare(str(file), ReadOptions(), resolve({"firmware": firmware, **settings}).values)


def plotted(
    job: Job, memory: MemoryBoard, operator: Operator, monkeypatch: pytest.MonkeyPatch, part: Part | None = None
) -> Ended:
    monkeypatch.setattr(parts, "keys", operator.keys)
    board = connect(memory, clock=memory.clock)
    memory.on_receive = operator
    return plot_in_parts(board, job, board_setup(job.settings, job.machine, board.firmware), None, part)


def drawn_in(job: Job) -> list[np.ndarray]:
    """The drawing's lines, each (n, 2) in machine millimetres."""
    return [stroke.points_mm for layer in job.layers for stroke in layer.strokes]


def length_mm(lines: list[np.ndarray]) -> float:
    return sum(float(np.hypot(*np.diff(line, axis=0).T).sum()) for line in lines)


def check_whole(memory: MemoryBoard, job: Job) -> list[np.ndarray]:
    """The ink is the drawing, and where the pen was taken up again at most 0.2 mm are drawn twice."""
    ink = ink_mm(memory.record(), job.machine.kinematics())
    wanted = drawn_in(job)
    deviation = compare(ink, wanted)
    assert deviation.drawn.max_mm <= 0.05
    assert deviation.wanted.max_mm <= 0.05
    for before, after in pairwise(ink):
        distance_mm = float(np.hypot(*(after[0] - before[-1])))
        assert distance_mm <= 0.2 or distance_mm > 1.0
    return ink


def replayed(memory: MemoryBoard, job: Job, tmp_path: Path) -> Report:
    """Everything that was sent, judged as one command file."""
    wires = b"".join(data for _, data in memory.written).decode().split("\r")
    file = tmp_path / "sent.ebb"
    file.write_text("\n".join(wire for wire in wires if re.match("(SM|XM|T3|TD|LM|LT|SP|EM|SC),", wire)))
    _, lines = read_command_file(str(file))
    version = firmware_named(job.settings.firmware)
    return verify(list(lines), version, job.machine.kinematics(), travel_mm=(-1, -1, 999, 999), keep_strokes=False)


def check_pauses(
    seed: int,
    firmware: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    drawing: str = DRAWING,
    commands: str = "auto",
) -> None:
    rng = random.Random(seed)
    until_s = 6 if drawing == FAR_APART else 12
    job, memory, operator = (
        job_of(tmp_path, firmware, drawing, commands=commands),
        MemoryBoard(firmware),
        Operator([rng.uniform(0.3, until_s) for _ in range(4)]),
    )
    ended = plotted(job, memory, operator, monkeypatch)
    assert ended.result.outcome == "done"
    assert ended.total.strokes_done == job.stroke_count
    check_whole(memory, job)
    assert max(operator.latency_s) <= LATEST_S
    report = replayed(memory, job, tmp_path)
    # Nothing of the sort that stopping dead from 150 mm/s would be; older firmware has jumps of its own at each command.
    smooth = firmware.startswith("3") and commands == "auto"
    assert report.max_velocity_jump_mm_s <= (1.0 if smooth else 8.0 if commands in ("auto", "lm") else 50.0)
    # Travel keeps its limits for each motor, draws for both together.
    assert report.max_acceleration_mm_s2 <= 1.05 * 2**0.5 * job.settings.travel_acceleration
    state = memory.board.state()
    assert state["pen_up"]
    assert not any(state["motors_on"])


@pytest.mark.parametrize("firmware", ["3.0.3", "3.0.0", "2.8.1"])
@pytest.mark.parametrize("seed", range(4))
def test_pauses_at_random_instants(seed: int, firmware: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    check_pauses(seed, firmware, tmp_path, monkeypatch)


@pytest.mark.parametrize("firmware", ["3.0.3", "3.0.1"])
def test_a_pause_within_a_command_that_slows_down(firmware: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Here a motion is slowed down for the queue, by commands of 100 ms that begin faster than they end."""
    check_pauses(129, firmware, tmp_path, monkeypatch)


@pytest.mark.parametrize(("commands", "firmware"), [("lm", "3.0.3"), ("lm", "2.8.1"), ("xm", "3.0.3"), ("lt", "3.0.3")])
def test_commands_that_end_with_their_last_step_are_paused(
    commands: str, firmware: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By and by the board is some milliseconds ahead of the plan there."""
    for seed in (201, 202):
        check_pauses(seed, firmware, tmp_path, monkeypatch, commands=commands)
        check_pauses(seed, firmware, tmp_path, monkeypatch, FAR_APART, commands)


@pytest.mark.parametrize("seed", [7, 10])
def test_a_dense_drawing_is_held_at_the_speed_that_the_board_has(
    seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Merged pieces cut its zigzags and waves, so that the pen's speed and way are not quite the plan's."""
    check_pauses(seed, "3.0.3", tmp_path, monkeypatch, DENSE)


def test_a_stroke_that_ends_in_the_pause_is_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Here the pen comes to rest nearer to the stroke's end than can be told apart, so that nothing is left of it."""
    check_pauses(127, "2.7.0", tmp_path, monkeypatch)


def test_a_pen_on_its_way_down_is_raised_before_it_draws(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Here the first pause comes while a travel and the lowering at its end are sent: the stroke need not be begun."""
    check_pauses(153, "3.0.3", tmp_path, monkeypatch)


@pytest.mark.parametrize("firmware", ["3.0.3", "3.0.0", "2.8.1"])
@pytest.mark.parametrize("seed", range(2))
def test_a_long_travel_is_paused_on_its_way(seed: int, firmware: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Strokes of which most follow a travel of more than a second."""
    check_pauses(seed, firmware, tmp_path, monkeypatch, FAR_APART)


@pytest.mark.long
@pytest.mark.parametrize("firmware", ["3.0.3", "3.0.1", "3.0.0", "2.8.1", "2.7.0"])
def test_long_travels_are_paused_at_many_random_instants(
    firmware: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for seed in range(100, 130):
        check_pauses(seed, firmware, tmp_path, monkeypatch, FAR_APART)


@pytest.mark.long
@pytest.mark.parametrize("firmware", ["3.0.3", "3.0.1", "3.0.0", "2.8.1", "2.7.0"])
def test_pauses_at_many_random_instants(firmware: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for seed in range(100, 160):
        check_pauses(seed, firmware, tmp_path, monkeypatch)


def test_a_pause_in_one_long_stroke_does_not_wait_for_its_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    spiral = " ".join(f"{50 + 0.06 * t * np.cos(t / 5):.3f},{50 + 0.06 * t * np.sin(t / 5):.3f}" for t in range(600))
    drawing = DRAWING.splitlines()[0].replace("60", "100") + f'<path d="M{spiral}"/></svg>'
    job, memory, operator = job_of(tmp_path, "3.0.3", drawing), MemoryBoard(), Operator([4.0, 12.0])
    assert plotted(job, memory, operator, monkeypatch).result.outcome == "done"
    assert max(operator.latency_s) <= LATEST_S
    assert len(check_whole(memory, job)) == 3


@pytest.mark.parametrize("firmware", ["3.0.3", "2.8.1"])
def test_a_long_line_drawn_slowly_is_paused_on_its_way(firmware: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It takes 25 seconds, at one speed."""
    job = job_of(tmp_path, firmware, FAR_APART.splitlines()[0] + '<path d="M5 5L255 5"/></svg>', draw_speed="10mm/s")
    memory, operator = MemoryBoard(firmware), Operator([5.0, 15.0])
    assert plotted(job, memory, operator, monkeypatch).result.outcome == "done"
    assert max(operator.latency_s) <= LATEST_S
    assert len(check_whole(memory, job)) == 3


def test_h_goes_home_and_waits_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """From strokes and from between them; it is said that it goes home, and once what it waits for there."""
    times_s = [2.0, 4.5, 6.0, 7.2, 8.4, 9.6]
    job, memory, operator = job_of(tmp_path, "3.0.3"), MemoryBoard(), Operator(times_s, key="h")
    ended = plotted(job, memory, operator, monkeypatch)
    assert ended.result.outcome == "done"
    assert operator.rests == [(0, 0)] * len(times_s)
    check_whole(memory, job)
    said = capsys.readouterr().err.splitlines()
    going, waiting = "the pen is up: going home", "paused at home: p or the board's button goes on, q or Ctrl-C ends the plot"
    assert said == [going, waiting] * len(times_s)


@pytest.mark.parametrize("at_s", [2.0, 7.2])
def test_h_in_a_pause_says_where_it_waits_then(
    at_s: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    job, memory, operator = job_of(tmp_path, "3.0.3"), MemoryBoard(), Operator([at_s])
    go = StopFlag.go

    def home_first(stop: StopFlag) -> None:
        if len(operator.rests) > 1:
            go(stop)
        else:
            press("h", stop)
            operator._resting = None

    monkeypatch.setattr(StopFlag, "go", home_first)
    assert plotted(job, memory, operator, monkeypatch).result.outcome == "done"
    check_whole(memory, job)
    assert operator.rests[1] == (0, 0)
    here, going, there = capsys.readouterr().err.splitlines()
    assert here.startswith("paused by key: ")
    assert going == "the pen is up: going home"
    assert there.startswith("paused at home: ")


def test_quitting_in_a_pause_stops_the_motors(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    job, memory, operator = job_of(tmp_path, "3.0.3"), MemoryBoard(), Operator([2.0])
    monkeypatch.setattr(StopFlag, "go", lambda self: press("q", self))
    ended = plotted(job, memory, operator, monkeypatch)
    assert ended.result.outcome == "stopped"
    state: dict[str, Any] = memory.board.state()
    assert state["pen_up"]
    assert not any(state["motors_on"])
    with pytest.raises(Interrupted, match=r"stopped by key: x after \d+ strokes; the pen is up.*`plotter resume --homed`"):
        finish(ended, "x")
    with pytest.raises(Interrupted) as told:
        finish(ended, "x", not_resumed="it")
    assert str(told.value).endswith(
        "the pen is up and the motors are off: push the carriage to its home corner before the next plot"
    )
    with pytest.raises(Interrupted, match=r"the motors are off$"):
        finish(ended, "x", not_resumed="it", board_stays=False)


@pytest.mark.parametrize("at_s", [0.6, 2.5, 4.4])
def test_ctrl_c_without_a_terminal_leaves_a_plot_that_can_be_resumed(
    at_s: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    job, memory = job_of(tmp_path, "3.0.3"), MemoryBoard()
    board = connect(memory, clock=memory.clock)
    setup = board_setup(job.settings, job.machine, board.firmware)
    flags: list[StopFlag] = []

    @contextlib.contextmanager
    def no_keys(stop: StopFlag) -> Iterator[bool]:
        flags.append(stop)
        yield False

    def interrupt(m: MemoryBoard) -> None:
        if flags and m.clock() >= at_s and flags[0].pause_reason is None:
            flags[0].pause("paused by Ctrl-C", signal.SIGINT)

    monkeypatch.setattr(parts, "keys", no_keys)
    memory.on_receive = interrupt
    with Journal.begin(tmp_path / "journal", {}) as journal:
        ended = plot_in_parts(board, job, setup, journal, None)
    assert ended.result.outcome == "paused"
    assert memory.board.state()["pen_up"]
    assert all(memory.board.state()["motors_on"])
    state = load(tmp_path / "journal")
    assert state is not None
    assert state.ended == "paused"
    part = Part.of(state.part)
    assert part is not None
    memory.on_receive = None
    again = plot_in_parts(board, job, setup, None, part)
    assert again.result.outcome == "done"
    check_whole(memory, job)


@pytest.mark.parametrize("at_s", [1.0, 1.3, 1.6])
@pytest.mark.parametrize("after_s", [0.3, 0.9, 1.4, 1.7])
def test_what_was_cut_off_while_a_travel_was_being_held_is_resumed(
    after_s: float, at_s: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The cable is pulled before the place of the hold is in the journal; the board finishes what it has."""
    job, memory, operator = job_of(tmp_path, "3.0.3", FAR_APART), MemoryBoard(), Operator([at_s])
    cut_off(job, memory, operator, after_s, tmp_path, monkeypatch)
    resumed(job, memory, tmp_path)
    check_whole(memory, job)


@pytest.mark.parametrize(
    ("firmware", "at_s", "after_s"), [("2.8.1", 3.0, 0.35), ("2.8.1", 3.0, 0.45), ("3.0.3", 4.0, 1.45), ("3.0.3", 4.0, 1.55)]
)
def test_what_was_cut_off_while_a_stroke_was_being_held_is_resumed(
    firmware: str, at_s: float, after_s: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Lap by lap over nearly the same place, so that a place among the commands that were not sent would do as well."""
    job, memory, operator = job_of(tmp_path, firmware, LAPS), MemoryBoard(firmware), Operator([at_s])
    cut_off(job, memory, operator, after_s, tmp_path, monkeypatch)
    resumed(job, memory, tmp_path)
    check_length(check_whole(memory, job), job)


@pytest.mark.parametrize("firmware", ["3.0.3", "2.8.1"])
@pytest.mark.parametrize("at_s", [9.2, 9.7, 11.0])
def test_what_was_cut_off_where_commands_turn_is_drawn_once(
    at_s: float, firmware: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In small waves one command turns, and is longer than from its start to its end."""
    job, uncut, memory = job_of(tmp_path, firmware, DENSE), MemoryBoard(firmware), MemoryBoard(firmware)
    plotted(job, uncut, Operator([]), monkeypatch)
    cut_off(job, memory, Operator([at_s]), 0.0, tmp_path, monkeypatch)
    resumed(job, memory, tmp_path)
    check_whole(memory, job)
    once, twice = (length_mm(ink_mm(board.record(), job.machine.kinematics())) for board in (uncut, memory))
    assert once < twice <= once + 1.0


@pytest.mark.parametrize("after_s", [0.2, 0.3, 0.4])
def test_what_was_stopped_while_a_stroke_was_being_held_is_resumed_from_home(
    after_s: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where it stood when it was stopped nobody knows; what is executed for certain is counted through the hold."""
    job, memory, operator = job_of(tmp_path, "2.8.1", LAPS), MemoryBoard("2.8.1"), Operator([4.0])
    ended = stopped(job, memory, operator, after_s, tmp_path, monkeypatch)
    assert ended.result.outcome == "stopped"
    other = MemoryBoard("2.8.1")
    resumed(job, other, tmp_path, homed=True)
    wanted = drawn_in(job)
    before, after = (ink_mm(m.record(), job.machine.kinematics()) for m in (memory, other))
    assert compare(before + after, wanted).wanted.max_mm <= 0.05
    assert float(np.hypot(*(np.vstack(before)[-60:] - after[0][0]).T).min()) <= 0.2


@pytest.mark.parametrize("firmware", ["3.0.3", "3.0.0", "2.8.1"])
@pytest.mark.parametrize("at_s", [2.1, 3.3, 4.7])
def test_what_was_stopped_in_a_stroke_is_resumed_from_home_where_it_was_stopped(
    at_s: float, firmware: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the counters at the stop: more than a second was on the board, of which nobody has counted how much was drawn. Older
    firmware goes on after a stop with what it has queued, and its counters are no place of the drawing."""
    job, memory, operator = job_of(tmp_path, firmware, LAPS), MemoryBoard(firmware), Operator([at_s])
    assert stopped(job, memory, operator, 0.0, tmp_path, monkeypatch).result.outcome == "stopped"
    other = MemoryBoard(firmware)
    resumed(job, other, tmp_path, homed=True)
    ink = [line for m in (memory, other) for line in ink_mm(m.record(), job.machine.kinematics())]
    wanted = drawn_in(job)
    assert compare(ink, wanted).wanted.max_mm <= 0.05
    inked_mm, wanted_mm = length_mm(ink), length_mm(wanted)
    assert abs(inked_mm - wanted_mm) <= (0.5 if firmware.startswith("3") else 4.0) + 0.002 * wanted_mm


def test_what_was_cut_off_on_the_way_home_in_a_pause_is_resumed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The place of the pause is noted before; the pen is up, and the board goes home by itself."""
    job, memory, operator = job_of(tmp_path, "3.0.3", LAPS), MemoryBoard(), Operator([3.0], key="h")
    cut_off(job, memory, operator, 2.5, tmp_path, monkeypatch)
    assert memory.board.state()["pen_up"]
    resumed(job, memory, tmp_path)
    check_length(check_whole(memory, job), job)


@pytest.mark.parametrize(("firmware", "after_s"), [("3.0.3", 2.5), ("2.7.0", 1.2)])
def test_stopped_on_the_way_home_in_a_pause_it_has_ended(
    firmware: str, after_s: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Firmware 2.7.0 cannot say that the motors were let go; its counters are no place of the plot's then."""
    job, memory, operator = job_of(tmp_path, firmware, LAPS), MemoryBoard(firmware), Operator([3.0], key="h")
    ended = stopped(job, memory, operator, after_s, tmp_path, monkeypatch)
    assert ended.result.outcome == "stopped"
    state = load(tmp_path / "journal")
    assert state is not None
    assert state.part["start_mm"] == state.part["left_mm"], "it never was at home"
    board = connect(memory, clock=memory.clock)
    with pytest.raises(BoardRefused, match="does not stand where this plot can have left it"):
        find_left(job, board_setup(job.settings, job.machine, firmware), state, board, homed=False)
    other = MemoryBoard(firmware)
    resumed(job, other, tmp_path, homed=True)
    check_length([ink for m in (memory, other) for ink in ink_mm(m.record(), job.machine.kinematics())], job)


@pytest.mark.parametrize(("before", "since"), [("2.8.1", "3.0.3"), ("3.0.3", "2.8.1")])
def test_a_plot_is_resumed_on_a_board_with_another_firmware(
    before: str, since: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The board was updated, or exchanged, since the plot was cut off: its commands are not those that the journal counts."""
    job, memory, operator = job_of(tmp_path, before, LAPS), MemoryBoard(before), Operator([5.0])
    cut_off(job, memory, operator, 0.0, tmp_path, monkeypatch)
    other = MemoryBoard(since)
    resumed(job, other, tmp_path, homed=True)
    ink = [ink_mm(m.record(), job.machine.kinematics()) for m in (memory, other)]
    wanted = drawn_in(job)
    assert compare(ink[0] + ink[1], wanted).wanted.max_mm <= 0.05
    again_mm = length_mm(ink[0] + ink[1]) - length_mm(wanted)
    on_the_board_mm = (LEAD_S + 0.2) * job.settings.draw_speed
    assert 0 <= again_mm <= on_the_board_mm, "nobody knows how much of that was drawn when it stood still"


def cut_off(
    job: Job, memory: MemoryBoard, operator: Operator, after_s: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The cable is pulled so long after the operator has asked for the pause, and put in again when the board is still."""

    def pull() -> None:
        memory.gone = True

    with pytest.raises(LinkLost):
        plotted_until(job, memory, operator, after_s, pull, tmp_path, monkeypatch)
    memory.host_stalls(3.0)
    memory.replugged()


def stopped(
    job: Job, memory: MemoryBoard, operator: Operator, after_s: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Ended:
    """The operator stops it so long after having asked for the pause."""

    def stop() -> None:
        assert operator.stop is not None
        operator.stop.stop("stopped by Ctrl-C", signal.SIGINT)

    return plotted_until(job, memory, operator, after_s, stop, tmp_path, monkeypatch)


def plotted_until(
    job: Job,
    memory: MemoryBoard,
    operator: Operator,
    after_s: float,
    act: Callable[[], None],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> Ended:
    """With a journal; `act` is called once, `after_s` after the operator has asked for the pause."""
    monkeypatch.setattr(parts, "keys", operator.keys)
    board = connect(memory, clock=memory.clock)

    def watch(m: MemoryBoard) -> None:
        operator(m)
        if operator._asked and m.clock() - operator._asked >= after_s:
            m.on_receive = None
            act()

    memory.on_receive = watch
    with Journal.begin(tmp_path / "journal", {}) as journal:
        return plot_in_parts(board, job, board_setup(job.settings, job.machine, board.firmware), journal, None)


def resumed(job: Job, memory: MemoryBoard, tmp_path: Path, homed: bool = False) -> None:
    """The rest is drawn, by what the journal and the board say."""
    state = load(tmp_path / "journal")
    assert state is not None
    board = connect(memory, clock=memory.clock)
    setup = board_setup(job.settings, job.machine, board.firmware)
    if not homed:
        assert position_lost(board, state) is None
    part = part_after(setup, Part.of(state.part), find_left(job, setup, state, board, homed=homed), homed)
    assert plot_in_parts(board, job, setup, None, part).result.outcome == "done"


def check_length(ink: list[np.ndarray], job: Job) -> None:
    """Nothing much is drawn twice: as much ink as the drawing is long, and an overlap."""
    assert length_mm(ink) == pytest.approx(length_mm(drawn_in(job)), rel=0.003, abs=0.5)


TWO_LAYERS = """<svg xmlns="http://www.w3.org/2000/svg" xmlns:inkscape="http://www.inkscape.org/namespaces/inkscape"
 width="100mm" height="60mm" viewBox="0 0 100 60" stroke="black">
 <g inkscape:groupmode="layer" inkscape:label="1 red"><path d="M10 10L60 10"/><path d="M10 20L60 20"/></g>
 <g inkscape:groupmode="layer" inkscape:label="!2 blue"><path d="M10 30L60 30"/></g></svg>"""


class KeyByKey(Operator):
    """Presses the next of `script` (key, seconds from the beginning) when its time has come, and `p` in every pause."""

    def __init__(self, script: list[tuple[str, float]], in_pauses: str = "p") -> None:
        super().__init__([])
        self.script = script
        self.keys_in_pauses = iter(in_pauses)
        self.messages: list[str | None] = []

    def __call__(self, memory: MemoryBoard) -> None:
        if self.stop is None:
            return
        now, state = memory.clock(), memory.board.state()
        self._began = now if self._began is None else self._began
        if self.script and now - self._began >= self.script[0][1]:
            press(self.script.pop(0)[0], self.stop)
        elif self.stop.pause_reason is None or not (state["pen_up"] and state["idle"]):
            self._resting = None
        elif self._resting is None:
            self._resting = now
        elif now - self._resting > 2.0 and not self.script:
            self.messages.append(self.stop.pause_reason)
            self.rests.append(tuple(state["position"]))
            self._resting = None
            press(next(self.keys_in_pauses, "p"), self.stop)


def test_home_that_was_taken_back_is_not_gone_to_in_a_later_pause(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`h`, and `p` before its pause has begun: the plot goes on, and rests where its own pause is."""
    job, memory, operator = job_of(tmp_path, "3.0.3", TWO_LAYERS), MemoryBoard(), KeyByKey([("h", 0.2), ("p", 0.25)])
    assert plotted(job, memory, operator, monkeypatch).result.outcome == "done"
    assert [str(message).split(",")[0] for message in operator.messages] == ["next: !2 blue"]
    assert operator.rests[0] != (0, 0)
    check_whole(memory, job)


@pytest.mark.parametrize("keys", ["h", "hh"])
def test_a_pause_of_the_drawing_that_was_left_for_home_is_not_begun_again(
    keys: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    job, memory, operator = job_of(tmp_path, "3.0.3", TWO_LAYERS), MemoryBoard(), KeyByKey([], keys)
    assert plotted(job, memory, operator, monkeypatch).result.outcome == "done"
    assert [str(message).split(",")[0] for message in operator.messages] == ["next: !2 blue", *["paused at home"] * len(keys)]
    check_whole(memory, job)


def test_planted_hold_that_stops_dead(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The oracle of speed is seen to trip: a hold that cuts the motion off where it is."""
    brake = PausableProgram.hold

    def cut(self: PausableProgram, taken: int) -> Any:
        rest = brake(self, taken)
        return None if rest is None else list(rest)[-1:]

    monkeypatch.setattr(PausableProgram, "hold", cut)
    job, memory, operator = job_of(tmp_path, "3.0.3"), MemoryBoard(), Operator([2.0, 5.0])
    plotted(job, memory, operator, monkeypatch)
    assert replayed(memory, job, tmp_path).max_velocity_jump_mm_s > 20
