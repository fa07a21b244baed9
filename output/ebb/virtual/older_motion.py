"""The motion commands of firmware 2.7 and 2.8.1 where they differ from 3.x.

Rates are magnitudes whose direction is fixed for the whole move; a rate that falls below zero rolls over by 2^31; timed moves
have no dead tick; SM computes its rate in integers; EM is queued since 2.8.0.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from output.ebb.virtual.motion_commands import LONGEST_DELAY_MS, TICKS_PER_MS, Handling, Wait
from output.ebb.virtual.moves import Delay, EnableMotors, StepperMove
from output.ebb.virtual.packet import INVALID, Packet
from output.ebb.virtual.registers import ONE_STEP, PHASE_MASK, Ramp, c_divide, int32

if TYPE_CHECKING:
    from output.ebb.virtual.board import Board

LARGEST = (1 << 24) - 1
SLOWEST_MS_PER_STEP = 763  # 1.31 steps/s
LONGEST_OLD_DELAY_MS = 65_536
SHORTEST_HOMING_MS = 10


def integer_rate(steps: int, duration_ms: int) -> int:
    """The rate of SM: 15 fraction bits in one division, 16 more from its remainder when the move is longer than 30 ms."""
    whole, rest = divmod(steps << 15, TICKS_PER_MS * duration_ms)
    rate = whole << 16
    if duration_ms > 30:
        rate += (rest << 16) // (TICKS_PER_MS * duration_ms)
    return rate


def _move(name: bytes, ramps: tuple[Ramp, Ramp], steps: tuple[int, int], clear: tuple[int | None, int | None]) -> StepperMove:
    return StepperMove(
        command=name.decode(),
        ramps=ramps,
        clear=clear,
        steps=(abs(steps[0]), abs(steps[1])),
        signs=(-1 if steps[0] < 0 else 1, -1 if steps[1] < 0 else 1),
    )


def _segment(name: bytes, duration_ms: int, steps: tuple[int, int]) -> StepperMove:
    # A motor steps once a tick at most, whatever rate HM's whole milliseconds come to.
    first, second = (Ramp(min(integer_rate(abs(count), duration_ms), ONE_STEP), unsigned=True) for count in steps)
    move = _move(name, (first, second), steps, (None, None))
    return StepperMove(
        move.command, move.ramps, move.clear, None, move.steps, move.signs, about_ticks=TICKS_PER_MS * duration_ms
    )


def _straight(board: Board, p: Packet, duration_ms: int, steps: tuple[int, int]) -> Handling:
    if board.limit_checks and (not 0 < duration_ms <= LARGEST or max(map(abs, steps)) > LARGEST):
        p.error(INVALID)
        return
    duration_ms = max(1, duration_ms)
    board.enable_for_move()
    if steps == (0, 0):
        # The delay counter has 16 bits: longer ones become nothing.
        ms = 0 if duration_ms > LONGEST_OLD_DELAY_MS else min(duration_ms, LONGEST_DELAY_MS)
        yield Delay(p.name.decode(), max(1, TICKS_PER_MS * ms))
        return
    for axis, count in enumerate(steps):
        fast = abs(count) > TICKS_PER_MS * duration_ms
        slow = count != 0 and abs(count) * SLOWEST_MS_PER_STEP < duration_ms
        if board.limit_checks and (fast or slow):
            limit = b"> 25K steps/second." if fast else b"< 1.31Hz."
            p.inline_error(b"!0 Err: <axis%d> step rate %s" % (axis + 1, limit))
            return
    yield _segment(p.name, duration_ms, steps)


def sm(board: Board, p: Packet) -> Handling:
    duration = p.u32()
    steps1 = p.i32()
    steps2 = p.i32(optional=True)
    if p.failed:
        return
    yield from _straight(board, p, duration or 0, (steps1 or 0, steps2 or 0))
    p.ok()


def xm(board: Board, p: Packet) -> Handling:
    duration = p.u32()
    a = p.i32()
    b = p.i32()
    if p.failed:
        return
    yield from _straight(board, p, duration or 0, (int32((a or 0) + (b or 0)), int32((a or 0) - (b or 0))))
    p.ok()


def hm(board: Board, p: Packet) -> Handling:
    """Home or go to a position; when the shorter axis would be too slow, both go as far as it has to, then the other alone."""
    frequency = p.u16()
    targets = (p.i32(optional=True) or 0, p.i32(optional=True) or 0)
    if p.failed:
        return
    if frequency is None or not 2 <= frequency <= 25_000:
        p.error(INVALID)
        return
    yield Wait.IDLE
    position, _ = board.motion.state(board.now)
    steps = (targets[0] - position[0], targets[1] - position[1])
    if max(map(abs, steps)) > 4_294_967:
        p.error(INVALID)
        return
    board.motion.acc = [0, 0]
    board.enable_for_move()
    for part in _homing_parts(steps, frequency):
        duration_ms = max(SHORTEST_HOMING_MS, max(map(abs, part)) * 1000 // frequency)
        yield _segment(p.name, duration_ms, part)
    p.ok()


def _homing_parts(steps: tuple[int, int], frequency: int) -> list[tuple[int, int]]:
    longer, shorter = max(map(abs, steps)), min(map(abs, steps))
    if longer == 0:
        return []
    duration_ms = max(SHORTEST_HOMING_MS, longer * 1000 // frequency)
    if shorter == 0 or shorter * SLOWEST_MS_PER_STEP >= duration_ms:
        return [steps]
    signs = tuple(-1 if count < 0 else 1 for count in steps)
    first = (signs[0] * shorter, signs[1] * shorter)
    return [first, (steps[0] - first[0], steps[1] - first[1])]


def _magnitude_ramp(rate: int, accel: int) -> Ramp:
    return Ramp((rate - c_divide(accel, 2)) & PHASE_MASK, accel, mask=PHASE_MASK)


def _clears(clear: int | None) -> tuple[int | None, int | None]:
    bits = (clear or 0) & 3
    return (0 if bits & 1 else None, 0 if bits & 2 else None)


def lm(board: Board, p: Packet) -> Handling:
    rate1, steps1, accel1 = p.take_number(0, PHASE_MASK), p.i32(), p.i32()
    rate2, steps2, accel2 = p.take_number(0, PHASE_MASK), p.i32(), p.i32()
    clear = p.u8(optional=True)
    if p.failed:
        return
    if not ((rate1 or accel1) and steps1) and not ((rate2 or accel2) and steps2):
        p.error(INVALID)
        return
    board.enable_for_move()
    ramps = (_magnitude_ramp(rate1 or 0, accel1 or 0), _magnitude_ramp(rate2 or 0, accel2 or 0))
    yield _move(p.name, ramps, (steps1 or 0, steps2 or 0), _clears(clear))
    p.ok()


def lt(board: Board, p: Packet) -> Handling:
    intervals = p.u32()
    rate1, accel1, rate2, accel2 = p.i32(), p.i32(), p.i32(), p.i32()
    clear = p.u8(optional=True)
    if p.failed:
        return
    if not intervals or not (rate1 or rate2):
        p.error(INVALID)
        return
    board.enable_for_move()
    ramps = (_magnitude_ramp(abs(rate1 or 0), accel1 or 0), _magnitude_ramp(abs(rate2 or 0), accel2 or 0))
    signs = (-1 if (rate1 or 0) < 0 else 1, -1 if (rate2 or 0) < 0 else 1)
    yield StepperMove(p.name.decode(), ramps, _clears(clear), ticks=intervals, signs=signs)
    p.ok()


def em(board: Board, p: Packet) -> Handling:
    """Queued since 2.8.0; at once, and with the second motor optional, before it."""
    motor1 = p.u8()
    motor2 = p.u8(optional=not p.firmware.since(2, 8, 0))
    if p.failed:
        return
    entry = EnableMotors("EM", motor1 or 0, motor2)
    if p.firmware.since(2, 8, 0):
        yield entry
    else:
        board.enable_motors(entry)
    p.ok()


def es(board: Board, p: Packet) -> None:
    """Stops SM, XM, HM and LM, and drops them from the queue; timed moves, delays and the pen go on."""
    disable = p.u8(optional=True) if p.firmware.since(2, 8, 0) else None
    if p.failed:
        return
    motion = board.motion
    stoppable = ("SM", "XM", "HM", "LM")
    queued = [(entry, tick) for entry, tick in motion.entries if isinstance(entry, StepperMove) and entry.command in stoppable]
    waiting = queued[0][0].steps if queued else (0, 0)
    running = motion.running
    remaining = (0, 0)
    interrupted = bool(queued)
    kept = [item for item in motion.entries if item not in queued]
    if running is not None and isinstance(running.entry, StepperMove) and running.entry.command in stoppable:
        remaining = motion.remaining(board.now)
        interrupted = True
        board.emergency_stop()
    motion.entries.clear()
    motion.entries.extend(kept)
    if disable == 1:
        board.set_motors(False, False)
    p.data(b"%d,%d,%d,%d,%d" % (interrupted, *waiting, *remaining), b"\n\r")
