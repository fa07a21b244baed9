"""Every fault at every command, random operators, and the oracles that judge them, on the virtual board in memory.

Oracles, after every run whatever its subject (numbers as in docs/streaming.md):
O1 pen up, queue empty, nothing moving · O2 ink within the plan, one step · O3 ink is the plan when the run says "done" ·
O5 nothing but the safe stop after the first error · O7 the parser never blocked on motion, stops are prompt ·
O9 the error is one of ours and says what to do · O10 the journal bounds what was executed.
Each oracle is shown to trip on a planted bug at the end of this file.
"""

from __future__ import annotations

import random
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from output.ebb import session
from output.ebb.commands import EM, SC, SM, SP, Command
from output.ebb.control import StopFlag
from output.ebb.journal import Journal, load
from output.ebb.program import Mark, PauseMark, StrokeEnd, StrokeMark
from output.ebb.progress import Progress, State
from output.ebb.session import Board, StreamResult, connect
from output.ebb.stream import Streamer
from output.ebb.virtual.moves import StepperMove
from output.errors import BoardRefused, LinkLost, OutputError
from tests.output.board_in_memory import MemoryBoard
from tests.output.inline_producer import inline_producer  # noqa: F401 - a fixture

pytestmark = pytest.mark.usefixtures("inline_producer")

FAULTS: dict[str, dict[str, Any]] = {
    "drop_ack": {"fault": "drop_ack"},
    "delay_ack": {"fault": "delay_ack", "delay_s": 2.0},
    "dup_ack": {"fault": "dup_ack"},
    "split": {"fault": "split", "delay_s": 0.2},
    "garbage": {"fault": "garbage"},
    "garbage inside": {"fault": "garbage", "place": "inside"},
    "notice": {"fault": "notice"},
    "banner": {"fault": "notice", "text": "EBBv13_and_above EB Firmware Version 3.0.3"},
    "nak": {"fault": "nak"},
    "freeze": {"fault": "freeze", "for_s": 1.6},
    "short freeze": {"fault": "freeze", "for_s": 0.3},
    "slow": {"fault": "slow", "factor": 4.0},
    "hangup": {"fault": "hangup"},
    "reboot": {"fault": "reboot", "hangup": False},
    "reboot off the bus": {"fault": "reboot"},
    "power": {"fault": "power", "for_s": 0.05},
}
SURVIVED = {"split", "short freeze", "slow"}


def plot(strokes: int = 2, moves: int = 7) -> Iterator[Command | Mark]:
    """About thirty commands: two zigzag strokes with travel between."""
    # The servo is fast, so that the pen reaches the paper within its wait.
    yield from (SC(4, 20000), SC(5, 14000), SC(11, 60000), SC(12, 60000), EM(1, 1), SP(1, 60))
    x = y = 0
    for k in range(strokes):
        yield from (SM(40, 90, 30), StrokeMark(k), SP(0, 80))
        x, y = x + 90, y + 30
        for i in range(moves):
            dx, dy = 60 + 7 * i, (-1) ** i * (40 + 11 * k)
            yield SM(35, dx, dy)
            x, y = x + dx, y + dy
        yield from (StrokeEnd(k, (x, y)), SP(1, 80))


def planned_ink(items: list[Command | Mark]) -> list[np.ndarray]:
    """The polylines, in steps, that the pen should draw: written here from the program alone."""
    strokes: list[list[tuple[int, int]]] = []
    at, down = (0, 0), False
    for item in items:
        if isinstance(item, SP):
            down = item.value == 0
            if down:
                strokes.append([at])
        elif isinstance(item, SM):
            at = (at[0] + item.steps1, at[1] + (item.steps2 or 0))
            if down:
                strokes[-1].append(at)
    return [np.array(stroke, dtype=float) for stroke in strokes]


def distances(points: np.ndarray, line: np.ndarray) -> np.ndarray:
    """From each point (n, 2) to a polyline (m, 2)."""
    if len(line) == 1:
        return np.hypot(*(points - line[0]).T)
    a, d = line[:-1], np.diff(line, axis=0)
    lengths = np.maximum((d * d).sum(axis=1), 1e-12)
    t = np.clip(((points[:, None] - a) * d).sum(axis=2) / lengths, 0.0, 1.0)
    return np.hypot(*(points[:, None] - a - t[..., None] * d).transpose(2, 0, 1)).min(axis=1)


