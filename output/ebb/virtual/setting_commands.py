"""The commands that change settings, variables, pins and the board as a whole."""

from __future__ import annotations

from typing import TYPE_CHECKING

from output.ebb.virtual.motion_commands import Handling, Wait
from output.ebb.virtual.packet import INVALID, Packet

if TYPE_CHECKING:
    from output.ebb.virtual.board import Board


def _refuse(p: Packet) -> None:
    """A value out of range: 3.0.3 prints the error alone, earlier firmware says OK before it."""
    p.error(INVALID)
    if not p.firmware.one_error:
        p.ok()


def cu(board: Board, p: Packet) -> Handling:
    p.echo()
    number = p.u16()
    value = p.i16()
    if p.failed or number is None or value is None:
        return
    if number == 4 and board.firmware.since(3, 0, 0):
        yield Wait.IDLE
        # A negative size is taken by its low byte, past the end of the queue's memory; 0 lets no motion command through.
        board.motion.depth = value & 0xFF if value < 0 else min(value, board.firmware.max_queue)
    elif not _set_option(board, p, number, value):
        _refuse(p)
        return
    p.ok()


def _set_option(board: Board, p: Packet, number: int, value: int) -> bool:
    """All of CU but the queue's size; False when the number or the value is not known."""
    flags = {1, 2, 3}
    if board.firmware.since(3, 0, 0):
        flags |= {10, 50, 53, 54, *range(250, 258)}
    if number in flags:
        if value not in (0, 1):
            return False
        on = bool(value)
        if number == 1:
            p.syntax.ok = on
        elif number == 2:
            board.limit_checks = on
        elif number == 10:
            p.syntax.future = on
        elif number == 50:
            board.auto_enable = on
        elif number == 256:
            board.discard_moves = on
        elif number == 53:
            board.limit.replies = on
        elif number == 54:
            board.checksums = on
        return True
    if not board.firmware.since(3, 0, 0):
        return False
    if number in (51, 52):
        if not 0 <= value <= 255:
            return False
        if number == 51:
            board.set_limit_mask(value)
        else:
            board.limit.target = value
            board.check_limit_switch()
        return True
    if number == 60:
        board.set_power_threshold(value & 0x3FF)
        return True
    if number == 61:
        board.stepper_timeout_s = value & 0xFFFF
        board.restart_stepper_timeout()
        return True
    return False


def sc(board: Board, p: Packet) -> None:
    p.echo()
    number = p.u8()
    value = p.u16()
    if p.failed or number is None or value is None:
        return
    servo = board.servo
    if number == 1:
        board.pen_mechanism = min(value, 2)
    elif number == 4:
        servo.minimum = value
        servo.heights_changed()
    elif number == 5:
        servo.maximum = value
        servo.heights_changed()
    elif number == 8:
        servo.channels = min(max(value, 1), 8 if p.firmware.since(3, 0, 0) else 24)
    elif number == 9:
        servo.slot_ms = min(max(value, 1), 6)
    elif number == 10:
        servo.rate_up = servo.rate_down = value
    elif number == 11:
        servo.rate_up = value
    elif number == 12:
        servo.rate_down = value
    elif number == 13:
        board.alternative_button = bool(value)
    p.ok()


def sr(board: Board, p: Packet) -> None:
    p.echo()
    timeout_ms = p.u32()
    state = p.u8(optional=True)
    if p.failed or timeout_ms is None:
        return
    board.set_servo_power(timeout_ms, state)
    p.ok()


def sl(board: Board, p: Packet) -> None:
    p.echo()
    value = p.u8()
    index = p.u8(optional=True) if p.firmware.since(3, 0, 0) else 0
    if p.failed or value is None:
        return
    board.variables[min(index or 0, len(board.variables) - 1)] = value
    p.ok()


def sn(board: Board, p: Packet) -> None:
    p.echo()
    value = p.u32()
    if value is not None:
        board.node_count = value
    p.ok()


def ni(board: Board, p: Packet) -> None:
    p.echo()
    board.node_count = min(board.node_count + 1, 0xFFFFFFFF)
    p.ok()


def nd(board: Board, p: Packet) -> None:
    p.echo()
    board.node_count = max(board.node_count - 1, 0)
    p.ok()


def st(board: Board, p: Packet) -> None:
    p.echo()
    name = p.take_text(16)
    if name is not None:
        board.nickname = name
    p.ok()


def cs(board: Board, p: Packet) -> None:
    p.echo()
    board.clear_counters()
    p.ok()


def r(board: Board, p: Packet) -> None:
    p.echo()
    p.ok()
    board.reset()
    p.syntax = board.syntax


def rb(board: Board, _p: Packet) -> None:
    board.reboot()


def bl(board: Board, _p: Packet) -> None:
    board.enter_bootloader()


def ac(board: Board, p: Packet) -> None:
    p.echo()
    channel = p.u8()
    enable = p.u8()
    if p.failed or channel is None:
        return
    if channel > 15 or (enable or 0) > 1:
        _refuse(p)
        return
    if enable:
        board.analog_channels.add(channel)
    else:
        board.analog_channels.discard(channel)
    p.ok()


def c(board: Board, p: Packet) -> None:
    p.echo()
    values = [p.u8() for _ in range(5)]
    if p.failed:
        return
    for port, value in zip("ABCDE", values, strict=True):
        board.pins.direction[port] = value or 0
    board.check_limit_switch()
    p.ok()


def o(board: Board, p: Packet) -> None:
    p.echo()
    values = [p.u8(), *(p.u8(optional=True) for _ in range(4))]
    if p.failed:
        return
    for port, value in zip("ABCDE", values, strict=True):
        if value is not None:
            board.pins.latch[port] = value
    board.check_limit_switch()
    p.ok()


def _pin_bit(board: Board, p: Packet, which: dict[str, int]) -> None:
    p.echo()
    port = p.take_character()
    pin = p.u8()
    value = p.u8()
    if p.failed or port is None or pin is None:
        return
    if chr(port) not in "ABCDE" or pin > 7 or (value or 0) > 1:
        p.error(INVALID)
        return
    which[chr(port)] = board.pins.with_bit(which[chr(port)], pin, bool(value))
    board.check_limit_switch()
    p.ok()


def pd(board: Board, p: Packet) -> None:
    _pin_bit(board, p, board.pins.direction)


def po(board: Board, p: Packet) -> None:
    _pin_bit(board, p, board.pins.latch)


def mw(board: Board, p: Packet) -> None:
    p.echo()
    address = p.u16()
    value = p.u8()
    if p.failed or address is None or value is None:
        return
    if address >= len(board.memory):
        p.error(INVALID)
        return
    board.memory[address] = value
    p.ok()


def cm(_board: Board, p: Packet) -> None:
    """Not in the public builds: it reads its parameters and says so."""
    p.echo()
    frequency = p.u16()
    for _ in range(4):
        p.i32()
    direction = p.u8()
    if p.failed:
        return
    if not frequency or frequency > 25_000 or (direction or 0) > 1:
        p.error(INVALID)
        return
    p.out += b"CM command disabled in this build"
    p.ok()
