"""Encoder, arithmetic and virtual board were written apart from the same documents: what one sends, the other must draw."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import Phase, assume, given, settings
from hypothesis import strategies as st

from output.ebb import arithmetic, arithmetic_old
from output.ebb.arithmetic import NeverEnds, State, StepRateRefused
from output.ebb.commands import LM, LT, SM, Command, MotionCommand
from output.ebb.encode import BoardSetup, PenCommands, encode, epilogue, prologue
from output.ebb.firmware import firmware
from output.ebb.program import StrokeEnd
from output.ebb.virtual.board import Board
from output.errors import BadCommand
from planning.motion.plan import Draw
from tests.output.motion_samples import CARTESIAN, COREXY, drawing

PEN = PenCommands(16000, 24000, 400, 400)


def run(board: Board, line: str) -> bytes:
    """Send a line and let everything happen; what came back."""
    board.feed(f"{line}\r".encode())
    while (event := board.next_event()) is not None and (not board.motion.idle or not board.wants_bytes):
        board.advance_to(max(event, board.now + 1))
    return b"".join(sent.data for sent in board.output())


@pytest.mark.parametrize(
    ("version", "family"),
    [
        *[("3.0.3", "auto"), ("3.0.0", "auto"), ("3.0.1", "lt"), ("3.0.2", "lm"), ("3.0.3", "sm"), ("3.0.3", "xm")],
        *[("2.8.1", "auto"), ("2.8.1", "lm"), ("2.7.0", "sm")],
    ],
)
@pytest.mark.parametrize("kinematics", [COREXY, CARTESIAN], ids=["corexy", "cartesian"])
def test_the_virtual_board_takes_every_command_and_ends_every_stroke_where_planned(
    version: str, family: str, kinematics: object
) -> None:
    setup = BoardSetup(kinematics, firmware(version), PEN, family=family)  # type: ignore[arg-type]
    actions = drawing(11, 3, 25)
    ends = {a.stroke: a.motion.end_mm for a in actions if isinstance(a, Draw)}
    execute = arithmetic_old.execute if setup.firmware.old_arithmetic else arithmetic.execute
    board, state, seen = Board(version, timed=False), State(), 0
    for item in [*prologue(setup), *encode(actions, setup), *epilogue(setup)]:
        if isinstance(item, StrokeEnd):
            planned = np.rint(setup.kinematics.steps(ends[item.index])).astype(int)
            assert tuple(board.state()["position"]) == item.steps == tuple(planned)
            seen += 1
        elif isinstance(item, Command):
            assert run(board, item.wire()) == b"OK\r\n", item.wire()
            if isinstance(item, MotionCommand):
                state = execute(item, state).state
                now = board.state()
                assert (tuple(now["position"]), tuple(now["accumulators"])) == state, item.wire()
    assert seen == 3


SMALL = st.one_of(st.integers(-(10**6), 10**6), st.integers(-(2**30), 2**30), st.integers(-9, 9))
RATE = st.one_of(st.integers(0, 2**31 - 1), st.integers(0, 10**6))


@st.composite
def old_motions(draw: st.DrawFn) -> Command:
    kind = draw(st.sampled_from(("SM", "LM", "LT")))
    try:
        if kind == "SM":
            return SM(draw(st.integers(1, 3000)), draw(st.integers(-3000, 3000)), draw(st.integers(-3000, 3000)))
        if kind == "LT":
            signs = draw(st.tuples(st.sampled_from((-1, 1)), st.sampled_from((-1, 1))))
            return LT(draw(st.integers(1, 2000)), signs[0] * draw(RATE), draw(SMALL), signs[1] * draw(RATE), draw(SMALL))
        steps = draw(st.tuples(st.integers(-300, 300), st.integers(-300, 300)))
        return LM(draw(RATE), steps[0], draw(SMALL), draw(RATE), steps[1], draw(SMALL))
    except BadCommand:
        return SM(1, 0, 0)


@settings(max_examples=60, deadline=None, phases=(Phase.explicit, Phase.reuse, Phase.generate))
@given(commands=st.lists(old_motions(), min_size=1, max_size=4))
def test_both_models_of_old_firmware_agree(commands: list[Command]) -> None:
    board, state, old = Board("2.8.1", timed=False), State(), firmware("2.8.1")
    run(board, "EM,1,1")
    for command in commands:
        if old.refusal(command) is not None:
            continue
        try:
            done = arithmetic_old.execute(command, state)
        except (NeverEnds, StepRateRefused):
            continue
        assume(done.ticks < 3_000_000)
        reply = run(board, command.wire())
        assert b"!" not in reply, (command, reply)
        state, now = done.state, board.state()
        assert (tuple(now["position"]), tuple(now["accumulators"])) == state, command
