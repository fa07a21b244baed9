"""The commands that go through the motion queue: SM XM LM L3 LT T3 TD TR HM, SP TP S2, EM, SE.

A handler is a generator: it yields what must be queued (the parser spins while the queue is full) or WAIT_IDLE, and prints
its reply afterwards, as the board does.
"""

from __future__ import annotations

from collections.abc import Iterator
from enum import Enum
from typing import TYPE_CHECKING

from output.ebb.virtual import single_float as sf
from output.ebb.virtual.motion import acc_after_clear
from output.ebb.virtual.moves import Delay, EnableMotors, Engrave, PenMove, QueueEntry, StepperMove
from output.ebb.virtual.packet import INVALID, Packet
from output.ebb.virtual.registers import ONE_STEP, Ramp, c_divide, int32
from output.ebb.virtual.servo import PEN_RP_PIN

if TYPE_CHECKING:
    from output.ebb.virtual.board import Board


class Wait(Enum):
    """What the parser can wait for besides room in the queue."""

    IDLE = "idle"


Handling = Iterator[QueueEntry | Wait]

TICKS_PER_MS = 25
LONGEST_DELAY_MS = 100_000
FASTEST = ONE_STEP


# ---- constant speed


def _masks(clear: int | None) -> tuple[int | None, int | None]:
    """Clear of SM, XM and TR: the accumulators of the marked axes start from zero."""
    bits = (clear or 0) & 3
    return (0 if bits & 1 else None, 0 if bits & 2 else None)


def sm(board: Board, p: Packet) -> Handling:
    p.echo()
    duration = p.u32()
    steps1 = p.i32()
    steps2 = p.i32(optional=True)
    clear = p.u32(optional=True)
    if p.failed:
        return
    yield from _straight(board, p, duration or 0, steps1 or 0, steps2 or 0, clear or 0)
    if not p.gives_up:
        p.ok()


def xm(board: Board, p: Packet) -> Handling:
    p.echo()
    duration = p.u32()
    a = p.i32() or 0
    b = p.i32() or 0
    clear = p.u32(optional=True)
    yield from _straight(board, p, duration or 0, int32(a + b), int32(a - b), clear or 0)
    p.ok()


def _straight(board: Board, p: Packet, duration_ms: int, steps1: int, steps2: int, clear: int) -> Handling:
    """Queue a move of `steps1`, `steps2` in about `duration_ms`, or a delay when there is nothing to step."""
    checks = board.limit_checks
    if checks and (duration_ms == 0 or clear > 3):
        p.error(INVALID)
        return
    board.enable_for_move()
    if not steps1 and not steps2 and duration_ms:
        yield Delay(p.name.decode(), max(1, TICKS_PER_MS * min(duration_ms, LONGEST_DELAY_MS)))
        return
    rates = []
    for axis, steps in enumerate((steps1, steps2)):
        rate = rate_for(abs(steps), duration_ms)
        if steps and (rate > FASTEST or rate == 0):
            if checks:
                p.inline_error(b"!0 Err: <axis%d> step rate too %s" % (axis + 1, b"slow" if rate == 0 else b"high"))
                return
            rate = FASTEST if rate else 1
        rates.append(rate)
    yield _constant_speed(p.name, rates, (steps1, steps2), _masks(clear), TICKS_PER_MS * duration_ms)


def rate_for(steps: int, duration_ms: int) -> int:
    """The rate register of SM and XM, in the board's single-precision arithmetic; too fast by far becomes 2^31 - 1."""
    if duration_ms == 0:
        return ONE_STEP - 1 if steps else 0
    per_step = sf.divide(sf.RATE_PER_STEP_PER_MS, sf.from_int(duration_ms))
    rate = sf.truncated(sf.multiply(sf.from_int(steps), per_step))
    return rate if rate < 1 << 32 else ONE_STEP - 1


def _constant_speed(
    name: bytes, rates: list[int], steps: tuple[int, int], clear: tuple[int | None, int | None], about_ticks: int
) -> StepperMove:
    return StepperMove(
        command=name.decode(),
        ramps=(Ramp(rates[0], unsigned=True), Ramp(rates[1], unsigned=True)),
        clear=clear,
        steps=(abs(steps[0]), abs(steps[1])),
        signs=(-1 if steps[0] < 0 else 1, -1 if steps[1] < 0 else 1),
        about_ticks=about_ticks,
    )


