"""The oracles that the loops do not ask: replies owned, speeds, gaps, memory, words; each with a planted bug that trips it.

O4 one reply for each command, each given to its own · O5 nothing but the safe stop after an error · O6 no motor faster than
25 kHz, no jump of rate inside a stroke · O8 no idle gap inside a stroke, or it is counted · O9 every failure of the program is
one sentence that names cause and next step, with its own exit code · O11 memory stays bounded.
O1, O2, O3, O7 and O10 are in test_stream_loops.py and test_journal.py; speed through a pause is in test_pauses.py.
"""

from __future__ import annotations

import re
import tracemalloc
from collections.abc import Iterator
from itertools import chain
from typing import Any

import click
import pytest

from output.ebb import session
from output.ebb.commands import SM, SP, T3, Command
from output.ebb.control import StopFlag
from output.ebb.conversation import Conversation
from output.ebb.program import Mark
from output.ebb.progress import Progress
from output.ebb.protocol import Event, Protocol, Reply
from output.ebb.session import connect
from output.ebb.stream import Streamer
from output.ebb.virtual.board import Sent
from output.errors import BadCommand, BoardRefused, LinkLost, OutputError
from planning.errors import ImpossiblePlan, OutsideMachine
from plotter.cli.main import EXIT_CODES, run
from plotter.errors import BadInput, Interrupted, Paused
from tests.output.board_in_memory import MemoryBoard
from tests.output.inline_producer import inline_producer  # noqa: F401 - a fixture
from tests.output.test_stream_loops import check_nothing_after, plot

pytestmark = pytest.mark.usefixtures("inline_producer")


# O4


def check_replies_owned(monkeypatch: pytest.MonkeyPatch, firmware: str, faults: list[dict[str, Any]]) -> None:
    """Whatever the stream takes for the answer of a command is the line that the board sent for that very command."""
    memory = MemoryBoard(firmware)
    board = connect(memory, clock=memory.clock)
    said: list[tuple[str, str]] = []
    send, settle = Protocol.send, Conversation.receive
    wires: dict[int, str] = {}

    def sent(self: Protocol, wire: str) -> tuple[int, bytes]:
        number, data = send(self, wire)
        wires[number] = wire
        return number, data

    def received(self: Conversation, timeout_s: float) -> list[Event]:
        events = settle(self, timeout_s)
        said.extend((wires[event.number], event.data) for event in events if isinstance(event, Reply))
        return events

    monkeypatch.setattr(Protocol, "send", sent)
    monkeypatch.setattr(Conversation, "receive", received)
    first = memory.board.recorder.commands
    lines = lines_by_command(memory)
    for fault in faults:
        memory.fault(**fault)
    try:
        board.stream(list(plot()), on_progress=lambda _: None, stop=StopFlag())
    except OutputError:
        assert faults, "a clean run ends without an error"
    commands = [text for _, way, text in memory.board.recorder.wire if way == ">"]
    questions = [n for n in range(first, len(commands)) if commands[n].startswith("Q")]
    asked = [(wire, data) for wire, data in said if wire.startswith("Q")]
    assert asked, "nothing was asked"
    for (wire, data), n in zip(asked, questions, strict=False):
        line = lines[n].replace(b"\r", b"\n").strip(b"\n").split(b"\n")[0].decode()
        truth = line.removeprefix(commands[n].split(",")[0] + ",")
        assert (wire, data) == (commands[n], truth), f"O4: {wire} was given {data!r}, the board said {line!r} to {commands[n]}"


def lines_by_command(memory: MemoryBoard) -> dict[int, bytes]:
    """What the board says to each command, by the command's number; kept from now on."""
    said: dict[int, bytes] = {}
    output = memory.board.output

    def watched() -> list[Sent]:
        sent = output()
        for one in sent:
            said[one.command] = said.get(one.command, b"") + one.data
        return sent

    memory.board.output = watched  # type: ignore[method-assign]
    return said


@pytest.mark.parametrize("firmware", ["3.0.3", "3.0.0", "2.8.1"])
def test_every_answer_goes_to_its_own_question(firmware: str, monkeypatch: pytest.MonkeyPatch) -> None:
    check_replies_owned(monkeypatch, firmware, [])


