"""A plan becomes what a board is sent: the best commands that its firmware has, exact to the step.

The board's step counters are the only truth about where the pen is, so the encoder carries their exact value along: it solves
every command's rate from the phase that the board will have when it gets there. At the end of every motion the counters are
`round(kinematics.steps(end - origin))`, over any length. Time is plan time, stretched by the tick that some firmware loses
after each command; motion is never sped up to make good for it.

Pieces are merged until the queue holds enough of them, and a motion that would still starve the board is slowed down, with a
mark that says so.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from output.ebb import encode_families
from output.ebb.arithmetic import ONE_STEP, TICK_S, State
from output.ebb.commands import EM, LT, S2, SC, SM, SP, SR, Command
from output.ebb.encode_families import Family, Sizing
from output.ebb.encode_pieces import PRIMED, begun_at, borders_of
from output.ebb.firmware import Firmware
from output.ebb.program import ApproachMark, DipMark, LayerMark, Mark, PauseMark, StrokeEnd, StrokeMark
from output.errors import BadCommand
from planning.motion.limits import Kinematics
from planning.motion.plan import Action, Dip, Draw, Dwell, LayerStart, Lift, Lower, Motion, OperatorPause, Travel

# A motion that begins a little faster or slower than planned is as planned after so long.
_BEGUN_S = 0.02
# Servo outputs that share a period of 24 ms after a reset.
ALL_CHANNELS = 8

FamilyName = Literal["auto", "t3", "lt", "lm", "sm", "xm"]


@dataclass(frozen=True, slots=True)
class PenCommands:
    """How the board raises and lowers the pen: servo positions in 1 / 12 MHz, rates in those per period, RB pin (None: RB1).

    `low` is the position of a low lift (None: as up); `channels` servo outputs of 3 ms share a period; `solenoid` is a pen lift
    on the solenoid output instead. `first_lift_s` is how long the very first lift may take: nobody knows where the pen is then.
    """

    up: int
    down: int
    rate_up: int
    rate_down: int
    pin: int | None = None
    servo_timeout_ms: int = 60_000
    first_lift_s: float = 0.5
    low: int | None = None
    channels: int = ALL_CHANNELS
    solenoid: bool = False

    @property
    def rp_pin(self) -> int:
        """The servo's pin as S2 counts it: RB0 is RP3."""
        return 3 + (1 if self.pin is None else self.pin)


@dataclass(frozen=True, eq=False, slots=True)
class BoardSetup:
    """What the encoder must know of machine and board.

    `origin_mm` (2,) is the machine position at which the step counters are 0; `microsteps` is EM's first parameter (1: 1/16).
    `family` is the commands to use: auto takes the best that the firmware has. `sizing` says how long pieces are made.
    """

    kinematics: Kinematics
    firmware: Firmware
    pen: PenCommands
    origin_mm: NDArray[np.float64] = field(default_factory=lambda: np.zeros(2))
    family: FamilyName = "auto"
    microsteps: int = 1
    motors_off_at_end: bool = True
    sizing: Sizing = field(default_factory=Sizing)


def pen_heights(pen: PenCommands, firmware: Firmware) -> Iterator[Command]:
    """The pen's output, heights and speeds, which the board is told before it moves the pen.

    Raises BadCommand for a pen lift that the firmware cannot drive.
    """
    # Said in any case: a board that was another pen lift's before may not have been switched off since.
    yield SC(1, 0 if pen.solenoid else 2)
    if firmware.has(S2(pen.up, pen.rp_pin)):
        yield SC(8, pen.channels)
    elif pen.channels != ALL_CHANNELS:
        raise BadCommand(
            f"firmware {firmware.name} cannot send this pen lift's pulses often enough (SC,8 needs 2.2.0): update the board"
        )
    yield SC(4, pen.up)
    yield SC(5, pen.down)
    if firmware.version >= (1, 9, 2):
        yield SC(11, pen.rate_up)
        yield SC(12, pen.rate_down)
    else:
        yield SC(10, pen.rate_up)


def prologue(setup: BoardSetup, *, keep_counters: bool = False) -> Iterator[Command | Mark]:
    """What comes first: pen configured and raised, motors on with counters at 0, accumulators at half a step.

    `keep_counters` is for a board that goes on from where it stands, its motors still on.
    """
    pen, firmware = setup.pen, setup.firmware
    yield from pen_heights(pen, firmware)
    if firmware.has(SR(0)):
        yield SR(pen.servo_timeout_ms, 1)
    if not keep_counters:
        yield EM(setup.microsteps, setup.microsteps)
    yield _pen(1, pen.first_lift_s, setup)
    if "LT" in firmware.motion:
        # One tick at half a step: nothing steps, and from here rounding down is rounding to the nearest. EM has cleared the
        # accumulators; where it was not sent, LT itself does.
        yield LT(1, PRIMED, 0, PRIMED, 0, 3 if keep_counters else None)


def epilogue(setup: BoardSetup) -> Iterator[Command | Mark]:
    """What comes last: pen up, and the motors off unless `motors_off_at_end` is False."""
    yield _pen(1, 0, setup)
    if setup.motors_off_at_end:
        yield EM(0, 0)


def encode(actions: Iterable[Action], setup: BoardSetup) -> Iterator[Command | Mark]:
    """The commands of a plan, with marks for layers, strokes and pauses. The board must be as `prologue` leaves it.

    Raises BadCommand when the firmware lacks the commands asked for, or a motor would have to step faster than 25 kHz.
    """
    encoder = Encoder(setup)
    for action in actions:
        yield from encoder.action(action)