def check_ink_within_plan(ink: list[dict[str, Any]], items: list[Command | Mark]) -> None:
    plan = planned_ink(items)
    for stroke in ink:
        points = np.array(stroke["points"], dtype=float)
        away = np.min([distances(points, line) for line in plan], axis=0)
        assert away.max() <= 1.5, f"O2: ink {away.max():.1f} steps off the plan"


def check_plan_is_inked(ink: list[dict[str, Any]], items: list[Command | Mark]) -> None:
    drawn = [np.array(stroke["points"], dtype=float) for stroke in ink]
    for line in planned_ink(items):
        away = np.min([distances(line, points) for points in drawn], axis=0) if drawn else np.array([np.inf])
        assert away.max() <= 1.5, "O3: something of the plan was not drawn"


def check_at_rest(memory: MemoryBoard) -> None:
    state = memory.board.state()
    assert state["pen_up"], "O1: the pen is down"
    assert state["idle"], "O1: something moves"
    assert state["queued"] == 0, "O1: something waits"


def check_never_blocked(memory: MemoryBoard) -> None:
    assert memory.board.recorder.blocked == [], "O7: the parser was blocked on motion"


def check_nothing_after(memory: MemoryBoard, at: float) -> None:
    sent = b"".join(data for when, data in memory.written if when > at).decode()
    motion = [wire for wire in sent.split("\r") if re.match(r"(SM|T3|LM|SP,0|EM,1)", wire)]
    assert motion == [], f"O5: sent after the error: {motion[:3]}"


def run(memory: MemoryBoard, items: list[Command | Mark], **kwargs: Any) -> StreamResult | OutputError:
    board = connect(memory, clock=memory.clock)
    board.queue_depth()
    memory.fault_offset = memory.board.recorder.commands  # type: ignore[attr-defined]
    try:
        return board.stream(
            items, on_progress=kwargs.pop("on_progress", lambda _: None), stop=kwargs.pop("stop", StopFlag()), **kwargs
        )
    except OutputError as error:
        return error


def one_fault(name: str, index: int, firmware: str) -> StreamResult | OutputError:
    """Runs the plot with one fault at one command and asks every oracle."""
    items = list(plot())
    memory = MemoryBoard(firmware)
    board = connect(memory, clock=memory.clock)
    board.queue_depth()
    memory.fault(**FAULTS[name], at={"command": memory.board.recorder.commands + index})
    outcome: StreamResult | OutputError
    errors_at: list[float] = []
    safe = Board.safe_stop

    def timed_stop(self: Board, **kwargs: Any) -> Any:
        errors_at.append(memory.clock())
        return safe(self, **kwargs)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Board, "safe_stop", timed_stop)
        try:
            outcome = board.stream(items, on_progress=lambda _: None, stop=StopFlag())
        except OutputError as error:
            outcome = error
    link_alive = not memory.gone
    stop = board.last_stop
    if link_alive:
        memory.host_stalls(3.0)  # whatever is still on its way arrives
        check_at_rest(memory)
    if errors_at:
        check_nothing_after(memory, errors_at[0])
        assert stop is not None
        assert stop.took_s <= 0.5 + 0.1, "O7: the stop took too long"
    # A restarted board has one place again for what was on the wire; ES of firmware 2 leaves servo moves in the queue.
    if "reboot" not in name and not (errors_at and firmware.startswith("2")):
        check_never_blocked(memory)
    ink = memory.record()["ink"]
    if name != "power":  # motors without power do not follow the count, for as long as it takes to be told
        check_ink_within_plan(ink, items)
    if isinstance(outcome, StreamResult):
        assert outcome.outcome == "done"
        check_plan_is_inked(ink, items)
    else:
        assert isinstance(outcome, LinkLost | BoardRefused)
        assert len(str(outcome)) > 40, "O9: an error says what happened and what to do"
    return outcome


def length_of(firmware: str) -> int:
    """How many commands a clean run sends after connecting."""
    memory = MemoryBoard(firmware)
    board = connect(memory, clock=memory.clock)
    board.queue_depth()
    before = memory.board.recorder.commands
    board.stream(list(plot()), on_progress=lambda _: None, stop=StopFlag())
    return memory.board.recorder.commands - before