@pytest.mark.parametrize("fault", ["split", "delay_ack"])
def test_late_and_split_answers_go_to_their_own_question(fault: str, monkeypatch: pytest.MonkeyPatch) -> None:
    check_replies_owned(monkeypatch, "3.0.3", [{"fault": fault, "delay_s": 0.2, "at": {"command": 60}}])


def test_planted_replies_taken_as_they_come(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each QS is given the line of the QS before it, as after a reply that was lost unnoticed."""
    receive = Protocol.receive
    before: list[str] = ["0,0"]

    def shifted(self: Protocol, data: bytes) -> list[Event]:
        events = receive(self, data)
        for i, event in enumerate(events):
            if isinstance(event, Reply) and event.name == "QS":
                before.append(event.data)
                events[i] = Reply(event.number, event.name, before[-2])
        return events

    monkeypatch.setattr(Protocol, "receive", shifted)
    with pytest.raises(AssertionError, match="O4"):
        check_replies_owned(monkeypatch, "2.8.1", [])


# O5


def test_planted_sending_on_after_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """A safe stop that is followed by one more move."""
    safe = session.safe_stop

    def and_one_more(talk: Conversation, *arguments: Any, **named: Any) -> session.StopReport:
        report = safe(talk, *arguments, **named)
        talk.ask("SM,10,5,5")
        return report

    def after_a_refusal() -> None:
        memory = MemoryBoard()
        board = connect(memory, clock=memory.clock)
        memory.fault(fault="nak", at={"command": memory.board.recorder.commands + 40})
        with pytest.raises(OutputError):
            board.stream(list(plot()), on_progress=lambda _: None, stop=StopFlag())
        stopped_at = next(when for when, data in memory.written if data.startswith(b"\rES"))
        check_nothing_after(memory, stopped_at)

    after_a_refusal()
    monkeypatch.setattr(session, "safe_stop", and_one_more)
    with pytest.raises(AssertionError, match="O5"):
        after_a_refusal()


# O6


def check_speeds(items: list[Command | Mark], largest_jump_hz: float) -> None:
    memory = MemoryBoard()
    connect(memory, clock=memory.clock).stream(items, on_progress=lambda _: None, stop=StopFlag())
    record = memory.record()
    assert record["largest_step_rate_hz"] <= 25_000, "O6: a motor is faster than 25 kHz"
    assert record["largest_step_rate_jump_hz"] <= largest_jump_hz, "O6: the speed jumps"


def ramp(top: int) -> list[Command | Mark]:
    """Up to `top` (2^31 a step and tick) and down again, as the encoder would, at about 40 ms a piece."""
    accel = top // 1000
    up, even, down = (
        T3(1000, 0, accel, 0, 0, accel, 0),
        T3(1000, top, 0, 0, top, 0, 0),
        T3(1000, top, -accel, 0, top, -accel, 0),
    )
    return [SP(1, 10), up, even, even, down]


def test_speeds_are_watched_and_a_jump_is_seen() -> None:
    check_speeds(ramp(200_000_000), 50.0)
    with pytest.raises(AssertionError, match="O6: the speed jumps"):
        check_speeds([*ramp(200_000_000)[:3], T3(1000, 100_000_000, 0, 0, 100_000_000, 0, 0)], 50.0)
    with pytest.raises(BadCommand, match="25 kHz"):
        SM(10, 400, 0)
    memory = MemoryBoard()
    with pytest.raises(BoardRefused, match="too high"):
        connect(memory, clock=memory.clock).query("SM,10,400,0")


# O8


def with_stalls(firmware: str = "3.0.3") -> tuple[int, int]:
    """Underruns as the board saw them, and as the stream counted them, when the host sleeps 0.2 s now and then."""
    memory = MemoryBoard(firmware)
    next_at = [1.0]

    def stall(m: MemoryBoard) -> None:
        if m.clock() >= next_at[0]:
            m.host_stalls(0.2)
            next_at[0] = m.clock() + 0.5

    board = connect(memory, clock=memory.clock)
    memory.on_receive = stall
    result = board.stream(list(plot(strokes=2, moves=40)), on_progress=lambda _: None, stop=StopFlag())
    return memory.record()["underruns"], result.progress.stalls


def check_no_gap(firmware: str = "3.0.3") -> None:
    seen, counted = with_stalls(firmware)
    assert seen == 0, "O8: the board ran dry inside a stroke"
    assert counted == 0


def test_planted_lead_too_short(monkeypatch: pytest.MonkeyPatch) -> None:
    check_no_gap()
    monkeypatch.setattr("output.ebb.gates.LEAD_S", 0.1)
    with pytest.raises(AssertionError, match="O8"):
        check_no_gap()


# O9


SENTENCE = re.compile(r"plotter: [^\n]{25,}\n")
ADVICE = re.compile(r": [a-z]|; |\bsee\b|\bgive\b|\brun\b|\bcheck\b|\bgoes on\b|\bpen\b")


def check_said(code: int, text: str, expected: int) -> None:
    assert code == expected, f"O9: exit code {code}"
    assert "Traceback" not in text, "O9: a traceback"
    assert SENTENCE.search(text), f"O9: no sentence in {text!r}"
    assert ADVICE.search(text), f"O9: no next step in {text!r}"


FAILURES: list[tuple[type[BaseException], int]] = [
    (BadInput, 2),
    (OutsideMachine, 2),
    (ImpossiblePlan, 2),
    (BadCommand, 2),
    (BoardRefused, 3),
    (LinkLost, 4),
    (Paused, 5),
    (Interrupted, 130),
]


def failing(monkeypatch: pytest.MonkeyPatch, error: BaseException) -> None:
    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr("plotter.cli.settings.machine_names", fail)


@pytest.mark.parametrize(("kind", "code"), FAILURES)
def test_each_cause_has_its_exit_code(
    kind: type[BaseException], code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    failing(monkeypatch, kind("something was not as it should be: check the cable"))
    check_said(run(["machines"]), capsys.readouterr().err, code)


def test_no_cause_is_without_an_exit_code() -> None:
    assert {kind for kind, _ in FAILURES} - {OutsideMachine, ImpossiblePlan} <= {kind for kind, _ in EXIT_CODES}
    assert len({code for _, code in EXIT_CODES}) == 5
    assert 0 not in {code for _, code in EXIT_CODES}


def test_planted_error_without_a_next_step(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    failing(monkeypatch, BoardRefused("timeout"))
    with pytest.raises(AssertionError, match="O9"):
        check_said(run(["machines"]), capsys.readouterr().err, 3)
    failing(monkeypatch, ZeroDivisionError("a bug"))
    with pytest.raises(AssertionError, match="O9"):
        check_said(run(["machines"]), capsys.readouterr().err, 3)
    failing(monkeypatch, click.ClickException("no such option as that one"))
    with pytest.raises(AssertionError, match="O9"):
        check_said(run(["machines"]), capsys.readouterr().err, 3)


# O11


class Forgetful(list[tuple[float, bytes]]):
    """The in-memory board's own list of what was written, which would count."""

    def append(self, _: tuple[float, bytes]) -> None:
        return


def kept_bytes(moves: int) -> int:
    """What the streaming modules hold when so many short moves have been sent."""
    memory = MemoryBoard()
    memory.written = Forgetful()
    board = connect(memory, clock=memory.clock)
    held: list[int] = []
    own = [tracemalloc.Filter(True, f"*/output/ebb/{name}.py") for name in ("stream", "flow", "conversation", "protocol")]

    def look(progress: Progress) -> None:
        if progress.commands_sent >= moves and not held:
            found = tracemalloc.take_snapshot().filter_traces(own)
            held.append(sum(entry.size for entry in found.statistics("filename")))

    tracemalloc.start()
    try:
        items: Iterator[Command | Mark] = chain([SP(1, 10)], (SM(8, 8, 8) for _ in range(moves + 200)))
        board.stream(items, on_progress=look, stop=StopFlag())
    finally:
        tracemalloc.stop()
    return held[0]


def check_memory() -> None:
    few, many = kept_bytes(300), kept_bytes(3000)
    assert many <= few + 40_000, f"O11: {few} bytes are kept after 300 moves, {many} after 3000"


def test_what_a_stream_keeps_does_not_grow_with_the_plot() -> None:
    check_memory()


def test_planted_transcript_that_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """A stream that keeps what it has sent."""
    kept: list[object] = []
    executed = Streamer._count_executed

    def keep(self: Streamer) -> None:
        kept.extend(self._unexecuted)
        executed(self)

    monkeypatch.setattr(Streamer, "_count_executed", keep)
    with pytest.raises(AssertionError, match="O11"):
        check_memory()
