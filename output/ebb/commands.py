"""Every command that a plot uses, as a small frozen value that knows its wire form.

Pins, memory and counters are in `commands_pins`. The set is closed: a value that a board would refuse cannot be built
(`BadCommand` names the parameter, the value and the bound).
Ranges and versions are those of the EBB protocol references (1.8 to 3.0.3); where the documents and the firmware disagree, the
firmware is right. Times are board time: ticks of 40 us, or milliseconds where the command says so.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import ClassVar

from output.errors import BadCommand

Version = tuple[int, int, int]
Bound = tuple[int, int]

U8: Bound = (0, 255)
U16: Bound = (0, 65535)
U32: Bound = (0, 4294967295)
I32: Bound = (-2147483648, 2147483647)
FLAG: Bound = (0, 1)
INT32_MAX = 2147483647
INT32_MIN = -2147483648
STEPS_PER_MS = 25  # one step per tick of 40 us is the fastest a motor can be stepped: 25 kHz


_parameter_names: dict[type[Command], tuple[str, ...]] = {}


def parameter_names(kind: type[Command]) -> tuple[str, ...]:
    """The parameters of a command in wire order."""
    names = _parameter_names.get(kind)
    if names is None:
        names = _parameter_names[kind] = tuple(field.name for field in fields(kind))
    return names


@dataclass(frozen=True, slots=True)
class Command:
    """Base of all commands. `wire()` is the command exactly as sent, without the line ending.

    `bounds` has the least and greatest value of each parameter, in order. `since` is the first firmware with the command,
    `until` the first without it. An optional parameter is None when it is not sent.
    """

    name: ClassVar[str] = ""
    bounds: ClassVar[tuple[Bound, ...]] = ()
    since: ClassVar[Version] = (1, 0, 0)
    until: ClassVar[Version | None] = None

    def __post_init__(self) -> None:
        absent = ""
        for name, (low, high) in zip(parameter_names(type(self)), self.bounds, strict=True):
            value = getattr(self, name)
            if value is None:
                absent = absent or name
                continue
            if absent:
                raise BadCommand(f"{self.name}: {name} is given but {absent} before it is not; give both or leave both out")
            if type(value) is not int or not low <= value <= high:
                self.refuse(name, value, f"{low} to {high}")
        self.check()

    def check(self) -> None:
        """What the bounds of single parameters do not say. Raises BadCommand."""

    def refuse(self, parameter: str, value: object, bound: str) -> None:
        raise BadCommand(
            f"{self.name}: {parameter} is {value}, allowed is {bound}; the board would refuse it, so change the value"
        )

    @property
    def queued(self) -> bool:
        """True when the command waits in the board's motion queue (as firmware 3 does it; see `Firmware.queues`)."""
        return False

    @property
    def fifo_entries(self) -> int:
        """How many places of the motion queue it takes: 0 when immediate, 2 for TD."""
        return 1 if self.queued else 0

    @property
    def waits_for_idle(self) -> bool:
        """True when the board answers nothing at all until every queued command has been executed."""
        return False

    def wire(self) -> str:
        words = [self.name]
        for name in parameter_names(type(self)):
            value = getattr(self, name)
            if value is None:
                break
            words.append(str(value))
        return ",".join(words)


@dataclass(frozen=True, slots=True)
class MotionCommand(Command):
    """Base of the commands that step the motors. They enable both drivers when they are parsed, unless `CU,50,0`."""

    @property
    def queued(self) -> bool:
        return True


# motion with the rates given: accumulators of 2^31 per step, one addition per tick


@dataclass(frozen=True, slots=True)
class LM(MotionCommand):
    """Until each axis has taken its steps, with constant acceleration. Rates in 2^31 per tick = 25 kHz; see `arithmetic`."""

    name: ClassVar[str] = "LM"
    bounds: ClassVar[tuple[Bound, ...]] = (I32, I32, I32, I32, I32, I32, U32)
    since: ClassVar[Version] = (2, 7, 0)
    rate1: int
    steps1: int
    accel1: int
    rate2: int
    steps2: int
    accel2: int
    clear: int | None = None

    def check(self) -> None:
        for axis, rate, steps in ((1, self.rate1, self.steps1), (2, self.rate2, self.steps2)):
            if steps < 0 and rate < 0:
                self.refuse(f"rate{axis}", rate, f"0 or more when steps{axis} ({steps}) is negative")
        if not (self.steps1 and (self.rate1 or self.accel1)) and not (self.steps2 and (self.rate2 or self.accel2)):
            raise BadCommand(
                "LM: neither axis can move (steps, or rate and acceleration, are 0 on both); leave the command out"
            )


