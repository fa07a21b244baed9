"""Faults that no loop reaches, one by one; docs/reliability.md says which row of its table each test is for."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from output.ebb.abilities import abilities_of
from output.ebb.commands import EM, SC, SM, SP, Command
from output.ebb.control import StopFlag
from output.ebb.conversation import Conversation, suspended_s
from output.ebb.flow import QueueModel
from output.ebb.gates import Gates
from output.ebb.holding import Holding
from output.ebb.journal import Journal, load
from output.ebb.poll import Poll
from output.ebb.program import ApproachMark, Mark, Slowed, StrokeEnd, StrokeMark
from output.ebb.progress import Progress, State
from output.ebb.protocol import Protocol
from output.ebb.resume import position_lost
from output.ebb.session import connect
from output.ebb.stream import StopRequested, Streamer
from output.ebb.virtual.process import start_virtual_board
from output.ebb.watch import StuckBoard
from output.errors import BoardRefused, LinkLost
from tests.output.board_in_memory import MemoryBoard
from tests.output.inline_producer import InlineProducer, inline_producer  # noqa: F401 - a fixture
from tests.output.test_stream_loops import check_at_rest, check_ink_within_plan, check_plan_is_inked, plot

pytestmark = pytest.mark.usefixtures("inline_producer")
ROOT = Path(__file__).parents[2]


# who is there


@pytest.mark.parametrize(
    ("line", "version"),
    [
        ("EBBv13_and_above EB Firmware Version 9.9", (9, 9, 0)),
        ("EBBv13_and_above EB Firmware Version 3.0.3", (3, 0, 3)),
        ("EBB EB Firmware Version 2.4.4", (2, 4, 4)),
        ("EBBv13_and_above EB Firmware Version 3.10", (3, 10, 0)),
    ],
)
def test_versions_are_read(line: str, version: tuple[int, int, int]) -> None:
    assert abilities_of(line).version == version


@pytest.mark.parametrize(
    "line",
    [
        "",
        "EBB",
        "Firmware Version 3.0.3",
        "EBBv13_and_above EB Firmware Version",
        "EBBv13 EB Firmware Version x.y",
        "Grbl 1.1f",
    ],
)
def test_what_is_no_version_is_refused(line: str) -> None:
    with pytest.raises(BoardRefused, match="not an EiBotBoard"):
        abilities_of(line)
    memory = MemoryBoard(version_line=line)
    with pytest.raises(BoardRefused, match="not an EiBotBoard"):
        connect(memory, clock=memory.clock)
    assert memory.record()["moves"] == []
    assert memory.closed


@pytest.mark.parametrize("version", ["2.2.6", "2.4.3"])
def test_a_version_that_is_too_old_is_refused_by_name(version: str) -> None:
    memory = MemoryBoard("2.7.0", version_line=f"EBBv13_and_above EB Firmware Version {version}")
    with pytest.raises(BoardRefused, match=rf"{version} is older than 2\.4\.4.*update it"):
        connect(memory, clock=memory.clock)


# the port


def test_a_close_that_hangs_does_not_keep_the_program() -> None:
    code = "import os, pty, time\nfrom output.ebb.link import SerialPort\n_, slave = pty.openpty()\n"
    code += "port = SerialPort(os.ttyname(slave))\nport._serial.close = lambda: time.sleep(60)\nport.close()\nprint('closed')"
    began = time.monotonic()
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=30, check=False, cwd=ROOT)
    assert done.stdout == "closed\n", done.stderr
    assert done.returncode == 0
    assert time.monotonic() - began < 15


def test_a_stop_from_another_thread_does_not_wait_for_the_sender(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a port, while the queue is full: from the request to everything stopped, and the pen up."""
    monkeypatch.undo()
    with start_virtual_board() as virtual, connect(virtual.port) as board:
        stop, asked = StopFlag(), [0.0]

        def ask() -> None:
            asked[0] = time.monotonic()
            stop.stop("another thread")

        timer = threading.Timer(0.8, ask)
        timer.start()
        result = board.stream(list(plot(strokes=8, moves=40)), on_progress=lambda _: None, stop=stop)
        assert result.outcome == "stopped"
        assert result.stop is not None
        assert result.stop.pen_up
        assert result.stop.took_s <= 0.1 + 0.1, "the board answers within a round trip; the rest is this computer's"
        state = virtual.state()
        assert state["pen_up"]
        assert state["idle"]
        assert virtual.record()["parser_blocked"] == []


