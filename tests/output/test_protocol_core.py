"""The protocol core against recorded replies of real firmware, whole and byte by byte, and against noise."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from output.ebb.protocol import MAX_LINE_BYTES, Event, Notice, Protocol, Refusal, Reply, Resynced, Stray, Syntax

TABLE = Path(__file__).parents[1] / "data" / "ebb_protocol_sample.jsonl"


def rows() -> Iterator[dict[str, str]]:
    """Rows with one plain command, in the syntax the row says, whose reply is a complete line."""
    for line in TABLE.read_text().splitlines():
        row = json.loads(line)
        changes_syntax = any(command.split(",")[0] in ("R", "CU") for command in row["setup"]) or row["send"].startswith(
            "CU,10"
        )
        plain = row["send"].endswith("\r") and row["send"].count("\r") == 1 and row["send"][:-1].isprintable()
        if plain and not changes_syntax and row["recv"].endswith(("\n", "\r")) and len(row["send"]) > 1:
            yield row


ROWS = list(rows())


def play(row: dict[str, str], chunk: int) -> list[Event]:
    core = Protocol(Syntax(row["mode"]))
    core.send(row["send"][:-1])
    data = row["recv"].encode("latin-1")
    return [event for i in range(0, len(data), chunk) for event in core.receive(data[i : i + chunk])]


def test_the_table_is_not_empty() -> None:
    assert len(ROWS) > 150


@pytest.mark.parametrize(
    ("question", "good", "bad"),
    [
        ("QU,6", "12", "A3"),
        ("QU,2", "2,32", "3F"),
        ("QU,1", "F0", "G0"),
        ("QU,4", "4,0D9F", "0D9F,Z"),
        ("QL,24", "200", "700"),
        ("QL", "007", "0A7"),
    ],
)
def test_a_number_in_the_wrong_base_or_range_is_nobodys(question: str, good: str, bad: str) -> None:
    for data, kind in ((good, Reply), (bad, Stray)):
        core = Protocol(Syntax.FUTURE)
        core.send(question)
        assert [type(event) for event in core.receive(f"{question[:2]},{data}\n".encode())] == [kind]


@pytest.mark.parametrize("mode", ["legacy", "future"])
def test_every_recorded_reply_is_an_answer_or_a_refusal(mode: str) -> None:
    """Nothing that real firmware answers to one command is a stray line; an error always comes out as a refusal."""
    for row in ROWS:
        if row["mode"] != mode:
            continue
        events = play(row, 10_000)
        refused = any(isinstance(event, Refusal) for event in events)
        notices = [event for event in events if isinstance(event, Notice)]
        assert refused == ("!" in row["recv"]), (row, events)
        if not refused and not notices:
            assert [type(event) for event in events] == [Reply], (row, events)
            answer = events[0]
            assert isinstance(answer, Reply)
            assert answer.name == row["send"][:-1].split(",")[0].upper()


def test_how_replies_are_split_makes_no_difference() -> None:
    for row in ROWS:
        assert play(row, 1) == play(row, 3) == play(row, 10_000), row


def test_queries_give_their_data_in_both_syntaxes() -> None:
    for syntax, text in (
        (
            Syntax.LEGACY,
            "EBBv13_and_above EB Firmware Version 2.8.1\r\n0A\r\n-5,7\n\rOK\r\nQU,32\r\nOK\r\nQM,1,0,0,1\n\r\r\nOK\r\nOK\r\n",
        ),
        (Syntax.FUTURE, "V,EBBv13_and_above EB Firmware Version 2.8.1\nQG,0A\nQS,-5,7\nQU,32\n\nQM,1,0,0,1\nQT,\nSM\n"),
    ):
        core = Protocol(syntax)
        for wire in ("V", "QG", "QS", "QU,2", "QM", "QT", "SM,10,1,1"):
            core.send(wire)
        data = [event.data for event in core.receive(text.encode()) if isinstance(event, Reply)]
        assert data == ["EBBv13_and_above EB Firmware Version 2.8.1", "0A", "-5,7", "32", "1,0,0,1", "", ""], syntax
        assert core.pending == 0


@pytest.mark.parametrize(
    ("syntax", "sent", "lines"),
    [
        (Syntax.FUTURE, ["T3,5,0,0,0,0,0,0", "QU,6"], b"QU,3\n"),  # the acknowledgement was lost
        (Syntax.FUTURE, ["QU,6"], b"T3\n"),  # one came twice
        (Syntax.FUTURE, [], b"T3\n"),
        (Syntax.FUTURE, ["QS"], b"QS\n"),  # a query without its data
        (Syntax.FUTURE, ["QS"], b"QS,12,x\n"),
        (Syntax.FUTURE, ["SM,1,1,1"], b"SM,1\n"),
        (Syntax.LEGACY, ["QG"], b"OK\r\n"),
        (Syntax.LEGACY, ["SM,1,1,1"], b"3E\r\n"),
        (Syntax.LEGACY, ["QS"], b"OK\r\n"),
        (Syntax.LEGACY, [], b"OK\r\n"),
        (Syntax.LEGACY, ["QG"], b"1E0\r\n"),
        (Syntax.FUTURE, ["SM,1,1,1"], b"S\x00M\n"),
        (Syntax.FUTURE, ["SM,1,1,1"], b"SM\xff\n"),
    ],
)
def test_a_line_its_owner_cannot_have_sent_is_stray(syntax: Syntax, sent: list[str], lines: bytes) -> None:
    core = Protocol(syntax)
    for wire in sent:
        core.send(wire)
    events = core.receive(lines)
    assert isinstance(events[-1], Stray), events
    assert core.pending == len(sent)


def test_unasked_lines_of_the_board_are_notices() -> None:
    core = Protocol(Syntax.FUTURE)
    core.send("SM,1,1,1")
    events = core.receive(b"Limit switch triggered. PortB=12\nEBBv13_and_above EB Firmware Version 3.0.3\nSM\n")
    assert [type(event) for event in events] == [Notice, Notice, Reply]


@given(
    token=st.integers(1, 2**32 - 1), before=st.binary(max_size=300), syntax=st.sampled_from(Syntax), chunk=st.integers(1, 40)
)
@settings(max_examples=150, deadline=None)
def test_a_resync_finds_its_token_after_anything(token: int, before: bytes, syntax: Syntax, chunk: int) -> None:
    """Whatever was in the line, the token ends the search, tells the syntax, and leaves nothing pending."""
    core = Protocol(Syntax.LEGACY)
    for _ in range(5):
        core.send("SM,1,1,1")
    core.resync(token)
    answer = b"SN\nQN,%d\n" % token if syntax is Syntax.FUTURE else b"OK\r\n%d\r\nOK\r\n" % token
    data = before + b"\n" + answer
    events = [event for i in range(0, len(data), chunk) for event in core.receive(data[i : i + chunk])]
    assert [event.syntax for event in events if isinstance(event, Resynced)] == [syntax]
    assert core.pending == 0
    assert core.syntax is syntax


@given(
    st.lists(st.binary(max_size=60), max_size=20),
    st.sampled_from(Syntax),
    st.lists(st.sampled_from(["SM,1,1,1", "QG", "QS", "QU,6", "V"]), max_size=6),
)
@settings(max_examples=300, deadline=None)
def test_noise_is_only_ever_an_event(chunks: list[bytes], syntax: Syntax, sent: list[str]) -> None:
    check_noise(chunks, syntax, sent)


@pytest.mark.long
@given(
    st.lists(st.binary(max_size=80), max_size=40),
    st.sampled_from(Syntax),
    st.lists(st.sampled_from(["SM,1,1,1", "QG", "QS", "QU,6", "V"]), max_size=6),
)
@settings(max_examples=100_000, deadline=None)
def test_noise_is_only_ever_an_event_at_full_size(chunks: list[bytes], syntax: Syntax, sent: list[str]) -> None:
    check_noise(chunks, syntax, sent)


def check_noise(chunks: list[bytes], syntax: Syntax, sent: list[str]) -> None:
    """No exception, no event without cause, memory bounded, and the same events whatever the splits."""
    core, whole = Protocol(syntax), Protocol(syntax)
    for wire in sent:
        core.send(wire)
        whole.send(wire)
    events = []
    for chunk in chunks:
        events += core.receive(chunk)
        assert len(core._line) <= MAX_LINE_BYTES
        assert core.pending <= len(sent)
    assert events == whole.receive(b"".join(chunks))
    assert sum(isinstance(event, Reply) for event in events) <= len(sent)


def test_an_endless_line_costs_no_memory() -> None:
    core = Protocol(Syntax.FUTURE)
    for _ in range(1000):
        assert core.receive(b"x" * 1000) == []
        assert len(core._line) <= MAX_LINE_BYTES
    assert isinstance(core.receive(b"\n")[0], Stray)


@pytest.mark.parametrize("wire", ["", "SM,1\r,1", "A" * 256, "SP,é"])
def test_text_the_board_cannot_take_is_not_sent(wire: str) -> None:
    with pytest.raises(ValueError, match="printable"):
        Protocol().send(wire)