@dataclass(frozen=True, slots=True)
class L3(MotionCommand):
    """LM with a constant jerk. Firmware 3.0.x looks at jerk1 where it should look at jerk2 when it checks for motion."""

    name: ClassVar[str] = "L3"
    bounds: ClassVar[tuple[Bound, ...]] = (I32, I32, I32, I32, I32, I32, I32, I32, U32)
    since: ClassVar[Version] = (3, 0, 0)
    rate1: int
    steps1: int
    accel1: int
    jerk1: int
    rate2: int
    steps2: int
    accel2: int
    jerk2: int
    clear: int | None = None

    def check(self) -> None:
        for axis, rate, steps in ((1, self.rate1, self.steps1), (2, self.rate2, self.steps2)):
            if steps < 0 and rate < 0:
                self.refuse(f"rate{axis}", rate, f"0 or more when steps{axis} ({steps}) is negative")
        moves1 = self.steps1 and (self.rate1 or self.accel1 or self.jerk1)
        moves2 = self.steps2 and (self.rate2 or self.accel2 or self.jerk1)
        if not moves1 and not moves2:
            raise BadCommand("L3: the board would find that neither axis can move; leave it out, or give axis 2 a rate")


@dataclass(frozen=True, slots=True)
class LT(MotionCommand):
    """For `intervals` ticks, with constant acceleration."""

    name: ClassVar[str] = "LT"
    bounds: ClassVar[tuple[Bound, ...]] = ((1, 4294967295), I32, I32, I32, I32, U32)
    since: ClassVar[Version] = (2, 7, 0)
    intervals: int
    rate1: int
    accel1: int
    rate2: int
    accel2: int
    clear: int | None = None

    def wire(self) -> str:
        clear = "" if self.clear is None else f",{self.clear}"
        return f"LT,{self.intervals},{self.rate1},{self.accel1},{self.rate2},{self.accel2}{clear}"


@dataclass(frozen=True, slots=True)
class T3(MotionCommand):
    """For `intervals` ticks, with constant jerk: one piece of a plan."""

    name: ClassVar[str] = "T3"
    bounds: ClassVar[tuple[Bound, ...]] = ((1, 4294967295), I32, I32, I32, I32, I32, I32, U32)
    since: ClassVar[Version] = (3, 0, 0)
    intervals: int
    rate1: int
    accel1: int
    jerk1: int
    rate2: int
    accel2: int
    jerk2: int
    clear: int | None = None

    def __post_init__(self) -> None:
        # Built once per piece of a plan: the common case in one expression, the message in the general way.
        if not (
            0 < self.intervals <= 4294967295
            and self.clear is None
            and -2147483648 <= self.rate1 <= 2147483647
            and -2147483648 <= self.accel1 <= 2147483647
            and -2147483648 <= self.jerk1 <= 2147483647
            and -2147483648 <= self.rate2 <= 2147483647
            and -2147483648 <= self.accel2 <= 2147483647
            and -2147483648 <= self.jerk2 <= 2147483647
        ):
            Command.__post_init__(self)

    def wire(self) -> str:
        clear = "" if self.clear is None else f",{self.clear}"
        return f"T3,{self.intervals},{self.rate1},{self.accel1},{self.jerk1},{self.rate2},{self.accel2},{self.jerk2}{clear}"


@dataclass(frozen=True, slots=True)
class TD(MotionCommand):
    """Two T3 in one: `intervals` ticks from rate A with `jerk`, then as many from rate B with `accel` and minus `jerk`."""

    name: ClassVar[str] = "TD"
    bounds: ClassVar[tuple[Bound, ...]] = ((1, 4294967295), I32, I32, I32, I32, I32, I32, I32, I32, U32)
    since: ClassVar[Version] = (3, 0, 1)
    intervals: int
    rate1a: int
    rate1b: int
    accel1: int
    jerk1: int
    rate2a: int
    rate2b: int
    accel2: int
    jerk2: int
    clear: int | None = None

    @property
    def fifo_entries(self) -> int:
        return 2


