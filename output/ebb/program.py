"""What is sent, in order: board commands, with marks between them that a board never sees.

A program is an iterable of `Command | Mark`. The command file is its text; the streamer sends its commands and keeps its marks.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from output.ebb.commands import CU, QB, QG, SL, Command


@dataclass(frozen=True, slots=True)
class LayerMark:
    """The commands that follow belong to this layer."""

    number: int
    name: str


@dataclass(frozen=True, slots=True)
class ApproachMark:
    """The travel that follows ends with the pen on its way down: before it is the last place to wait with the pen up."""


@dataclass(frozen=True, slots=True)
class DipMark:
    """The pen is up over a well; what follows, until it is raised again, is no ink on the paper."""


@dataclass(frozen=True, slots=True)
class StrokeMark:
    """The commands that follow lower the pen for, and draw, stroke `index` of the plan, until `StrokeEnd`."""

    index: int


@dataclass(frozen=True, slots=True)
class StrokeEnd:
    """Stroke `index` is drawn; `steps` are both motors' positions there, as the board will count them."""

    index: int
    steps: tuple[int, int]


@dataclass(frozen=True, slots=True)
class PauseMark:
    """Wait here, pen up, until the operator says go."""

    message: str


@dataclass(frozen=True, slots=True)
class Slowed:
    """The motion that follows was slowed down for the board: it lasts `lost_s` longer, some pieces `most` times as long."""

    lost_s: float
    most: float


Mark = LayerMark | ApproachMark | DipMark | StrokeMark | StrokeEnd | PauseMark | Slowed
Program = Iterable[Command | Mark]

# Four of the board's 32 variables (SL, QL) hold the job's token, and one whether the motors' supply has failed since; the first
# ones are left to other programs.
TOKEN_SLOT, SUPPLY_SLOT = 24, 28

# What changes how the board answers, or empties its queue, beginnings of the wire form.
_NOT_IN_A_STREAM = ("R,", "RB,", "BL,", "CU,10,", "CU,54,", "CU,1,", "SN,", "ES,")


def refused_in_a_stream(command: Command, variables: int = 32) -> str | None:
    """Why a program must not hold this command; None when it may. `variables` is how many SL has on the board (1 or 32)."""
    if f"{command.wire()},".startswith(_NOT_IN_A_STREAM):
        return f"{command.wire()} cannot be part of a stream, because it changes how the board answers: remove it"
    if (reason := what_it_takes_from_a_stream(command, variables)) is not None:
        return f"{command.wire()} cannot be part of a stream, because it {reason}: remove it"
    return None


def what_it_takes_from_a_stream(command: Command, variables: int = 32) -> str | None:
    """What a program would take from whoever streams it by this command, said after "it"; None when nothing."""
    match command:
        case CU(number=4):
            return "changes the depth of the motion queue, which a stream sets to the longest and counts by"
        case CU(number=60):
            return "changes from which voltage on the motors' supply counts as lost, which a stream watches"
        case QG() | QB():
            return "reads the button away, or the flag of lost power, for which a stream waits"
        case SL(index=index) if variables == 1 or (index or 0) in range(TOKEN_SLOT, SUPPLY_SLOT + 1):
            return "writes where a stream keeps the mark by which it knows a board that has restarted"
    return None
