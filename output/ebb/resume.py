"""Where an interrupted plot stands: the journal's bounds, the board's own position, and the same program made again.

After a crash the board goes on with what it had queued and then stands still, pen where it was. The journal says which commands
are executed for certain and how many can have been sent; between the two, the board's step counters (QS) say which it was:

    |  executed, by the journal  |  may be executed  |  never sent  |
                                 ^ searched for the place where the counters are what the board says ^

A board that nobody stopped stands at the end of the last command that it was sent, which is one of those written ahead last.
Else it stands within a command, on the way that its motors take in it.

The program must be the same: made from the same drawing, settings and version, which `journal.differences` of the heads tells.
A pause on the path sends something else in place of its rest, which the journal has word for word.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from math import hypot, inf

from output.ebb import arithmetic, arithmetic_old
from output.ebb.arithmetic import ONE_STEP, NeverEnds, Segment, State, StepRateRefused
from output.ebb.commands import CS, EM, S2, SP, TP, Command, MotionCommand
from output.ebb.commands_text import parse_as_sent
from output.ebb.firmware import Firmware
from output.ebb.journal import LEASE, Held, PlotState
from output.ebb.program import Mark, Program, StrokeEnd, StrokeMark
from output.ebb.session import Board
from output.errors import LinkLost, PositionLost

Steps = tuple[int, int]
Way = tuple[Segment, ...]

# So many of the last commands can have been lost with the cable.
_UNANSWERED = 4
# The way of a command is followed by so many straight lines for each of its segments; what is this near to it is on it.
_LOOKS = 16
_ON_THE_WAY_STEPS = 2.0


@dataclass(frozen=True, slots=True)
class Place:
    """A place in a program. `command` is the first that is not wholly executed there (counted from 0), `stroke` the stroke it
    belongs to or None between strokes, `pen_down` as commanded, `steps` both motors' counters there, `drawn_steps` the length
    that has been drawn of this stroke, along its commands, in steps (the norm of both motors'). `next_stroke` is the first that
    is not wholly drawn."""

    command: int
    stroke: int | None
    pen_down: bool
    steps: Steps
    drawn_steps: float
    next_stroke: int = 0


@dataclass(frozen=True, slots=True)
class _Piece:
    """One command of the program: from where to where the motors go, and what holds after it. `drawn` are the ways of its
    stroke's commands with the pen down, `drawn_before` of which come before it."""

    index: int
    start: Steps
    end: Steps
    stroke: int | None
    pen_down: bool
    drawn: list[Way]
    drawn_before: int
    next_stroke: int
    way: Way = ()

    def drawn_steps(self, along_steps: float) -> float:
        """How much of the stroke is drawn where so much of the command's way is behind."""
        return sum(_length(_corners(way)) for way in self.drawn[: self.drawn_before]) + along_steps * self.pen_down


def position_lost(board: Board, state: PlotState) -> str | None:
    """Why the board's counters cannot be trusted to be where the pen is; None when they can.

    Asks the board; nothing moves. A hand can still have pushed a machine whose motors are on; that nobody can tell.
    """
    token = state.part.get("token", state.head.get("token"))
    if not isinstance(token, int) or not board.has_token(token):
        return "the board was switched off, restarted, let go of its motors or given another job since"
    if board.motors_off():
        return "the motors were switched off since, so that the carriage can have been moved"
    if state.ended == "stopped":  # firmware before 2.8.0 cannot say that its motors are off
        return "the motors were let go when the plot was stopped, so that the carriage can have been moved"
    if board.supply_failed() or (state.ended or "").startswith(PositionLost.__name__):  # firmware 2 keeps no note of it
        return "the motors' power failed since, so that the machine is not where the board counts it"
    return None


def ran_out(board: Board, state: PlotState, program: Program) -> bool:
    """Whether the board has executed all of the part's `program` by itself, though nobody was there any more to note it.

    The last command switches the motors off, and a plot that was cut off in its last second had sent it. Whoever lets go of the
    motors otherwise (`Board.begin_job`, a restart, a stop) has taken the token away or is in the journal.
    """
    began = bool(state.strokes_done) or state.stroke is not None
    token = state.part.get("token")
    if state.ended is not None or state.held is not None or not began:
        return False
    if not isinstance(token, int) or not board.has_token(token):
        return False
    if not board.motors_off() or board.steps() != (0, 0):
        return False
    return state.sent >= sum(isinstance(item, Command) for item in program)


def find_place(
    program: Program, firmware: Firmware, state: PlotState, steps: Steps | None, start: Steps = (0, 0), first: int = 0
) -> Place | None:
    """Where in `program` a board stands whose counters are `steps`, searched only where the journal allows.

    With `steps` None the position is not known: the place is after the last command that is executed for certain, which may
    draw up to the queue's length twice but leaves no gap. None when the counters fit nowhere: they were changed since.
    `start` is where the counters stood when the program began, `first` the stroke that it begins with. Where several places
    fit, the end of one of the commands that a board without a host would have come to is taken, else the earliest. Where none
    does, because damage has cost the journal the hold that replaced commands since the part began, a place on the stroke that
    was being drawn is taken.
    Linear in the commands of the program up to the place.
    """
    if state.sent == 0 and steps in (None, start):
        return Place(0, None, False, start, 0.0, first)
    # The number of the first command after which a board without a host can have stood still.
    ran_on_from = state.sent - LEASE - _UNANSWERED - 1 if _left_alone(state) else state.sent
    found: Place | None = None
    elsewhere: Place | None = None
    for piece in _pieces(_as_sent(program, state.held), firmware, start, first):
        if piece.index < state.executed - 1 or (steps is not None and piece.index >= state.sent):
            on_stroke = state.held is None and state.stroke is not None and piece.stroke == state.stroke and piece.pen_down
            if steps is not None and elsewhere is None and on_stroke:
                elsewhere = _inside(piece, steps)
            continue
        if steps is None:
            if piece.index == state.executed - 1 or state.executed == 0:
                return _after(piece) if state.executed else _before(piece)
            continue
        if piece.end == steps and piece.index >= ran_on_from:
            return _after(piece)
        if found is None and piece.end == steps:
            found = _after(piece)
        if found is None and piece.index >= state.executed:
            found = _inside(piece, steps)
    return found or elsewhere


def _left_alone(state: PlotState) -> bool:
    """Whether nobody stopped the board: the program was killed, or the cable pulled."""
    return state.ended is None or state.ended.startswith(LinkLost.__name__)


def _as_sent(program: Program, held: Held | None) -> Iterator[Command | Mark]:
    """The program as far as it was followed, and what a hold has sent in place of the rest."""
    commands = 0
    for item in program:
        if held is not None and isinstance(item, Command):
            if commands == held.commands:
                break
            commands += 1
        yield item
    if held is not None:
        yield from (parse_as_sent(wire) for wire in held.wires)


def _after(piece: _Piece) -> Place:
    drawn_steps = piece.drawn_steps(_length(_corners(piece.way)))
    return Place(piece.index + 1, piece.stroke, piece.pen_down, piece.end, drawn_steps, piece.next_stroke)


def _inside(piece: _Piece, steps: Steps) -> Place | None:
    """The place on the way of a command that is nearest to these counters; None when it is not there."""
    if not piece.way:
        return None
    best, along_steps, covered = inf, 0.0, 0.0
    for a, b in pairwise(_corners(piece.way)):
        length = hypot(b[0] - a[0], b[1] - a[1])
        share = 0.0
        if length:
            share = ((steps[0] - a[0]) * (b[0] - a[0]) + (steps[1] - a[1]) * (b[1] - a[1])) / length**2
            share = min(max(share, 0.0), 1.0)
        apart = hypot(a[0] + share * (b[0] - a[0]) - steps[0], a[1] + share * (b[1] - a[1]) - steps[1])
        if apart < best:
            best, along_steps = apart, covered + share * length
        covered += length
    if best > _ON_THE_WAY_STEPS:
        return None
    return Place(piece.index, piece.stroke, piece.pen_down, steps, piece.drawn_steps(along_steps), piece.next_stroke)


def _before(piece: _Piece) -> Place:
    return Place(piece.index, piece.stroke, False, piece.start, 0.0, piece.next_stroke)


def _corners(way: Way) -> list[tuple[float, float]]:
    """The way of both motors in a command, in steps with their fractions, as a line: a command may turn, and even come back."""
    points = []
    for segment in way:
        ticks = [segment.ticks * k // _LOOKS for k in range(_LOOKS + 1)]
        (one, two), (first, second) = segment.phase, segment.profile
        points += [((one + first.total(t)) / ONE_STEP, (two + second.total(t)) / ONE_STEP) for t in ticks]
    return points


def _length(line: list[tuple[float, float]]) -> float:
    return sum(hypot(b[0] - a[0], b[1] - a[1]) for a, b in pairwise(line))


def _pieces(program: Program, firmware: Firmware, start: Steps, first: int) -> Iterator[_Piece]:
    """The program's commands with the counters before and after each, by the firmware's arithmetic."""
    execute = arithmetic_old.execute if firmware.old_arithmetic else arithmetic.execute
    state, stroke, down, index, coming = State(position=start), None, False, 0, first
    drawn: list[Way] = []
    for item in program:
        if isinstance(item, StrokeMark):
            stroke, drawn, coming = item.index, [], item.index
        elif isinstance(item, StrokeEnd):
            stroke, coming = None, item.index + 1
        if not isinstance(item, Command):
            continue
        before = state.position
        way: Way = ()
        if isinstance(item, EM | CS):
            state = State()
            before = state.position
        elif isinstance(item, SP):
            down = item.value == 0
        elif isinstance(item, TP):
            down = not down
        elif isinstance(item, S2):
            down = False  # a low lift
        elif isinstance(item, MotionCommand):
            try:
                done = execute(item, state)
            except (NeverEnds, StepRateRefused):
                return
            state, way = done.state, done.segments
        yield _Piece(index, before, state.position, stroke, down, drawn, len(drawn), coming, way)
        if down and way:
            drawn.append(way)
        index += 1