def every_index(name: str, firmware: str, step: int) -> None:
    count = length_of(firmware)
    outcomes = [one_fault(name, index, firmware) for index in range(0, count - 1, step)]
    errors = [outcome for outcome in outcomes if not isinstance(outcome, StreamResult)]
    if name in SURVIVED:
        assert errors == [], errors
    elif name not in ("dup_ack",):
        # A line that comes with the very last reply may be there after the conversation is over, and power that fails during
        # the last round of questions fails after the last motion.
        unseen = 4 if name == "power" else 2
        assert len(errors) >= len(outcomes) - unseen, [i for i, o in enumerate(outcomes) if isinstance(o, StreamResult)]


@pytest.mark.parametrize("name", FAULTS)
def test_every_fault_along_a_plot(name: str) -> None:
    every_index(name, "3.0.3", 24 if name in ("delay_ack", "freeze") else 9)


@pytest.mark.long
@pytest.mark.parametrize("firmware", ["3.0.3", "3.0.1", "3.0.0", "2.8.1", "2.7.0"])
@pytest.mark.parametrize("name", FAULTS)
def test_every_fault_at_every_command(name: str, firmware: str) -> None:
    if name == "power" and firmware.startswith("2"):
        pytest.skip("firmware 2 has no flag for lost power")
    every_index(name, firmware, 1 if firmware == "3.0.3" else 4)


# random operators


ACTIONS = ("pause", "go", "stop", "unplug", "reboot", "button", "power", "stall")


def act(memory: MemoryBoard, stop: StopFlag, action: str) -> None:
    match action:
        case "pause":
            stop.pause("test")
        case "go":
            stop.go()
        case "stop":
            stop.stop("test")
        case "unplug":
            memory.gone = True
        case "reboot":
            memory.fault(fault="reboot", hangup=False)
        case "button":
            memory.board.press_button()
        case "power":
            memory.fault(fault="power", for_s=0.02)
        case "stall":
            memory.host_stalls(0.4)


def operated(script: list[tuple[float, str]], firmware: str, journal_path: Path) -> None:
    """A plot while somebody does things to it, then, if it did not finish, the checks of a fresh start."""
    items = list(plot())
    memory, stop = MemoryBoard(firmware), StopFlag()
    board = connect(memory, clock=memory.clock)
    began, todo = memory.clock(), sorted(script)
    paused_polls = [0]

    def operator(board: MemoryBoard) -> None:
        while todo and board.clock() - began >= todo[0][0]:
            act(board, stop, todo.pop(0)[1])

    def watch(progress: Progress) -> None:
        paused_polls[0] = paused_polls[0] + 1 if progress.state is State.PAUSED else 0
        if paused_polls[0] > 30:
            stop.go()

    token = board.begin_job()
    journal = Journal.begin(journal_path, {"drawing": "x"})
    journal.part({"token": token})
    memory.on_receive = operator
    outcome: StreamResult | OutputError | None = None
    try:
        outcome = board.stream(items, on_progress=watch, stop=stop, journal=journal)
    except OutputError as error:
        outcome = error
    journal.close()
    memory.on_receive = None
    ink = memory.record()["ink"]
    if not any(action == "power" for _, action in script):  # motors without power do not follow the count
        check_ink_within_plan(ink, items)
        if isinstance(outcome, StreamResult) and outcome.outcome == "done":
            check_plan_is_inked(ink, items)
    rebooted = any(action == "reboot" for _, action in script)
    if not memory.gone:
        memory.host_stalls(2.0)
        check_at_rest(memory)
    stopped = not isinstance(outcome, StreamResult) or outcome.outcome == "stopped"
    if not rebooted and not (stopped and firmware.startswith("2")):
        check_never_blocked(memory)
    state = load(journal_path)
    assert state is not None
    executed = len([item for item in items if isinstance(item, Command)])
    assert state.executed <= executed
    # Whoever comes next finds a board that stands still with the pen up, and nothing goes on by itself.
    memory.replugged()
    again = connect(memory, clock=memory.clock)
    before = len(memory.record()["moves"])
    memory.host_stalls(5.0)
    assert len(memory.record()["moves"]) == before, "row 15: it drew on by itself"
    check_at_rest(memory)
    assert again.query("QG")


@example(script=[(0.0625, "reboot")], firmware="2.8.1")
@example(script=[(0.75, "reboot")], firmware="2.8.1")
@given(
    script=st.lists(st.tuples(st.floats(0.0, 1.6), st.sampled_from(ACTIONS)), max_size=6),
    firmware=st.sampled_from(["3.0.3", "3.0.0", "2.8.1"]),
)
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_whatever_an_operator_does(tmp_path: Path, script: list[tuple[float, str]], firmware: str) -> None:
    operated(script, firmware, tmp_path / "journal")