def tr(board: Board, p: Packet) -> Handling:
    p.echo()
    frequency = p.u32() or 0
    steps1 = p.i32() or 0
    steps2 = p.i32(optional=True) or 0
    clear = p.u32(optional=True) or 0
    if not 1 <= frequency <= 25_000:
        if p.firmware.one_error:
            p.say(b"!1 Err: Invalid step rate")
        else:
            p.inline_error(b"!0 Err: StepRate invalid value.")
    elif not p.failed and board.limit_checks and clear > 3:
        p.error(INVALID)
    elif not p.failed and (steps1 or steps2):
        board.enable_for_move()
        yield _at_frequency(p.name, frequency, steps1, steps2, _masks(clear))
    p.ok()


def hm(board: Board, p: Packet) -> Handling:
    p.echo()
    frequency = min(max(p.u32() or 0, 1), 25_000)
    target1 = p.i32(optional=True) or 0
    target2 = p.i32(optional=True) or 0
    yield Wait.IDLE
    position, _ = board.motion.state(board.now)
    steps1, steps2 = int32(target1 - position[0]), int32(target2 - position[1])
    if steps1 or steps2:
        board.enable_for_move()
        yield _at_frequency(p.name, frequency, steps1, steps2, (None, None))
    p.ok()


def _at_frequency(name: bytes, frequency: int, steps1: int, steps2: int, clear: tuple[int | None, int | None]) -> StepperMove:
    """The longer axis at `frequency`, the other in proportion, so that the line is straight."""
    longer, shorter = max(abs(steps1), abs(steps2)), min(abs(steps1), abs(steps2))
    hertz = sf.from_int(frequency)
    major = sf.truncated(sf.multiply(hertz, sf.RATE_PER_STEP_PER_S))
    share = sf.divide(sf.multiply(sf.from_int(shorter), hertz), sf.from_int(longer))
    minor = min(max(sf.truncated(sf.multiply(share, sf.RATE_PER_STEP_PER_S)), 1), ONE_STEP - 1)
    rates = [major, minor] if abs(steps1) >= abs(steps2) else [minor, major]
    return _constant_speed(name, rates, (steps1, steps2), clear, longer * 25_000 // frequency)


# ---- low-level moves


def signed_ramp(rate: int, accel: int, jerk: int) -> Ramp:
    """The registers as the parser leaves them: the rate half a tick back, so that the polynomial is that of the parameters."""
    return Ramp(int32(rate - c_divide(accel, 2) + c_divide(jerk, 6)), accel, jerk)


def _clears(clear: int | None, ramps: tuple[Ramp, Ramp]) -> tuple[int | None, int | None]:
    bits = min(clear or 0, 3)
    return (
        acc_after_clear(ramps[0]) if bits & 1 else None,
        acc_after_clear(ramps[1]) if bits & 2 else None,
    )


def _stepwise(board: Board, p: Packet, with_jerk: bool) -> Handling:
    """LM and L3."""
    p.echo()
    values: list[int] = []
    for _ in range(2):
        values += [p.i32() or 0, p.i32() or 0, p.i32() or 0, (p.i32() or 0) if with_jerk else 0]
    clear = p.u32(optional=True)
    if p.failed:
        return
    r1, s1, a1, j1, r2, s2, a2, j2 = values
    # The board looks at the first axis' jerk in both tests.
    if board.limit_checks and not ((r1 or a1 or j1) and s1) and not ((r2 or a2 or j1) and s2):
        p.error(INVALID)
        return
    axes = []
    for rate, steps, accel, jerk in ((r1, s1, a1, j1), (r2, s2, a2, j2)):
        if steps < 0:
            if rate < 0:
                if p.firmware.since(3, 0, 1):
                    p.ok()
                p.error(INVALID)
                return
            # The jerk keeps its sign.
            rate, steps, accel = int32(-rate), -steps, int32(-accel)
        axes.append((signed_ramp(rate, accel, jerk), steps))
    ramps = (axes[0][0], axes[1][0])
    steps_to_take = (axes[0][1], axes[1][1])
    board.enable_for_move()
    yield StepperMove(
        p.name.decode(), ramps, _clears(clear, ramps), steps=steps_to_take, about_ticks=_about_ticks(ramps, steps_to_take)
    )
    p.ok()


def _about_ticks(ramps: tuple[Ramp, Ramp], steps: tuple[int, int]) -> int:
    """Duration at the starting rates; only the estimate of the queue's lead uses it."""
    return max(
        (count * ONE_STEP // max(1, abs(ramp.rate(1))) for ramp, count in zip(ramps, steps, strict=True) if count), default=1
    )


def lm(board: Board, p: Packet) -> Handling:
    return _stepwise(board, p, with_jerk=False)


def l3(board: Board, p: Packet) -> Handling:
    return _stepwise(board, p, with_jerk=True)


def _timed(p: Packet, intervals: int, ramps: tuple[Ramp, Ramp], clear: tuple[int | None, int | None]) -> StepperMove:
    # The board clears AllDone in the last tick too: the next entry is loaded one tick late.
    return StepperMove(p.name.decode(), ramps, clear, ticks=intervals, dead_ticks=1)


def _timewise(board: Board, p: Packet, with_jerk: bool) -> Handling:
    """LT and T3."""
    p.echo()
    intervals = p.u32() or 0
    values: list[int] = []
    for _ in range(2):
        values += [p.i32() or 0, p.i32() or 0, (p.i32() or 0) if with_jerk else 0]
    clear = p.u32(optional=True)
    if p.failed:
        return
    if board.limit_checks and intervals == 0:
        p.error(INVALID)
        return
    ramps = (signed_ramp(*values[:3]), signed_ramp(*values[3:]))
    board.enable_for_move()
    yield _timed(p, intervals, ramps, _clears(clear, ramps))
    p.ok()


def lt(board: Board, p: Packet) -> Handling:
    return _timewise(board, p, with_jerk=False)


def t3(board: Board, p: Packet) -> Handling:
    return _timewise(board, p, with_jerk=True)


def td(board: Board, p: Packet) -> Handling:
    """Two T3 halves in one command; only the first one clears."""
    p.echo()
    intervals = p.u32() or 0
    r1a, r1b, a1, j1, r2a, r2b, a2, j2 = (p.i32() or 0 for _ in range(8))
    clear = p.u32(optional=True)
    if p.failed:
        return
    if board.limit_checks and intervals == 0:
        p.error(INVALID)
        return
    first = (signed_ramp(r1a, 0, j1), signed_ramp(r2a, 0, j2))
    second = (signed_ramp(r1b, a1, int32(-j1)), signed_ramp(r2b, a2, int32(-j2)))
    board.enable_for_move()
    yield _timed(p, intervals, first, _clears(clear, first))
    yield _timed(p, intervals, second, (None, None))
    p.ok()


# ---- pen, motors, engraver


def _pen_ticks(duration_ms: int | None) -> int:
    return max(1, TICKS_PER_MS * (duration_ms or 0))


def sp(board: Board, p: Packet) -> Handling:
    p.echo()
    value = p.u8()
    duration = p.u16(optional=True)
    pin = p.u8(optional=True)
    if p.failed:
        return
    servo = board.servo
    value = value or 0
    immediate = value >= 2 and p.firmware.since(3, 0, 1)
    rp_pin = PEN_RP_PIN if pin is None or pin > 7 else pin + 3
    if immediate:
        if value >= 3:
            servo.maximum = servo.minimum
            board.retarget_queued_pen_moves(servo.minimum)
        board.send_pen(PenMove("SP", 0, servo.minimum, servo.rate_up, rp_pin))
    else:
        up = value >= 1
        target, rate = (servo.minimum, servo.rate_up) if up else (servo.maximum, servo.rate_down)
        yield PenMove("SP", _pen_ticks(duration), target, rate, rp_pin)
    p.ok()


def tp(board: Board, p: Packet) -> Handling:
    p.echo()
    duration = p.u16(optional=True)
    if p.failed:
        return
    servo = board.servo
    target, rate = (servo.maximum, servo.rate_down) if servo.up else (servo.minimum, servo.rate_up)
    yield PenMove("TP", _pen_ticks(duration), target, rate, PEN_RP_PIN)
    p.ok()


def s2(board: Board, p: Packet) -> Handling:
    p.echo()
    position = p.u16()
    if p.failed:
        return
    pin = p.take_number(0, 24)
    rate = p.u16(optional=True)
    delay = p.u16(optional=True)
    if p.has_failed():
        return
    if position == 0:
        board.stop_servo_output(pin or 0)
    else:
        yield PenMove("S2", _pen_ticks(delay), position or 0, rate or 0, pin or 0)
    p.ok()


def em(_board: Board, p: Packet) -> Handling:
    p.echo()
    motor1 = p.u8()
    motor2 = p.u8(optional=True)
    if p.failed:
        return
    if motor2 is None:
        # With one parameter the board does nothing and forgets to reply.
        return
    yield EnableMotors("EM", motor1 or 0, motor2)
    p.ok()


def se(board: Board, p: Packet) -> Handling:
    p.echo()
    state = p.u8()
    power = p.u16(optional=True)
    queued = p.u8(optional=True)
    if p.failed:
        return
    if (state or 0) > 1 or (power or 0) > 1023 or (queued or 0) > 1:
        p.error(INVALID)
        if not p.firmware.one_error:
            p.ok()
        return
    level = (512 if power is None else power) if state else 0
    if queued:
        yield Engrave("SE", state or 0, level)
    else:
        board.engraver_power = level
    p.ok()