def _pen(value: int, wait_s: float, setup: BoardSetup) -> SP:
    wait_ms = int(np.ceil(wait_s * 1000 - 1e-6))
    if setup.pen.pin is not None:
        return SP(value, wait_ms, setup.pen.pin)
    return SP(value, wait_ms or None)


class Encoder:
    """Carries what the board will have executed from one action to the next. It begins at the first motion's start, or in the
    given `state`; `reached` is then set to where a motion that is already moving goes on from, and `rates` to how fast."""

    def __init__(self, setup: BoardSetup, state: State | None = None) -> None:
        self.setup = setup
        self.family: Family = encode_families.choose(setup.family, setup.firmware, setup.kinematics, setup.sizing)
        # Where (2^-31 steps) the part of a stroke ended that the next motion goes on from; None at rest.
        self.reached: NDArray[np.float64] | None = None
        # How fast (2^-31 steps per tick) the board really is there, where that is not quite as fast as the motion begins.
        self.rates: NDArray[np.float64] | None = None
        self.late_s = 0.0
        self.started = state is not None
        if state is not None:
            self.family.state = state

    @property
    def state(self) -> State:
        """Counters and accumulators after everything encoded so far."""
        return self.family.state

    def action(self, action: Action) -> Iterator[Command | Mark]:
        match action:
            case Travel(motion=motion, lower_at_s=lower_at_s):
                yield from self.motion(motion) if lower_at_s is None else self.lowering(motion, lower_at_s)
            case Draw(motion=motion, stroke=stroke, last=last):
                yield from self.motion(motion, last)
                if last:
                    yield StrokeEnd(stroke, self.family.state.position)
            case Lower(wait_s=wait_s, stroke=stroke):
                yield StrokeMark(stroke)
                yield self.pen(0, wait_s + self.late_s)
                self.late_s = 0.0
            case Lift(wait_s=wait_s, height=height):
                yield self.low(wait_s) if height == "low" else self.pen(1, wait_s)
            case Dwell(duration_s=duration_s):
                yield from self.wait(duration_s)
            case Dip(lower_s=lower_s, dwell_s=dwell_s, lift_s=lift_s):
                yield DipMark()
                yield self.pen(0, lower_s)
                yield from self.wait(dwell_s)
                yield self.pen(1, lift_s)
            case LayerStart(number=number, name=name):
                yield LayerMark(number, name)
            case OperatorPause(message=message):
                yield PauseMark(message)

    def motion(self, motion: Motion, last: bool = True) -> Iterator[Command | Mark]:
        if not self.started:
            self.started = True
            self.family.state = self._at(motion.start_mm)
        if not len(motion):
            return
        borders = borders_of(motion, self.setup.kinematics, self.setup.origin_mm, self.reached, last)
        if self.rates is not None and self.family.changes_speed:
            borders = begun_at(borders, self.rates, round(_BEGUN_S / TICK_S))
        self.reached, self.rates = None if last else borders.x[-1], None
        away = np.abs(borders.x[0] / ONE_STEP - np.array(self.family.state.position)).max()
        if away > 2.0:
            raise BadCommand(
                f"a motion starts {away:.1f} steps from where the one before it ended; the plan has a gap, plan it again"
            )
        yield from self.family.motion(borders, last)

    def lowering(self, motion: Motion, at_s: float) -> Iterator[Command | Mark]:
        """A travel on whose way the lowering begins: SP waits for its turn in the queue, and there takes a tick.

        Where a single place follows the command that executes, SP would take that place, and the motion would stop until the
        host has filled it again: there the pen is lowered when the travel has ended.
        """
        if not self.family.lowers_in_motion:
            self.late_s = motion.total_s - at_s
            yield from self.motion(motion)
            return
        yield ApproachMark()
        before, after = motion.split(at_s)
        yield from self.motion(before, last=False)
        yield self.pen(0, 0.0)
        yield from self.motion(after)

    def pen(self, value: int, wait_s: float) -> Command:
        command = _pen(value, wait_s, self.setup)
        self.family.waited("SP", (command.duration_ms or 0) / 1000)
        return command

    def low(self, wait_s: float) -> Command:
        """The pen to its low height. SC,4 would be quicker to say, but it acts when it is parsed, while

        earlier lifts still wait in the queue; S2 carries its height and rate through it. Before S2 (2.2.0), a lift all the way.
        """
        pen = self.setup.pen
        if pen.low is None or pen.low == pen.up or pen.solenoid:
            return self.pen(1, wait_s)
        command = S2(pen.low, pen.rp_pin, pen.rate_up, int(np.ceil(wait_s * 1000 - 1e-6)))
        if self.setup.firmware.refusal(command) is not None:
            return self.pen(1, wait_s)
        self.family.waited("SP", (command.delay_ms or 0) / 1000)
        return command

    def wait(self, duration_s: float) -> Iterator[Command]:
        left_ms = round(duration_s * 1000)
        while left_ms > 0:
            part_ms = min(left_ms, self.setup.firmware.max_delay_ms)
            self.family.waited("SM", part_ms / 1000)
            yield SM(part_ms, 0, 0)
            left_ms -= part_ms

    def _at(self, position_mm: NDArray[np.float64]) -> State:
        """Counters and accumulators after `prologue`, at the plan's start."""
        steps = np.rint(self.setup.kinematics.steps(position_mm - self.setup.origin_mm)).astype(np.int64)
        acc = PRIMED if "LT" in self.setup.firmware.motion else 0
        return State((int(steps[0]), int(steps[1])), (acc, acc))