@pytest.mark.long
@given(
    script=st.lists(st.tuples(st.floats(0.0, 1.6), st.sampled_from(ACTIONS)), max_size=10),
    firmware=st.sampled_from(["3.0.3", "3.0.1", "3.0.0", "2.8.1", "2.7.0"]),
)
@settings(max_examples=1500, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_whatever_an_operator_does_at_full_size(tmp_path: Path, script: list[tuple[float, str]], firmware: str) -> None:
    operated(script, firmware, tmp_path / "journal")


# stops at random instants


def stop_latencies(count: int, firmware: str, seed: int) -> list[float]:
    rng, found = random.Random(seed), []
    while len(found) < count:
        memory, stop = MemoryBoard(firmware), StopFlag()
        board = connect(memory, clock=memory.clock)
        at = memory.clock() + rng.uniform(0.0, 1.5)

        def press(m: MemoryBoard, at: float = at, stop: StopFlag = stop) -> None:
            if m.clock() >= at and not stop.requested:
                stop.stop("test")

        memory.on_receive = press
        result = board.stream(list(plot()), on_progress=lambda _: None, stop=stop)
        if result.outcome != "stopped":
            continue
        assert result.stop is not None
        assert result.stop.pen_up
        if firmware.startswith("3"):
            check_never_blocked(memory)
        else:  # ES of firmware 2 leaves servo moves in the queue: SP,1 waits for them, and its own wait comes after
            memory.host_stalls(0.3)
        check_at_rest(memory)
        assert memory.board.state()["motors_on"] == [False, False]
        found.append(result.stop.took_s)
    return found


@pytest.mark.parametrize("firmware", ["3.0.3", "2.8.1"])
def test_stops_at_random_instants_are_prompt(firmware: str) -> None:
    """The stop's own time: both commands written to both answers read."""
    took = stop_latencies(25, firmware, 3)
    assert max(took) <= (0.1 if firmware.startswith("3") else 0.3)


@pytest.mark.long
def test_a_thousand_stops_at_random_instants() -> None:
    took = sorted(stop_latencies(1000, "3.0.3", 4))
    print(f"stop latency: median {took[500] * 1000:.1f} ms, worst {took[-1] * 1000:.1f} ms")
    assert took[-1] <= 0.1


# stalls of the host


@pytest.mark.parametrize(
    ("stall_s", "firmware"), [(0.05, "3.0.3"), (0.2, "3.0.3"), (0.8, "3.0.3"), (0.2, "2.8.1"), (0.8, "2.8.1")]
)
def test_host_stalls_are_covered_or_counted(stall_s: float, firmware: str) -> None:
    items = list(plot(strokes=3, moves=60))
    memory = MemoryBoard(firmware)
    next_at = [memory.clock() + 1.5]

    def stall(m: MemoryBoard) -> None:
        if m.clock() >= next_at[0]:
            m.host_stalls(stall_s)
            next_at[0] = m.clock() + 1.6

    memory.on_receive = stall
    result = run(memory, items)
    assert isinstance(result, StreamResult)
    assert result.outcome == "done"
    record = memory.record()
    check_plan_is_inked(record["ink"], items)
    check_never_blocked(memory)
    if firmware == "3.0.3":
        assert record["underruns"] == 0, "O8: a second of lead covers the stall"
        assert result.progress.stalls == 0
    else:
        assert record["underruns"] > 0, "with one place in the queue the stall shows"
        assert abs(result.progress.stalls - record["underruns"]) <= 1


# pause and go on, all the ink


@pytest.mark.parametrize("seed", range(8))
def test_pauses_at_random_instants_leave_the_ink_whole(seed: int) -> None:
    rng = random.Random(seed)
    items = list(plot(strokes=4))
    if seed % 2:
        second = next(i for i, item in enumerate(items) if item == StrokeMark(2))
        items.insert(second, PauseMark("change the pen"))
    memory, stop = MemoryBoard(), StopFlag()
    times = [rng.uniform(0.0, 3.0) for _ in range(3)]
    began = memory.clock()

    def operator(m: MemoryBoard) -> None:
        while times and m.clock() - began >= min(times):
            times.remove(min(times))
            stop.pause("test")

    def watch(progress: Progress) -> None:
        if progress.state is State.PAUSED:
            assert memory.board.state()["pen_up"]
            assert memory.board.state()["idle"]
            stop.go()

    memory.on_receive = operator
    result = run(memory, items, stop=stop, on_progress=watch)
    assert isinstance(result, StreamResult)
    assert result.outcome == "done"
    ink = memory.record()["ink"]
    check_plan_is_inked(ink, items)
    check_ink_within_plan(ink, items)
    assert len(ink) == 4, "no stroke was begun twice"


def test_after_a_stop_the_next_plot_draws() -> None:
    """SP,3 takes the pen-down height away; a program that does not say it again would draw in the air."""
    memory, stop = MemoryBoard(), StopFlag()
    board = connect(memory, clock=memory.clock)
    board.stream(list(plot()), on_progress=lambda _: None, stop=StopFlag())
    board.safe_stop()
    without_heights = [item for item in plot() if not isinstance(item, SC)]
    board.stream(without_heights, on_progress=lambda _: None, stop=stop)
    check_second_plot_touched(memory)


def check_second_plot_touched(memory: MemoryBoard) -> None:
    touching = memory.record()["ink_touching"]
    assert len([stroke for stroke in touching if len(stroke["points"]) > 10]) == 4, "the pen did not reach the paper"


# planted bugs: each oracle is seen to trip


def test_planted_pen_height_not_restored(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Board, "_before_send", lambda _self, _command: [])
    with pytest.raises(AssertionError, match="did not reach the paper"):
        test_after_a_stop_the_next_plot_draws()


def test_planted_safe_stop_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    report = session.StopReport(True, None, 0.0, "not done")
    monkeypatch.setattr(session, "safe_stop", lambda *_args, **_kwargs: report)
    with pytest.raises(AssertionError, match="O1"):
        for index in range(20, 60, 3):
            one_fault("nak", index, "3.0.3")


def test_planted_credits_ignored(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("output.ebb.flow.QueueModel.room", lambda _self: 99)
    monkeypatch.setattr("output.ebb.gates.LEAD_S", 60.0)
    memory = MemoryBoard()
    run(memory, list(plot(strokes=4, moves=30)))
    with pytest.raises(AssertionError, match="O7"):
        check_never_blocked(memory)


def test_planted_errors_ignored(monkeypatch: pytest.MonkeyPatch) -> None:
    """A streamer that shrugs at a refusal draws beside the plan."""
    handle = Streamer._handle

    def shrug(self: Streamer, event: Any) -> None:
        if type(event).__name__ == "Refusal":
            sent = self._in_flight.pop(event.number, None)
            if sent is not None and sent.queued:
                self.model.on_acknowledged(self._talk.clock())
            return
        handle(self, event)

    monkeypatch.setattr(Streamer, "_handle", shrug)
    with pytest.raises(AssertionError, match=r"O2|O3"):
        for index in range(20, 70, 3):
            one_fault("nak", index, "3.0.3")


def test_planted_acknowledged_taken_for_executed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The journal of acknowledgements runs ahead of the pen by the whole queue."""
    check_journal_behind_the_pen(tmp_path / "honest")
    monkeypatch.setattr("output.ebb.flow.QueueModel.completed", property(lambda self: self.acknowledged))
    with pytest.raises(AssertionError, match="O10"):
        check_journal_behind_the_pen(tmp_path / "planted")


def check_journal_behind_the_pen(path: Path) -> None:
    """O10: at every moment the journal claims no more moves than the board has finished."""
    items = list(plot())
    moves_before = np.cumsum([isinstance(item, SM) for item in items if isinstance(item, Command)])
    memory = MemoryBoard()
    board = connect(memory, clock=memory.clock)
    journal = Journal.begin(path, {})

    class Checked:
        def sent(self, commands: int) -> None:
            journal.sent(commands)

        def executed(self, progress: Progress) -> None:
            running = memory.board.motion.running
            finished = memory.board.recorder.stepper_moves - isinstance(getattr(running, "entry", None), StepperMove)
            claimed = moves_before[progress.commands_executed - 1] if progress.commands_executed else 0
            assert claimed <= finished, f"O10: claims {claimed} of {finished} moves"
            journal.executed(progress)

        def stroke_done(self, mark: StrokeEnd, progress: Progress) -> None:
            journal.stroke_done(mark, progress)

    try:
        board.stream(items, on_progress=lambda _: None, stop=StopFlag(), journal=Checked())
    finally:
        journal.close()