# motion with steps and a duration given: constant speed


def _check_step_rate(command: Command, duration_ms: int, axis: int, steps: int) -> None:
    if abs(steps) > STEPS_PER_MS * duration_ms:
        command.refuse(f"axis {axis}", f"{steps} steps in {duration_ms} ms", f"{STEPS_PER_MS} steps per ms (25 kHz)")


@dataclass(frozen=True, slots=True)
class SM(MotionCommand):
    """A straight line at constant speed in `duration_ms`; both steps 0 is a delay (at most 100 s on firmware 3)."""

    name: ClassVar[str] = "SM"
    bounds: ClassVar[tuple[Bound, ...]] = ((1, 4294967295), I32, I32, (0, 3))
    duration_ms: int
    steps1: int
    steps2: int | None = None
    clear: int | None = None

    def check(self) -> None:
        _check_step_rate(self, self.duration_ms, 1, self.steps1)
        _check_step_rate(self, self.duration_ms, 2, self.steps2 or 0)


@dataclass(frozen=True, slots=True)
class XM(MotionCommand):
    """SM for mixed axes: motor 1 takes `steps_a + steps_b`, motor 2 `steps_a - steps_b`."""

    name: ClassVar[str] = "XM"
    bounds: ClassVar[tuple[Bound, ...]] = ((1, 4294967295), I32, I32, (0, 3))
    since: ClassVar[Version] = (2, 3, 0)
    duration_ms: int
    steps_a: int
    steps_b: int
    clear: int | None = None

    def check(self) -> None:
        for axis, steps in ((1, self.steps_a + self.steps_b), (2, self.steps_a - self.steps_b)):
            if not INT32_MIN <= steps <= INT32_MAX:
                self.refuse(f"axis {axis}", steps, f"{INT32_MIN} to {INT32_MAX}")
            _check_step_rate(self, self.duration_ms, axis, steps)


@dataclass(frozen=True, slots=True)
class HM(MotionCommand):
    """A straight line to an absolute step position (home when none is given), once everything queued has been executed."""

    name: ClassVar[str] = "HM"
    bounds: ClassVar[tuple[Bound, ...]] = ((1, 25000), I32, I32)
    since: ClassVar[Version] = (2, 6, 2)
    steps_per_s: int
    position1: int | None = None
    position2: int | None = None

    @property
    def waits_for_idle(self) -> bool:
        return True


@dataclass(frozen=True, slots=True)
class TR(MotionCommand):
    """The longer axis at `steps_per_s`, the other so that both end together. A firmware test command."""

    name: ClassVar[str] = "TR"
    bounds: ClassVar[tuple[Bound, ...]] = ((1, 25000), I32, I32, (0, 3))
    since: ClassVar[Version] = (3, 0, 0)
    steps_per_s: int
    steps1: int
    steps2: int | None = None
    clear: int | None = None

    @property
    def queued(self) -> bool:
        return bool(self.steps1 or self.steps2)


# pen and other servos


@dataclass(frozen=True, slots=True)
class SP(Command):
    """Pen: 0 down (to `SC,5`), 1 up (to `SC,4`), both queued; 2 up at once; 3 up at once and never down again (until `SC,5`).

    `duration_ms` delays the queue after the servo has started; it is not how fast the pen moves.
    """

    name: ClassVar[str] = "SP"
    bounds: ClassVar[tuple[Bound, ...]] = ((0, 3), U16, (0, 7))
    value: int
    duration_ms: int | None = None
    pin: int | None = None

    @property
    def queued(self) -> bool:
        return self.value < 2


@dataclass(frozen=True, slots=True)
class TP(Command):
    """Toggle the pen, relative to its state when this is executed."""

    name: ClassVar[str] = "TP"
    bounds: ClassVar[tuple[Bound, ...]] = (U16,)
    since: ClassVar[Version] = (1, 9, 0)
    duration_ms: int | None = None

    @property
    def queued(self) -> bool:
        return True