# stopping and pausing


@pytest.mark.parametrize("firmware", ["3.0.3", "2.8.1"])
@pytest.mark.parametrize("after_s", [0.5, 3.0, 9.0])
def test_a_move_of_ten_seconds_is_stopped_in_its_middle(after_s: float, firmware: str) -> None:
    memory, stop = MemoryBoard(firmware), StopFlag()
    board = connect(memory, clock=memory.clock)
    items = [SC(4, 20000), SC(5, 14000), EM(1, 1), SP(1, 60), SM(10_000, 5000, 2000), SM(10_000, 5000, 2000)]
    began, asked = memory.clock(), [0.0]

    def press(m: MemoryBoard) -> None:
        if m.clock() - began >= after_s and not stop.requested:
            asked[0] = m.clock()
            stop.stop("test")

    memory.on_receive = press
    result = board.stream(items, on_progress=lambda _: None, stop=stop)
    assert result.stop is not None
    assert result.stop.took_s <= 0.1
    memory.on_receive = None
    before = memory.record()["position"]
    memory.host_stalls(2.0)
    assert memory.record()["position"] == before
    check_at_rest(memory)
    assert abs(before[0]) < 5000 * (after_s + 1) / 10


def test_a_plot_begins_with_the_pen_up_wherever_it_was() -> None:
    memory = MemoryBoard(pen_down=True)
    items = list(plot())
    board = connect(memory, clock=memory.clock)
    board.stream(items, on_progress=lambda _: None, stop=StopFlag())
    record = memory.record()
    check_ink_within_plan([ink for ink in record["ink"] if len(ink["points"]) > 1], items)
    up = next(event for event in record["pen_events"] if event[1] == "up")
    assert record["first_motion_tick"] >= up[4] or not record["ink_touching"][0]["points"]


def test_a_button_that_is_stuck_pauses_once_and_names_the_wiring() -> None:
    memory, stop = MemoryBoard(), StopFlag()
    board = connect(memory, clock=memory.clock)
    states: list[tuple[State, str]] = []
    began = memory.clock()

    def stuck(m: MemoryBoard) -> None:
        if m.clock() - began > 0.5:
            m.board.press_button()
        if m.clock() - began > 6.0 and not stop.requested:
            stop.stop("enough seen")

    def watch(progress: Progress) -> None:
        if not states or states[-1] != (progress.state, progress.message):
            states.append((progress.state, progress.message))

    memory.on_receive = stuck
    result = board.stream(list(plot(strokes=30)), on_progress=watch, stop=stop)
    assert result.outcome == "stopped"
    assert "wiring" in states[-1][1]
    wired = next(i for i, (_, message) in enumerate(states) if "wiring" in message)
    assert all(state is not State.RUNNING for state, _ in states[wired:]), "it must not go on by itself"


