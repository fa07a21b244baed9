"""The exact arithmetic against the virtual board, which was written apart from it: sequences of moves with extreme values."""

from __future__ import annotations

import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from output.ebb import arithmetic, arithmetic_old
from output.ebb.arithmetic import NeverEnds, State, StepRateRefused
from output.ebb.commands import HM, L3, LM, LT, SM, T3, TD, TR, XM, MotionCommand
from output.ebb.commands_text import parse_as_sent
from output.ebb.firmware import firmware
from output.ebb.virtual.board import Board
from output.errors import BadCommand

SETTINGS = settings(max_examples=60, deadline=None, phases=(Phase.explicit, Phase.reuse, Phase.generate))
LONG_TICKS = 400_000

EDGES = st.sampled_from([0, 1, -1, 5, -5, 6, -6, 2**31 - 1, -(2**31), 2**30, -(2**30)])
VALUE = st.one_of(EDGES, st.integers(-(2**31), 2**31 - 1), st.integers(-(10**7), 10**7), st.integers(-3000, 3000))
CLEAR = st.one_of(st.none(), st.sampled_from([0, 1, 2, 3]))
ANY_CLEAR = st.one_of(CLEAR, st.sampled_from([4, 7, 255, 2**32 - 1]))
TICKS = st.one_of(st.integers(1, 4), st.integers(1, 3000))
STEPS = st.one_of(st.integers(-5, 5), st.integers(-400, 400))
MS = st.one_of(st.integers(1, 40), st.integers(1, 2000), st.sampled_from([100_001, 2**32 - 1]))


def built(kind: type[MotionCommand], *values: int | None) -> MotionCommand | None:
    """The command, or None for one that cannot be built because a board would refuse it."""
    try:
        return kind(*values)
    except BadCommand:
        return None


NEW = st.one_of(
    st.builds(built, st.just(T3), TICKS, *[VALUE] * 6, ANY_CLEAR),
    st.builds(built, st.just(TD), TICKS, *[VALUE] * 8, ANY_CLEAR),
    st.builds(built, st.just(LT), TICKS, *[VALUE] * 4, ANY_CLEAR),
    st.builds(built, st.just(LM), VALUE, STEPS, VALUE, VALUE, STEPS, VALUE, ANY_CLEAR),
    st.builds(built, st.just(L3), VALUE, STEPS, VALUE, VALUE, VALUE, STEPS, VALUE, VALUE, ANY_CLEAR),
    st.builds(built, st.sampled_from([SM, XM]), MS, STEPS, STEPS, CLEAR),
    st.builds(lambda ms, a, b: parse_as_sent(f"XM,{ms},{a},{b}"), MS, EDGES, EDGES),
    st.builds(built, st.just(TR), st.integers(1, 25_000), STEPS, STEPS, CLEAR),
    st.builds(built, st.just(HM), st.integers(1, 25_000), STEPS, STEPS),
)
OLD = st.one_of(
    st.builds(built, st.just(LT), TICKS, *[VALUE] * 4, CLEAR),
    st.builds(built, st.just(LM), VALUE, STEPS, VALUE, VALUE, STEPS, VALUE, CLEAR),
    st.builds(built, st.sampled_from([SM, XM]), MS, STEPS, STEPS),
    st.builds(built, st.just(HM), st.integers(2, 25_000), STEPS, st.integers(-3, 3)),
)


def agree(version: str, commands: list[MotionCommand | None]) -> int:
    """Play the commands on both, comparing after each; how many were played. Ends at one that never ends or is refused."""
    profile = firmware(version)
    execute = arithmetic_old.execute if profile.old_arithmetic else arithmetic.execute
    board, state, played = Board(version, timed=False), State(), 0
    board.advance(250)
    for command in commands:
        if command is None or (profile.old_arithmetic and profile.refusal(command) is not None):
            continue
        try:
            done = execute(command, state)
        except (NeverEnds, StepRateRefused):
            return played
        if done.ticks > LONG_TICKS:
            return played
        board.output()
        board.feed(command.wire().encode() + b"\r")
        loaded = board.now + 1
        queued = not board.motion.idle
        while not board.motion.idle:
            event = board.motion.next_event()
            assert event is not None, command
            board.advance_to(event)
        position, acc = board.motion.state(board.now)
        assert (*position, *acc) == (*done.state.position, *done.state.acc), (command, state)
        # Nothing is queued for a way of no steps.
        assert not queued or board.now - loaded == done.ticks + done.dead_ticks, (command, state)
        state, played = done.state, played + 1
    return played


@SETTINGS
@given(st.lists(NEW, min_size=1, max_size=6))
def test_sequences_end_where_the_virtual_board_ends(commands: list[MotionCommand | None]) -> None:
    agree("3.0.3", commands)


@pytest.mark.parametrize("version", ["2.8.1", "2.7.0"])
@SETTINGS
@given(commands=st.lists(OLD, min_size=1, max_size=6))
def test_sequences_on_old_firmware_end_where_the_virtual_board_ends(version: str, commands: list[MotionCommand | None]) -> None:
    agree(version, commands)


@pytest.mark.parametrize(
    "command",
    [
        # Rate + Accel beyond 32 bits starts the other way, which Clear goes by.
        T3(2, 1975226760, 6988921, 1462, 2147483646, 637830231, 9322184, 3),
        LM(2147483647, -73, 469, 0, 286, 3951906, 3),
        # The jerk of TD's second half is -Jerk in 32 bits.
        TD(3, 6, 55576787, 369282, -(2**31), 0, -1, 756408967, 0, 2),
        # Sums of XM's steps wrap.
        parse_as_sent("XM,100,2147483647,2147483647"),
        # Steps whose way is 0, a rate of -2^31, and a move of two motors that end far apart.
        HM(5780, 0, 0),
        LM(-(2**31), 12, 0, 5, 3, 900_000),
        SM(100_001, 0, 0),
    ],
    ids=lambda command: command.wire(),
)
def test_what_wraps_is_as_on_the_virtual_board(command: MotionCommand) -> None:
    start = LT(2, 700_000_000, -5, -900_000_000, 7)
    played = agree("3.0.3", [start, command])
    assert played == 2 or arithmetic.execute(command, State()).ticks > LONG_TICKS


@pytest.mark.parametrize("command", [HM(179, 595, 2), HM(400, -2475, -1), HM(18705, 1507, -1168), HM(25000, 595, 590)])
def test_old_homing_goes_the_way_of_the_virtual_board(command: HM) -> None:
    assert agree("2.8.1", [SM(40, 3, -1), command]) == 2