@dataclass(frozen=True, slots=True)
class S2(Command):
    """Any servo output: pulse of `position` / 12 MHz on RP`pin`; position 0 turns it off at once."""

    name: ClassVar[str] = "S2"
    bounds: ClassVar[tuple[Bound, ...]] = (U16, (0, 24), U16, U16)
    since: ClassVar[Version] = (2, 2, 0)
    position: int
    pin: int
    rate: int | None = None
    delay_ms: int | None = None

    @property
    def queued(self) -> bool:
        return self.position > 0


@dataclass(frozen=True, slots=True)
class SC(Command):
    """Pen and stepper configuration: 4 pen-up and 5 pen-down position (1 / 12 MHz), 11 and 12 rates up and down, ..."""

    name: ClassVar[str] = "SC"
    bounds: ClassVar[tuple[Bound, ...]] = (U8, U16)
    known: ClassVar[dict[int, Bound]] = {1: (0, 2), 2: (0, 2), 4: (1, 65535), 5: (1, 65535), 8: (1, 24), 9: (1, 6), 13: FLAG}
    number: int
    value: int

    def check(self) -> None:
        low, high = self.known.get(self.number, U16)
        if not low <= self.value <= high:
            self.refuse(f"value of SC,{self.number}", self.value, f"{low} to {high}")


@dataclass(frozen=True, slots=True)
class SR(Command):
    """Servo power: off `timeout_ms` after the last servo command (0 never), and on or off now."""

    name: ClassVar[str] = "SR"
    bounds: ClassVar[tuple[Bound, ...]] = (U32, FLAG)
    since: ClassVar[Version] = (2, 6, 0)
    timeout_ms: int
    state: int | None = None


@dataclass(frozen=True, slots=True)
class SE(Command):
    """Engraver output: state, power 0 to 1023, and whether it waits in the motion queue."""

    name: ClassVar[str] = "SE"
    bounds: ClassVar[tuple[Bound, ...]] = (FLAG, (0, 1023), FLAG)
    since: ClassVar[Version] = (2, 1, 0)
    state: int
    power: int | None = None
    in_queue: int | None = None

    @property
    def queued(self) -> bool:
        return self.in_queue == 1


# motors, stop, reset, options


@dataclass(frozen=True, slots=True)
class EM(Command):
    """Motors: 0 off, 1 to 5 on with 1/16 .. full steps (both). Clears positions and accumulators. Queued since 2.8.0.

    Without `enable2` firmware 3 does nothing and sends no reply; versions up to 2.7.0 leave motor 2 as it is.
    """

    name: ClassVar[str] = "EM"
    bounds: ClassVar[tuple[Bound, ...]] = ((0, 5), (0, 5))
    enable1: int
    enable2: int | None = None

    @property
    def queued(self) -> bool:
        return True


@dataclass(frozen=True, slots=True)
class ES(Command):
    """Stop: kills the executing command and the queue; with 1 it also turns the motors off (since 2.8.0)."""

    name: ClassVar[str] = "ES"
    bounds: ClassVar[tuple[Bound, ...]] = (FLAG,)
    since: ClassVar[Version] = (2, 2, 7)
    disable_motors: int | None = None


@dataclass(frozen=True, slots=True)
class R(Command):
    """Back to the state of power-on, without leaving the USB."""

    name: ClassVar[str] = "R"


@dataclass(frozen=True, slots=True)
class RB(Command):
    """Leave the USB and boot again. No reply."""

    name: ClassVar[str] = "RB"
    since: ClassVar[Version] = (2, 5, 4)


@dataclass(frozen=True, slots=True)
class CS(Command):
    """Step positions and accumulators to 0, at once, even during a move."""

    name: ClassVar[str] = "CS"
    since: ClassVar[Version] = (2, 4, 3)