def test_a_lowering_on_the_way_waits_for_the_rest_of_its_travel(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planning is late with it. Were the program killed before the rest is sent, the pen would fall beside its stroke."""
    monkeypatch.undo()
    memory, planned = MemoryBoard(), threading.Event()
    board = connect(memory, clock=memory.clock)

    def items() -> Iterator[Command | Mark]:
        yield from [SC(4, 20000), SC(5, 14000), EM(1, 1), SP(1, 60), ApproachMark(), SM(2000, 300, 300), SP(0)]
        planned.wait(60)
        yield from [SM(20, 3, 3), StrokeMark(0), SP(0, 100), SM(50, 10, 0), StrokeEnd(0, (313, 303)), SP(1, 60)]

    began = memory.clock()

    def plan(m: MemoryBoard) -> None:
        time.sleep(0.0005)  # the thread's turn
        if m.clock() - began > 4.0:
            planned.set()

    memory.on_receive = plan
    assert board.stream(items(), on_progress=lambda _: None, stop=StopFlag()).outcome == "done"
    sent = {data.decode().strip(): at - began for at, data in memory.written}
    assert sent["SP,0"] > 4.0
    assert sent["SM,20,3,3"] - sent["SP,0"] < 0.01


def test_a_note_on_the_way_down_is_no_place_to_wait() -> None:
    """The pen is falling: a pause before the stroke would leave it there."""
    memory, stop = MemoryBoard(), StopFlag()
    board = connect(memory, clock=memory.clock)
    items: list[Command | Mark] = [SC(4, 20000), SC(5, 14000), EM(1, 1), SP(1, 60)]
    items += [ApproachMark(), *[SM(500, 75, 75)] * 4, SP(0), SM(20, 3, 3), Slowed(0.1, 1.5)]
    items += [StrokeMark(0), SP(0, 100), SM(50, 10, 0), StrokeEnd(0, (313, 303)), SP(1, 60)]
    items += [StrokeMark(1), SP(0, 100), SP(1, 60)]
    paused: list[bool] = []
    began = memory.clock()

    def press(m: MemoryBoard) -> None:
        if not paused and m.clock() - began > 0.3 and stop.pause_reason is None:
            stop.pause("test")

    def watch(progress: Progress) -> None:
        if progress.state is State.PAUSED:
            paused.append(memory.board.state()["pen_up"])
            stop.go()

    memory.on_receive = press
    assert board.stream(items, on_progress=watch, stop=stop).outcome == "done"
    assert paused
    assert all(paused)


# every command in every state


def in_state(name: str, stop: StopFlag) -> Callable[[Progress], bool]:
    """Brings the stream into a state; says when it is there."""

    def there(progress: Progress) -> bool:
        if name == "running":
            return progress.strokes_done == 1
        if progress.strokes_done == 1 and stop.pause_reason is None and progress.state is State.RUNNING:
            stop.pause("test")
        return progress.state is (State.HOLDING if name == "holding" else State.PAUSED)

    return there


COMMANDS: dict[str, Callable[[StopFlag, MemoryBoard], None]] = {
    "pause": lambda stop, _: stop.pause("again"),
    "go": lambda stop, _: stop.go(),
    "stop": lambda stop, _: stop.stop("test"),
    "stop twice": lambda stop, _: (stop.stop("test"), stop.stop("test"))[0],
    "leave": lambda stop, _: stop.leave(),
    "home": lambda stop, _: stop.go_home(),
    "button": lambda _, memory: memory.board.press_button(),
}
# What a plot of ten strokes comes to. Left alone in a pause it would wait for ever, so that a go follows after a second.
ANSWERS = {
    ("running", "leave"): "done",
    ("running", "home"): "done",
    **{(state, command): "stopped" for state in ("running", "holding", "paused") for command in ("stop", "stop twice")},
    **{(state, command): "left" for state in ("holding", "paused") for command in ("leave", "home")},
}


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("state", ["running", "holding", "paused"])
def test_every_command_has_an_answer_in_every_state(state: str, command: str) -> None:
    memory, stop = MemoryBoard(), StopFlag()
    board = connect(memory, clock=memory.clock)
    reached, given = in_state(state, stop), [0.0]
    items = list(plot(strokes=10, moves=4))

    def watch(progress: Progress) -> None:
        if not given[0] and reached(progress):
            given[0] = memory.clock()
            COMMANDS[command](stop, memory)
        elif given[0] and progress.state is State.PAUSED and memory.clock() - given[0] > 1.0:
            stop.go()

    result = board.stream(items, on_progress=watch, stop=stop)
    assert given[0], f"{state} was not reached"
    assert result.outcome == ANSWERS.get((state, command), "done")
    memory.on_receive = None
    memory.host_stalls(0.5)
    check_at_rest(memory)
    ink = memory.record()["ink"]
    check_ink_within_plan(ink, items)
    if result.outcome == "done":
        check_plan_is_inked(ink, items)
        assert len(ink) == 10
    again = board.stream(list(plot(strokes=1)), on_progress=lambda _: None, stop=StopFlag())
    assert again.outcome == "done", "a new plot begins after whatever became of the old one"


# an error at every function


def functions_of(*kinds: type) -> list[tuple[type, str]]:
    found = []
    for kind in kinds:
        for name, value in vars(kind).items():
            if callable(value) and not name.startswith("__"):
                found.append((kind, name))
    return found


class Planted(Exception):
    """The error that is raised in the middle of things."""


POINTS = functions_of(Streamer, Gates, Poll, Holding, StuckBoard, QueueModel, Conversation, Protocol, InlineProducer, Journal)


def check_errors_at(kind: type, name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, times: int) -> None:
    """Raised once, at the first call of the function in a plot and at some other ones."""
    real, calls, at = getattr(kind, name), [0], [0]
    items = list(plot(strokes=1, moves=5))

    def counted(*arguments: Any, **named: Any) -> Any:
        calls[0] += 1
        if calls[0] == at[0]:
            raise Planted(f"{name} at call {at[0]}")
        return real(*arguments, **named)

    def plotted() -> None:
        # The same tokens each time: with their lengths the number of calls would differ, and the last might not be reached.
        monkeypatch.setattr("secrets.randbelow", random.Random(1).randrange)
        memory = MemoryBoard()
        board = connect(memory, clock=memory.clock)
        calls[0] = 0
        with Journal.begin(tmp_path / "journal", {}) as journal:
            journal.part({"token": board.begin_job()})
            with monkeypatch.context() as patch:
                patch.setattr(kind, name, counted)
                try:
                    board.stream(items, on_progress=lambda _: None, stop=StopFlag(), journal=journal)
                finally:
                    memory.host_stalls(2.0)
                    check_at_rest(memory)
                    check_ink_within_plan(memory.record()["ink"], items)

    plotted()
    total = calls[0]
    if not total:
        pytest.skip("not called in a plot that goes well")
    rng = random.Random(name)
    for call in sorted({1, *(rng.randint(1, total) for _ in range(times))}):
        at[0] = call
        with pytest.raises(Planted, match=name):
            plotted()
        assert load(tmp_path / "journal") is not None


@pytest.mark.parametrize(("kind", "name"), POINTS, ids=lambda value: getattr(value, "__name__", value))
def test_an_error_anywhere_raises_the_pen_and_is_told(
    kind: type, name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    check_errors_at(kind, name, monkeypatch, tmp_path, 1)


@pytest.mark.long
@pytest.mark.parametrize(("kind", "name"), POINTS, ids=lambda value: getattr(value, "__name__", value))
def test_an_error_anywhere_at_full_size(kind: type, name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    check_errors_at(kind, name, monkeypatch, tmp_path, 40)


@pytest.mark.parametrize("error", [StopRequested, KeyboardInterrupt, LinkLost])
def test_an_error_of_the_safe_stops_own_kind_is_no_way_round_it(error: type[BaseException]) -> None:
    memory = MemoryBoard()
    board = connect(memory, clock=memory.clock)

    def watch(progress: Progress) -> None:
        if progress.strokes_done == 1:
            raise error

    try:
        result = board.stream(list(plot()), on_progress=watch, stop=StopFlag())
        assert result.outcome == "stopped"
    except (KeyboardInterrupt, LinkLost) as caught:
        assert isinstance(caught, error)
    check_at_rest(memory)


@pytest.mark.parametrize("on_the_way", [True, False])
def test_ctrl_z_sleeps_before_a_stroke_or_at_the_end(on_the_way: bool) -> None:
    """A program that cannot stop on its path: as a command file, or the travel of a tool, which has no place to pause."""
    memory, stop, slept = MemoryBoard(), StopFlag(), []
    board = connect(memory, clock=memory.clock)
    items = [item for item in plot(strokes=6) if on_the_way or isinstance(item, Command)]

    def press(m: MemoryBoard) -> None:
        if m.clock() > 0.7 and not stop.suspend_asked and not slept:
            os.kill(os.getpid(), signal.SIGTSTP)

    def sleep() -> None:
        check_at_rest(memory)
        slept.append(len(memory.record()["ink"]))
        stop.go()

    stop.suspends = sleep
    memory.on_receive = press
    assert board.stream(items, on_progress=lambda _: None, stop=stop).outcome == "done"
    assert len(slept) == 1
    assert slept[0] in (range(2, 6) if on_the_way else [6])
    check_plan_is_inked(memory.record()["ink"], items)


# the journal's word against the board's


def test_motors_that_were_let_go_since_are_noticed(tmp_path: Path) -> None:
    memory = MemoryBoard()
    board = connect(memory, clock=memory.clock)
    with Journal.begin(tmp_path / "j", {}) as journal:
        journal.part({"token": board.begin_job()})
        board.send(EM(1, 1))
        memory.host_stalls(0.1)
    state = load(tmp_path / "j")
    assert state is not None
    assert position_lost(board, state) is None
    board.send(EM(0, 0))
    memory.host_stalls(0.1)
    assert "motors were switched off" in str(position_lost(board, state))
    board.begin_job()
    assert "another job" in str(position_lost(board, state))


@pytest.mark.parametrize("version", ["2.7.0", "2.8.1", "3.0.3"])
def test_a_stop_by_the_operator_asks_for_home(version: str, tmp_path: Path) -> None:
    """The motors have let go, which firmware before 2.8.0 cannot be asked."""
    memory, stop = MemoryBoard(version), StopFlag()
    board = connect(memory, clock=memory.clock)
    with Journal.begin(tmp_path / "j", {}) as journal:
        journal.part({"token": board.begin_job()})
        memory.on_receive = lambda m: stop.stop("stopped by key") if m.clock() > 1.0 and not stop.requested else None
        result = board.stream(list(plot()), on_progress=lambda _: None, stop=stop, journal=journal)
        journal.end(result.outcome, result.steps)
    state = load(tmp_path / "j")
    assert state is not None
    assert result.outcome == "stopped"
    assert memory.record()["motors_on"] == [False, False]
    assert "motors were" in str(position_lost(board, state))


def test_a_supply_that_failed_since_is_noticed_and_not_forgotten(tmp_path: Path) -> None:
    """The board's own flag goes down when it is read; whoever reads it first must not be the last to know."""
    memory = MemoryBoard()
    board = connect(memory, clock=memory.clock)
    with Journal.begin(tmp_path / "j", {}) as journal:
        journal.part({"token": board.begin_job()})
        memory.on_receive = lambda m: setattr(m, "gone", m.clock() > 0.6)
        with pytest.raises(LinkLost):
            board.stream(list(plot()), on_progress=lambda _: None, stop=StopFlag())
    state = load(tmp_path / "j")
    assert state is not None
    memory.on_receive = None
    memory.replugged()
    memory.host_stalls(3)
    assert position_lost(connect(memory, clock=memory.clock, clear=False), state) is None
    memory.fault(fault="power", at={"time_s": memory.clock() + 1}, on=False, for_s=0.05)
    memory.host_stalls(3)
    assert not connect(memory, clock=memory.clock, clear=False).is_moving()
    for _ in range(2):
        again = connect(memory, clock=memory.clock, clear=False)
        assert "power failed" in str(position_lost(again, state))
    token = again.begin_job()  # at home again
    assert position_lost(again, replace(state, part={"token": token})) is None


def test_a_plot_that_a_dip_has_ended_asks_for_home(tmp_path: Path) -> None:
    memory = MemoryBoard(faults=[{"fault": "power", "at": {"time_s": 1.0}, "on": False, "for_s": 0.05}])
    board = connect(memory, clock=memory.clock)
    with Journal.begin(tmp_path / "j", {}) as journal:
        journal.part({"token": board.begin_job()})
        with pytest.raises(BoardRefused, match="power was lost during the plot"):
            board.stream(list(plot()), on_progress=lambda _: None, stop=StopFlag(), journal=journal)
    state = load(tmp_path / "j")
    assert state is not None
    assert "power failed" in str(position_lost(connect(memory, clock=memory.clock, clear=False), state))


@pytest.mark.parametrize("firmware", ["2.8.1", "2.7.0"])
def test_firmware_without_a_flag_is_asked_for_its_supply(firmware: str, tmp_path: Path) -> None:
    memory = MemoryBoard(firmware, faults=[{"fault": "power", "at": {"time_s": 1.0}, "on": False, "for_s": 1.0}])
    board = connect(memory, clock=memory.clock)
    with (
        pytest.raises(BoardRefused, match="power was lost during the plot"),
        Journal.begin(tmp_path / "j", {}) as journal,
    ):
        journal.part({"token": board.begin_job()})
        board.stream(list(plot(strokes=40)), on_progress=lambda _: None, stop=StopFlag(), journal=journal)
    assert memory.clock() < 2.5
    check_at_rest(memory)
    memory.host_stalls(2.0)
    state = load(tmp_path / "j")
    assert state is not None
    assert "power failed" in str(position_lost(connect(memory, clock=memory.clock, clear=False), state))


def test_a_dip_between_a_pause_and_the_next_part_is_noticed() -> None:
    memory, stop = MemoryBoard(), StopFlag()
    board = connect(memory, clock=memory.clock)

    def leave(progress: Progress) -> None:
        if progress.state is State.PAUSED:
            stop.leave()

    stop.pause("paused")
    assert board.stream(list(plot()), on_progress=leave, stop=stop).outcome == "left"
    stop.go()
    memory.fault(fault="power", at={"time_s": memory.clock() + 0.01}, on=False, for_s=0.05)
    memory.host_stalls(0.1)
    board.begin_job()
    with pytest.raises(BoardRefused, match="power was lost"):
        board.stream(list(plot()), on_progress=lambda _: None, stop=stop)


def test_a_journal_tells_when_its_plot_began(tmp_path: Path) -> None:
    with Journal.begin(tmp_path / "j", {"drawing": "x"}) as journal:
        journal.stroke_done(StrokeEnd(0, (1, 2)), Progress())
    state = load(tmp_path / "j")
    assert state is not None
    assert state.began_s == pytest.approx(time.time(), abs=60)


# one byte of noise in what the board says


class NoisyBoard(MemoryBoard):
    """`noise`: which digit from the board, counted from the plot's beginning, arrives as another byte."""

    noise: tuple[int, bytes] | None = None
    digits = 0

    def receive(self, timeout_s: float) -> bytes:
        data = super().receive(timeout_s)
        for at, byte in enumerate(data):
            if chr(byte).isdigit():
                if self.noise is not None and self.digits == self.noise[0]:
                    data = data[:at] + self.noise[1] + data[at + 1 :]
                self.digits += 1
        return data


@pytest.mark.parametrize("version", ["3.0.3", "3.0.0", "2.8.1"])
def test_one_wrong_digit_in_any_answer_is_an_error_or_nothing(version: str) -> None:
    """Never an exception of another kind, and never one that keeps the pen down."""
    rng, ended = random.Random(14), 0
    for _ in range(60):
        memory = NoisyBoard(version)
        board = connect(memory, clock=memory.clock)
        memory.digits, memory.noise = 0, (rng.randrange(400), rng.choice([b"A", b"A", b"9", b"-"]))
        with suppress(LinkLost, BoardRefused):
            board.stream(list(plot()), on_progress=lambda _: None, stop=StopFlag())
            ended += 1
        memory.host_stalls(2.0)
        check_at_rest(memory)
    assert 0 < ended < 60


@pytest.mark.parametrize(("question", "answer"), [("QU,2", "0"), ("QU,2", "932"), ("QU,3", "0"), ("QU,3", "92")])
def test_a_queue_of_no_length_is_not_set(question: str, answer: str, monkeypatch: pytest.MonkeyPatch) -> None:
    memory = MemoryBoard()
    board = connect(memory, clock=memory.clock)
    real = board.query
    monkeypatch.setattr(board, "query", lambda asked, *_: answer if asked == question else real(asked))
    with pytest.raises(LinkLost, match="damaged"):
        board.stream(list(plot()), on_progress=lambda _: None, stop=StopFlag())
    assert b"CU,4,0\r" not in [data for _, data in memory.written]


def test_more_waiting_than_there_are_places_is_a_damaged_answer() -> None:
    model = QueueModel(32, counts=True)
    with pytest.raises(LinkLost, match="83 commands wait in a queue of 32"):
        model.on_polled(waiting=83, fifo_empty=False, executing=True, now=0.0)


# clocks


def test_a_busy_computer_is_not_taken_for_a_sleeping_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Held up for a second between the readings of two clocks, as it happens at high load."""
    now, calls = [1000.0], [0]

    def read(clock: int) -> float:
        calls[0] += 1
        if calls[0] in (2, 3, 8):
            now[0] += 1.0
        return now[0] + (500.0 if clock == time.CLOCK_BOOTTIME else 0.0)

    monkeypatch.setattr(time, "clock_gettime", read)
    assert [suspended_s() for _ in range(4)] == [500.0] * 4


class HeldUp:
    """A port on which `late_s` pass before each of its waits comes back, and which answers at the second one."""

    name = "held up"

    def __init__(self, late_s: float) -> None:
        self.now_s, self.late_s, self.waits = 0.0, late_s, 0

    def send(self, data: bytes) -> None: ...

    def wake(self) -> None: ...

    def close(self) -> None: ...

    def receive(self, timeout_s: float) -> bytes:
        self.now_s += max(timeout_s, self.late_s)
        self.waits += timeout_s > 0
        return b"OK\r\n" if self.waits == 2 else b""


@pytest.mark.parametrize("late_s", [0.0, 0.3, 5.0])
def test_only_time_spent_waiting_makes_a_reply_late(late_s: float) -> None:
    """The process was stopped during a wait, and the board's answer was not yet on its way when it went on."""
    port = HeldUp(late_s)
    talk = Conversation(port, lambda: port.now_s)
    talk.send("EM,1,1")
    assert talk.receive(0.25) == []
    assert len(talk.receive(0.25)) == 1


def test_a_reply_that_never_comes_is_late_after_its_time() -> None:
    port = HeldUp(0.0)
    port.waits = 2
    talk = Conversation(port, lambda: port.now_s)
    talk.send("EM,1,1")
    with pytest.raises(LinkLost, match="no answer to 'EM,1,1' within 1 s"):
        for _ in range(100):
            talk.receive(0.07)
    assert port.now_s == pytest.approx(1.0)


def test_a_reply_that_never_comes_is_late_for_whoever_only_looks() -> None:
    """Waits of no length pass time as well: a plot that looks again and again must not do so for ever."""
    port = HeldUp(0.0001)
    talk = Conversation(port, lambda: port.now_s)
    talk.send("QU,6")
    with pytest.raises(LinkLost, match="no answer to 'QU,6' within 1 s"):
        for _ in range(11_000):
            talk.receive(-0.1)


def test_a_device_that_never_stops_talking_is_not_listened_to_for_ever() -> None:
    memory = MemoryBoard()
    memory.receive = lambda _timeout_s: (memory.host_stalls(0.001), b"Grbl 1.1f ['$' for help]\r\n")[1]  # type: ignore[method-assign]
    began = memory.clock()
    with pytest.raises(BoardRefused, match="not an EiBotBoard"):
        connect(memory, clock=memory.clock)
    assert memory.clock() - began < 6.0


class HeldUpOnce(MemoryBoard):
    """The program is stopped for `late_s` in its wait number `at`: after the answer was read, or before it had looked."""

    def __init__(self, at: int, looked: bool, firmware: str = "3.0.3", late_s: float = 12.0) -> None:
        super().__init__(firmware)
        self.at, self.looked, self.late_s, self.waits = at, looked, late_s, 0

    def receive(self, timeout_s: float) -> bytes:
        self.waits += timeout_s > 0
        if self.waits != self.at or timeout_s <= 0:
            return super().receive(timeout_s)
        data = super().receive(timeout_s) if self.looked else b""
        self.host_stalls(self.late_s)
        return data


@pytest.mark.parametrize("firmware", ["3.0.3", "2.8.1"])
@pytest.mark.parametrize("looked", [True, False])
def test_a_program_that_is_stopped_at_any_wait_goes_on(looked: bool, firmware: str) -> None:
    """For twelve seconds, longer than any deadline: in the handshake, in a plot, in the safe stop after it."""
    items, at, waits = list(plot(strokes=1, moves=5)), 0, 1
    while at < waits:
        at += 1
        memory = HeldUpOnce(at, looked, firmware)
        board = connect(memory, clock=memory.clock)
        assert board.stream(items, on_progress=lambda _: None, stop=StopFlag()).outcome == "done"
        check_plan_is_inked(memory.record()["ink"], items)
        report = board.safe_stop()
        assert report.pen_up
        assert report.detail == "stopped, pen up"
        waits = memory.waits
    assert at > 50


def test_nothing_is_timed_by_the_wall_clock() -> None:
    """The wall clock jumps; one place tells a person when a plot began."""
    allowed = {"output/ebb/journal.py": 1, "plotter/journals.py": 1}
    found: dict[str, int] = {}
    for folder in ("output", "plotter", "planning"):
        for file in (ROOT / folder).rglob("*.py"):
            count = sum(file.read_text().count(word) for word in ("time.time(", "datetime.now", "localtime(", "fromtimestamp("))
            if count:
                found[file.relative_to(ROOT).as_posix()] = count
    assert found == allowed
