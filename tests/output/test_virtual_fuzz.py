"""Nothing that a host can send breaks the virtual board, on any firmware; what it must never do, it never does."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from output.ebb.virtual.board import Board
from output.ebb.virtual.command_table import COMMANDS
from output.ebb.virtual.firmware import FIRMWARES
from output.ebb.virtual.registers import int32

numbers = st.one_of(
    st.integers(-300, 300),
    st.integers(-(2**31), 2**32),
    st.sampled_from([0, 1, 255, 256, 32767, 65535, 65536, 2**31 - 1, 2**31, -(2**31), 9999999999, 99999999999]),
).map(lambda value: str(value).encode())
words = st.one_of(numbers, numbers, numbers, st.sampled_from([b"", b"x", b"+1", b"1.5", b"A", b"b"]))
# CU,4,0 stops a real board for good, and so does R in the middle of anything interesting.
names = st.sampled_from([*sorted(set(COMMANDS) - {b"CU", b"RB", b"BL"}), b"ZZ", b"Q", b"sm", b"t3"])
commands = st.builds(lambda name, given: b",".join([name, *given]) + b"\r", names, st.lists(words, max_size=10))
versions = st.sampled_from(sorted(FIRMWARES))


@given(versions, st.booleans(), st.lists(st.one_of(commands, st.binary(max_size=40)), max_size=12), st.integers(0, 3000))
@settings(max_examples=250, deadline=None)
def test_anything_may_be_sent(version: str, future: bool, sent: list[bytes], ticks: int) -> None:
    board = Board(version)
    board.advance(250)
    board.feed(b"CU,4,32\r" + (b"CU,10,1\r" if future else b""))
    board.advance(500)
    position = board.motion.state(board.now)[0]
    for data in sent:
        board.feed(data)
        before = board.now
        board.advance(ticks)
        assert board.now == before + ticks
        assert len(board.motion.entries) <= max(board.motion.depth, 1)
        after, acc = board.motion.state(board.now)
        assert all(value == int32(value) for value in after)
        assert all(0 <= value < 2**31 for value in acc)
        status = board.status_byte()
        assert 0 <= status <= 0xFF
        position = after
    assert position == board.motion.state(board.now)[0]
    board.recorder.summary(board.now)


@given(versions, commands)
@settings(max_examples=300, deadline=None)
def test_every_command_is_answered_within_a_line_or_two(version: str, command: bytes) -> None:
    board = Board(version)
    board.advance(250)
    board.feed(command)
    board.advance(2000)
    reply = b"".join(sent.data for sent in board.output())
    assert len(reply) < 600
    if reply and not command.upper().startswith((b"EM", b"LM", b"LT", b"T3", b"L3")):
        assert reply[-1:] in b"\r\n"


@given(st.lists(commands, max_size=8))
@settings(max_examples=60, deadline=None)
def test_a_board_fed_byte_by_byte_is_the_same_board(sent: list[bytes]) -> None:
    whole, single = Board(), Board()
    for board in (whole, single):
        board.advance(250)
    data = b"".join(sent)
    whole.feed(data)
    for byte in data:
        single.feed(bytes([byte]))
    for board in (whole, single):
        board.advance(20_000)
    assert whole.output() == single.output()
    assert whole.motion.state(whole.now) == single.motion.state(single.now)
