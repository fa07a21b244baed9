"""Play a program through the board's exact arithmetic, fast: what moves when, in chunks of numpy rows.

A row is one stretch of time with constant jerk (or none): a T3, half a TD, the part of an LM until its first axis stops, a
wait. Runs of timed commands are computed as arrays; the rest goes through `arithmetic.execute`. Positions are physical: they
go on through EM, CS and R, which only clear the board's counters.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from output.ebb import arithmetic, arithmetic_old
from output.ebb.abilities import Abilities
from output.ebb.arithmetic import (
    ONE_STEP,
    STILL,
    TICKS_PER_MS,
    NeverEnds,
    Profile,
    State,
    StepRateRefused,
    negated,
    ticks_of_wait,
)
from output.ebb.command_file import Line
from output.ebb.commands import CS, CU, EM, ES, LT, QB, QG, RB, S2, SC, SL, SM, SP, T3, TD, TP, XM, Command, MotionCommand, R
from output.ebb.commands_pins import BL
from output.ebb.firmware import Firmware
from output.ebb.program import (
    DipMark,
    LayerMark,
    Mark,
    PauseMark,
    Slowed,
    StrokeEnd,
    StrokeMark,
    refused_in_a_stream,
    what_it_takes_from_a_stream,
)

Ints = NDArray[np.int64]

MOVE, WAIT, PEN = 0, 1, 2
_CHUNK_ROWS = 65536
_PEN_PIN = 4  # RP4 is RB1, the pen servo
_SLOT_MS = 3  # a servo channel's
_REST_RATE = ONE_STEP // 2500  # ten steps a second: slower is at rest
# Within these bounds int64 holds every sum of a row's rates; others are computed with Python's integers.
_LONGEST = 1 << 20
_STEEPEST = 1 << 40
_HUGE = 1 << 62
HALF = ONE_STEP // 2

# ticks, dead ticks, Rate, Accel and Jerk of both axes, kind, place of the command, its line (0: not from a file)
_Row = tuple[int, int, int, int, int, int, int, int, int, int, int]


@dataclass(frozen=True, eq=False, slots=True)
class Rows:
    """n rows in order of time. `phase` (n, 2): both motors' positions at the row's start in 2^-31 steps, with the fraction that
    the accumulator holds, centred on the step counter's cell; `counter` (n + 1, 2): the step counters before each row and at
    the end. Both in physical steps. `r0`, `accel`, `jerk` (n, 2) as in `arithmetic.Profile`.

    `ticks` execute, `dead` pass after them. `kind` is MOVE, WAIT or PEN; `pen_down`, `layer` and `stroke` hold during the row;
    `command` is the place of its command in the program, counting commands from 0.
    """

    ticks: Ints
    dead: Ints
    phase: Ints
    counter: Ints
    r0: Ints
    accel: Ints
    jerk: Ints
    kind: Ints
    pen_down: NDArray[np.bool_]
    layer: Ints
    stroke: Ints
    command: Ints

    def __len__(self) -> int:
        return len(self.ticks)


@dataclass(slots=True)
class Replay:
    """Iterate `rows()` once; then the totals, the problems (why it should not be sent) and the warnings are complete.

    `start_steps` are the physical steps at which the program begins; `microsteps` is the EM setting that they are counted in.
    """

    program: Iterable[Command | Mark | Line]
    firmware: Firmware
    start_steps: tuple[int, int] = (0, 0)
    microsteps: int = 1
    problems: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    slowed: list[Slowed] = field(default_factory=list)
    commands: int = 0
    pen_lifts: int = 0
    pauses: int = 0
    pen_down: bool = False
    motors_on: bool = False
    layer_names: dict[int, str] = field(default_factory=dict)
    _state: State = field(default_factory=State)
    _shift: tuple[int, int] = (0, 0)
    _scale: int = 1
    _servo: tuple[int, int] = (22565, 15302)
    _down_set: bool = False
    _rate_down: int = 400
    _channels: int = 8
    _pen_rp: int = _PEN_PIN
    _falling: int | None = None
    _dipping: bool = False
    _ends: list[tuple[int, int, StrokeEnd]] = field(default_factory=list)
    _tag: tuple[bool, int, int] = (False, 0, -1)
    _line: int = 0
    _rows: list[_Row] = field(default_factory=list)
    _counted: list[tuple[int, ...]] = field(default_factory=list)
    _tags: list[tuple[int, tuple[bool, int, int]]] = field(default_factory=list)

    def rows(self) -> Iterator[Rows]:
        """The rows, in chunks of at most about 65536."""
        self._shift = self.start_steps
        # One piece of a plan is one T3: by far the most common, so it is looked for first.
        plain = not self.firmware.old_arithmetic
        for entry in self.program:
            line, item = entry if isinstance(entry, Line) else (0, entry)
            if (
                plain and type(item) is T3 and item.clear is None and item.intervals <= _LONGEST
                and not self._counted and self._falling is None
            ):  # fmt: skip
                if not self._tags or self._tags[-1][1] is not self._tag:
                    self._retag()
                one, two = (item.rate1, item.accel1, item.jerk1), (item.rate2, item.accel2, item.jerk2)
                self._rows.append((item.intervals, 1, *one, *two, MOVE, self.commands, line))
                self.commands += 1
                if len(self._rows) >= _CHUNK_ROWS:
                    yield self._flush()
                continue
            self._line = line
            if not isinstance(item, Command):
                self._mark(item)
                continue
            index, self.commands = self.commands, self.commands + 1
            if (refusal := self.firmware.refusal(item)) is not None:
                self._problem(refusal)
                continue
            counts = isinstance(item, MotionCommand) and not self._is_timed(item)
            # What moves in one way ends what was gathered in the other; whatever may clear the counters ends both.
            if self._rows and (counts or not item.queued or isinstance(item, EM)):
                yield self._flush()
            if self._counted and ((not counts and not isinstance(item, SP | TP | S2)) or len(self._counted) >= _CHUNK_ROWS):
                yield self._flush_counted()
            if counts and isinstance(item, MotionCommand):
                self._count(item, index)
            elif not self._gathers(item, index):
                self._immediate(item, index)
            if len(self._rows) >= _CHUNK_ROWS:
                yield self._flush()
        if self._rows:
            yield self._flush()
        if self._counted:
            yield self._flush_counted()

    def counters(self) -> tuple[int, int]:
        """Physical steps so far."""
        return self._physical(self._state.position)

    def _problem(self, text: str, line: int | None = None) -> None:
        """`line` when it is not the last that was read."""
        line = self._line if line is None else line
        self.problems.append(f"line {line}: {text}" if line else text)

    def _mark(self, mark: Mark) -> None:
        down, layer, stroke = self._tag
        match mark:
            case LayerMark(number=number, name=name):
                self._tag = (down, number, stroke)
                self.layer_names[number] = name
            case StrokeMark(index=index):
                self._tag = (down, layer, index)
            case StrokeEnd() if self.motors_on:  # else it is part of a program, whose counters began elsewhere
                self._ends.append((len(self._rows), self._line, mark))
                if not self._rows:
                    self._check_ends(np.array([self._state.position]))
            case PauseMark():
                self.pauses += 1
            case DipMark():
                self._dipping = True
            case Slowed():
                self.slowed.append(mark)

    def _check_ends(self, counters: Ints) -> None:
        """Strokes that end, `counters` being those before each row and after the last, where the file says that they do not."""
        for row, line, end in self._ends:
            here, wanted = tuple(counters[row].tolist()), end.steps
            if here != wanted:
                where = f"line {line}: " if line else ""
                at = f"ends at {here[0]}, {here[1]} steps and should at {wanted[0]}, {wanted[1]}"
                self.problems.append(f"{where}stroke {end.index} {at}: commands are missing or changed; export it again")
        self._ends = []

    def _is_timed(self, command: Command) -> bool:
        """Whether the command's sum of rates can be added up with arrays: or it only waits."""
        c = command
        if isinstance(c, T3 | LT | TD):
            return not self.firmware.old_arithmetic and c.clear is None and c.intervals <= _LONGEST
        if isinstance(c, SM):
            return not c.steps1 and not c.steps2 and not self._counted
        return isinstance(c, XM) and not c.steps_a and not c.steps_b and not self._counted

    def _gathers(self, command: Command, index: int) -> bool:
        """Keep a timed command, a wait or a pen move for the next flush: True when it is one."""
        c = command
        if isinstance(c, T3):
            self._timed(c.intervals, (c.rate1, c.accel1, c.jerk1), (c.rate2, c.accel2, c.jerk2), index)
        elif isinstance(c, LT):
            self._timed(c.intervals, (c.rate1, c.accel1, 0), (c.rate2, c.accel2, 0), index)
        elif isinstance(c, TD):
            self._timed(c.intervals, (c.rate1a, 0, c.jerk1), (c.rate2a, 0, c.jerk2), index)
            self._timed(c.intervals, (c.rate1b, c.accel1, negated(c.jerk1)), (c.rate2b, c.accel2, negated(c.jerk2)), index)
        elif isinstance(c, SM | XM):
            self._still(min(c.duration_ms, self.firmware.max_delay_ms) * TICKS_PER_MS, WAIT, index)
        elif isinstance(c, SP | TP | S2) and c.queued:
            self._servo_move(c, index)
        else:
            return False
        return True

    def _timed(self, ticks: int, one: tuple[int, int, int], two: tuple[int, int, int], index: int) -> None:
        self._fall(ticks + 1)
        self._retag()
        self._rows.append((ticks, 1, *one, *two, MOVE, index, self._line))

    def _fall(self, ticks: int) -> None:
        """A pen that is lowered in motion is down from the row on in which it comes half way: so early a lowering shows."""
        if self._falling is None:
            return
        self._falling -= ticks
        if self._falling < 0:
            self._falling = None
            self._set_pen(True)

    def _still(self, ticks: int, kind: int, index: int) -> None:
        if kind != PEN:
            self._fall(ticks)
        if self._counted:
            self._keep_counted(max(ticks, 1), 0, self._still_phase(), self.counters(), (STILL, STILL), kind, index)
            return
        self._retag()
        self._rows.append((max(ticks, 1), 0, 0, 0, 0, 0, 0, 0, kind, index, self._line))

    def _retag(self) -> None:
        if not self._tags or self._tags[-1][1] != self._tag:
            self._tags.append((len(self._rows), self._tag))

    def _servo_move(self, command: SP | TP | S2, index: int) -> None:
        wait_ms = command.delay_ms if isinstance(command, S2) else command.duration_ms
        in_motion = not wait_ms and self._moving()
        self._falling = None
        if not self._down_set and (isinstance(command, TP) or (isinstance(command, SP) and command.value == 0)):
            self._down_set = True  # said once
            self.warnings.append(
                f"{command.wire()} lowers the pen without its height having been set: a stop takes that away, and the "
                "pen would stay up; put SC,4 and SC,5 before it"
            )
        match command:
            case SP():
                if command.pin is not None:
                    self._pen_rp = command.pin + 3
                if self._dipping:
                    self._dipping = command.value == 0
                    self.pen_lifts += not self._dipping
                elif command.value == 0 and in_motion and not self.pen_down:
                    periods = abs(self._servo[1] - self._servo[0]) / 2 / max(self._rate_down, 1)
                    self._falling = int(periods * self._channels * _SLOT_MS * TICKS_PER_MS)
                else:
                    self._set_pen(command.value == 0)
            case TP():
                self._set_pen(not self.pen_down)
            case S2() if command.pin == self._pen_rp:
                self._set_pen(abs(command.position - self._servo[1]) < abs(command.position - self._servo[0]))
        self._still(ticks_of_wait(wait_ms), PEN, index)

    def _moving(self) -> bool:
        """Whether the timed move before this one ended in motion."""
        if not self._rows or self._rows[-1][8] != MOVE:
            return False
        ticks, _, rate1, accel1, jerk1, rate2, accel2, jerk2, *_ = self._rows[-1]
        ends = (rate1 + ticks * (accel1 + ticks * jerk1 / 2), rate2 + ticks * (accel2 + ticks * jerk2 / 2))
        return max(map(abs, ends)) > _REST_RATE

    def _set_pen(self, down: bool) -> None:
        self.pen_lifts += self.pen_down and not down
        self.pen_down = down
        self._tag = (down, *self._tag[1:])

    def _immediate(self, command: Command, index: int) -> None:
        match command:
            case RB() | BL():
                self._problem(refused_in_a_stream(command) or command.wire())
            case R() | ES():
                self.warnings.append(f"{command.wire()} ends whatever moves: `plotter send` refuses it")
                if isinstance(command, R):
                    self._clear()
            case EM():
                self._enable(command)
                self._still(1, WAIT, index)
            case CS():
                self._clear()
            case SC(number=4):
                self._servo = (command.value, self._servo[1])
            case SC(number=5):
                self._servo, self._down_set = (self._servo[0], command.value), True
            case SC(number=10 | 12):
                self._rate_down = command.value
            case SC(number=8):
                self._channels = command.value
            case SP():
                self._falling = None
                self._set_pen(False)
            case CU(number=10 | 54, value=1):
                self.warnings.append(f"{command.wire()} changes how the board answers, which whoever sends this may not expect")
            case CU() | QG() | QB() | SL():
                takes = what_it_takes_from_a_stream(command, Abilities(self.firmware.name, self.firmware.version).variables)
                warning = f"{command.wire()} {takes}: `plotter send` refuses it"
                if takes is not None and warning not in self.warnings:
                    self.warnings.append(warning)

    def _enable(self, command: EM) -> None:
        """EM clears counters and accumulators and may change the step size."""
        self._clear()
        if self.pen_down and not (command.enable1 and (command.enable2 is None or command.enable2)):
            self._problem(f"{command.wire()} lets go of the motors while the pen is down: lift it first")
        self.motors_on = bool(command.enable1)
        if command.enable1 >= self.microsteps:
            self._scale = 1 << (command.enable1 - self.microsteps)
        elif command.enable1:
            self._problem(f"EM,{command.enable1} sets finer steps than the machine's (EM,{self.microsteps}); use that instead")

    def _clear(self) -> None:
        self._shift = self.counters()
        self._state = State()

    def _count(self, command: MotionCommand, index: int) -> None:
        """One command through the scalar arithmetic."""
        execute = arithmetic_old.execute if self.firmware.old_arithmetic else arithmetic.execute
        try:
            done = execute(command, self._state)
        except NeverEnds as error:
            self._problem(f"{command.wire()} never ends ({error}); the queue would wait for it until it is stopped")
            return
        except StepRateRefused as error:
            self._problem(f"{command.wire()}: {error}, which the board refuses; give it another duration")
            return
        if done.overflow:
            rates = [(axis, s.profile[axis], s.ticks) for s in done.segments for axis in (0, 1)]
            self._overflow(command.wire(), *max(rates, key=lambda rate: abs(_furthest(*rate[1:]))), self._line)
        counter = self.counters()
        set_half = command in (LT(1, HALF, 0, HALF, 0), LT(1, HALF, 0, HALF, 0, 3))
        primes = set_half and done.state.position == self._state.position
        kind = WAIT if primes else MOVE
        for i, segment in enumerate(done.segments):
            if i:
                counter = self._physical(((segment.phase[0] + HALF) >> 31, (segment.phase[1] + HALF) >> 31))
            dead = done.dead_ticks if i == len(done.segments) - 1 else 0
            self._keep_counted(segment.ticks, dead, segment.phase, counter, segment.profile, kind, index)
        self._state = done.state

    def _still_phase(self) -> tuple[int, int]:
        return tuple(p * ONE_STEP + a - HALF for p, a in zip(self._state.position, self._state.acc, strict=True))  # type: ignore[return-value]

    def _physical(self, steps: tuple[int, int]) -> tuple[int, int]:
        return (self._shift[0] + steps[0] * self._scale, self._shift[1] + steps[1] * self._scale)

    def _keep_counted(
        self,
        ticks: int,
        dead: int,
        phase: tuple[int, int],
        counter: tuple[int, int],
        profile: tuple[Profile, Profile],
        kind: int,
        index: int,
    ) -> None:
        k = self._scale
        physical = [phase[axis] * k + self._shift[axis] * ONE_STEP for axis in (0, 1)]
        rates = [value * k for axis in (0, 1) for value in profile[axis]]
        row = (ticks, dead, *physical, *counter, *rates, kind, *self._tag, index)
        self._counted.append(tuple(min(max(int(value), -_HUGE), _HUGE) for value in row))

    def _flush_counted(self) -> Rows:
        raw = np.array(self._counted, dtype=np.int64)
        self._counted = []
        return Rows(
            ticks=raw[:, 0],
            dead=raw[:, 1],
            phase=raw[:, 2:4],
            counter=np.vstack((raw[:, 4:6], np.array([self.counters()]))),
            r0=raw[:, [6, 9]],
            accel=raw[:, [7, 10]],
            jerk=raw[:, [8, 11]],
            kind=raw[:, 12],
            pen_down=raw[:, 13].astype(np.bool_),
            layer=raw[:, 14],
            stroke=raw[:, 15],
            command=raw[:, 16],
        )

    def _overflow(self, command: str, axis: int, profile: Profile, ticks: int, line: int) -> None:
        """A rate that becomes more than its register holds; older firmware holds it without a sign."""
        reached, limit, n = _furthest(profile, ticks), f"{ONE_STEP - 1} (25 kHz)", axis + 1
        jump = "beyond which its 32 bits roll over and the motor jumps to another speed: give it less, or fewer intervals"
        if self.firmware.old_arithmetic:
            self._problem(f"{command}: a rate leaves 0 to {limit} within it, by its rate and accel, {jump}", line)
            return
        cause = f"by accel{n} {profile.accel} and jerk{n} {profile.jerk}"
        allowed = f"allowed is -{ONE_STEP} to {limit}"
        self._problem(f"{command}: rate{n} becomes {reached} within {ticks} intervals, {cause}; {allowed}, {jump}", line)

    def _flush(self) -> Rows:
        """Everything gathered, as rows: position * 2^31 + acc grows by the sum of the rates."""
        raw = np.array(self._rows, dtype=np.int64)
        starts = [start for start, _ in self._tags] + [len(raw)]
        lengths = np.diff(starts)
        tags = [np.repeat(np.array(column), lengths) for column in zip(*(tag for _, tag in self._tags), strict=True)]
        self._rows, self._tags = [], []

        ticks = raw[:, 0]
        rate, accel, jerk = raw[:, [2, 5]], raw[:, [3, 6]], raw[:, [4, 7]]
        r0 = rate - _truncated(accel, 2) + _truncated(jerk, 6)
        t = ticks[:, None]
        total = r0 * t + accel * (t * (t + 1) // 2) + jerk * ((t - 1) * t * (t + 1) // 6)
        # What int64 cannot add up has long left the registers.
        steep = np.abs(rate) + (np.abs(accel) + np.abs(jerk) * t.astype(np.float64)) * t > _STEEPEST
        for i, axis in np.argwhere(steep | _leaves_registers(r0, accel, jerk, t)):
            wrapped = arithmetic.Profile(int(r0[i, axis]), int(accel[i, axis]), int(jerk[i, axis]))
            total[i, axis] = arithmetic.wrapped_total(wrapped, int(ticks[i]))
            self._overflow(f"command {int(raw[i, 9]) + 1}", int(axis), wrapped, int(ticks[i]), int(raw[i, 10]))

        start = [self._state.position[axis] * ONE_STEP + self._state.acc[axis] for axis in (0, 1)]
        phase = np.vstack((np.array([start]), start + np.cumsum(total, axis=0)))
        counter, k = phase >> 31, self._scale
        self._check_ends(counter)
        self._state = State(
            (int(counter[-1, 0]), int(counter[-1, 1])),
            (int(phase[-1, 0]) & (ONE_STEP - 1), int(phase[-1, 1]) & (ONE_STEP - 1)),
        )
        shift = np.array(self._shift)
        return Rows(
            ticks=ticks,
            dead=raw[:, 1] * self.firmware.dead_ticks,
            phase=(phase[:-1] - ONE_STEP // 2) * k + shift * ONE_STEP,
            counter=counter * k + shift,
            r0=r0 * k,
            accel=accel * k,
            jerk=jerk * k,
            kind=np.where(_primes(ticks, rate, accel, jerk, counter), WAIT, raw[:, 8]),
            pen_down=tags[0],
            layer=tags[1],
            stroke=tags[2],
            command=raw[:, 9],
        )


def _furthest(profile: Profile, ticks: int) -> int:
    """The rate (2^-31 steps per tick) furthest from 0 in ticks 1 to `ticks`, were its register as wide as it needs."""
    turn = (profile.jerk - 2 * profile.accel) // (2 * profile.jerk) if profile.jerk else 1
    places = {1, ticks, *(min(max(turn + shift, 1), ticks) for shift in (0, 1))}
    return max((profile.rate(t) for t in places), key=abs)


def _truncated(value: Ints, divisor: int) -> Ints:
    return np.asarray(np.sign(value) * (np.abs(value) // divisor))


def _primes(ticks: Ints, rate: Ints, accel: Ints, jerk: Ints, counter: Ints) -> NDArray[np.bool_]:
    """Rows that only set the accumulators, as the encoder's head does: a single tick of half a step, without a step."""
    flat = (rate == HALF).all(axis=1) & ~accel.any(axis=1) & ~jerk.any(axis=1)
    return np.asarray((ticks == 1) & flat & (counter[1:] == counter[:-1]).all(axis=1))


def _leaves_registers(r0: Ints, accel: Ints, jerk: Ints, ticks: Ints) -> NDArray[np.bool_]:
    """(n, 2): whether the rate leaves 32 bits in some tick from 1 to `ticks`."""

    def outside(t: Ints) -> NDArray[np.bool_]:
        rate = r0 + accel * t + jerk * (t * (t - 1) // 2)
        return np.asarray((rate < -ONE_STEP) | (rate >= ONE_STEP))

    turn = _truncated(jerk - 2 * accel, 2) // np.where(jerk != 0, jerk, 1)
    found = outside(np.ones_like(ticks)) | outside(ticks)
    for shift in (-1, 0, 1):
        found |= outside(np.clip(turn + shift, 1, ticks))
    return found
