"""How far a plot is, as the stream tells it to whoever looks and to the journal."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Protocol as Interface

from output.ebb.commands import Command
from output.ebb.program import LayerMark, StrokeEnd


class State(Enum):
    RUNNING = "running"
    HOLDING = "holding"  # what is sent is being finished before a pause
    PAUSED = "paused"


@dataclass(frozen=True, slots=True)
class Progress:
    """How far the plot is. `commands_sent` are on their way, `commands_executed` and all below are done by the board's count.

    `stroke` is the one being drawn or travelled to, None between strokes; `board_time_s` what the executed commands took, in
    board time; `lead_s` how much board time is queued; `stalls` how often the board ran dry, `stalled_s` for how long (host).
    `pen_up` and `steps` (both motors, executed motion only) are the board's own words when last asked, None before.
    """

    state: State = State.RUNNING
    commands_sent: int = 0
    commands_executed: int = 0
    strokes_done: int = 0
    stroke: int | None = None
    layer: LayerMark | None = None
    board_time_s: float = 0.0
    lead_s: float = 0.0
    stalls: int = 0
    stalled_s: float = 0.0
    message: str = ""
    pen_up: bool | None = None
    steps: tuple[int, int] | None = None


@dataclass(slots=True)
class Sent:
    """A command on its way: its number among the queued ones (0 when immediate), its place in the program, its board time."""

    queued: int
    index: int
    seconds: float
    command: Command


class Recorder(Interface):
    """What the stream tells a journal. `sent` comes before the command goes out, `held` before what is sent in
    place of the rest, `executed` after the board counted it."""

    def sent(self, commands: int) -> None: ...
    def held(self, wires: list[str]) -> None: ...
    def executed(self, progress: Progress) -> None: ...
    def stroke_done(self, mark: StrokeEnd, progress: Progress) -> None: ...