@dataclass(frozen=True, slots=True)
class CU(Command):
    """Options: 1 OK replies, 2 limit checks, 3 LED, 4 queue depth, 10 future syntax, 50 auto enable, 51-53 limit switch, 54
    checksums, 60 power-lost threshold, 61 motor timeout (s), 250-257 the firmware's own debugging.

    `CU,4,0` is refused although firmware 3 takes it: every later motion command would hang the board.
    """

    name: ClassVar[str] = "CU"
    bounds: ClassVar[tuple[Bound, ...]] = (U16, (-32768, 32767))
    known: ClassVar[dict[int, Bound]] = {
        **dict.fromkeys((1, 2, 3, 10, 50, 53, 54, *range(250, 258)), FLAG),
        **dict.fromkeys((51, 52), U8),
        4: (1, 32767),
        60: (0, 1023),
        61: (0, 32767),
    }
    number: int
    value: int

    def check(self) -> None:
        if self.number not in self.known:
            self.refuse("number", self.number, "one of " + ", ".join(map(str, sorted(self.known))))
        low, high = self.known[self.number]
        if not low <= self.value <= high:
            self.refuse(f"value of CU,{self.number}", self.value, f"{low} to {high}")

    @property
    def waits_for_idle(self) -> bool:
        return self.number == 4


@dataclass(frozen=True, slots=True)
class SL(Command):
    """Set variable `index` (0 when not given; the index is new in 3.0) to `value`. Cleared by reset: shows a reboot."""

    name: ClassVar[str] = "SL"
    bounds: ClassVar[tuple[Bound, ...]] = (U8, (0, 31))
    since: ClassVar[Version] = (1, 9, 2)
    value: int
    index: int | None = None


# queries


@dataclass(frozen=True, slots=True)
class V(Command):
    """Version."""

    name: ClassVar[str] = "V"


@dataclass(frozen=True, slots=True)
class QB(Command):
    """Button pressed since the last QB or QG."""

    name: ClassVar[str] = "QB"
    since: ClassVar[Version] = (1, 9, 2)


@dataclass(frozen=True, slots=True)
class QC(Command):
    """Motor current setpoint and supply voltage, as ADC counts."""

    name: ClassVar[str] = "QC"
    since: ClassVar[Version] = (2, 2, 3)


@dataclass(frozen=True, slots=True)
class QE(Command):
    """Motor enables and microstepping."""

    name: ClassVar[str] = "QE"
    since: ClassVar[Version] = (2, 8, 0)


@dataclass(frozen=True, slots=True)
class QG(Command):
    """Status byte: queue, motors, executing, pen, button, power lost, limit switch."""

    name: ClassVar[str] = "QG"
    since: ClassVar[Version] = (2, 6, 2)


@dataclass(frozen=True, slots=True)
class QL(Command):
    """Variable `index`, set with SL."""

    name: ClassVar[str] = "QL"
    bounds: ClassVar[tuple[Bound, ...]] = ((0, 31),)
    since: ClassVar[Version] = (1, 9, 2)
    index: int | None = None


@dataclass(frozen=True, slots=True)
class QM(Command):
    """Executing, motor 1, motor 2, queue not empty."""

    name: ClassVar[str] = "QM"
    since: ClassVar[Version] = (2, 4, 4)


@dataclass(frozen=True, slots=True)
class QP(Command):
    """Pen up (1) or down (0), as last executed."""

    name: ClassVar[str] = "QP"
    since: ClassVar[Version] = (1, 9, 0)


@dataclass(frozen=True, slots=True)
class QR(Command):
    """Servo power."""

    name: ClassVar[str] = "QR"
    since: ClassVar[Version] = (2, 6, 0)


@dataclass(frozen=True, slots=True)
class QS(Command):
    """Step positions, as executed."""

    name: ClassVar[str] = "QS"
    since: ClassVar[Version] = (2, 4, 3)


@dataclass(frozen=True, slots=True)
class QT(Command):
    """The board's nickname."""

    name: ClassVar[str] = "QT"
    since: ClassVar[Version] = (2, 5, 4)


@dataclass(frozen=True, slots=True)
class QU(Command):
    """Utility values: 1 port B at limit, 2 greatest queue depth, 3 queue depth, 4 and 5 stack, 6 waiting commands (3.0.1),
    60 power-lost threshold, 61 motor timeout, 200 accumulators."""

    name: ClassVar[str] = "QU"
    bounds: ClassVar[tuple[Bound, ...]] = (U8,)
    since: ClassVar[Version] = (3, 0, 0)
    known: ClassVar[frozenset[int]] = frozenset((1, 2, 3, 4, 5, 6, 60, 61, 200))
    number: int

    def check(self) -> None:
        if self.number not in self.known:
            self.refuse("number", self.number, "one of " + ", ".join(map(str, sorted(self.known))))
