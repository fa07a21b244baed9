"""The commands that answer at once: V, the Q family, A, I, MR, PI and the checks CK."""

from __future__ import annotations

from typing import TYPE_CHECKING

from output.ebb.virtual.packet import INVALID, Packet

if TYPE_CHECKING:
    from output.ebb.virtual.board import Board

_REVERSED = b"\n\r"


def _number(board: Board, value: int, width: int) -> bytes:
    """3.x does not pad, whatever the reference says; 2.x did."""
    return b"%d" % value if board.firmware.since(3, 0, 0) else b"%0*d" % (width, value)


def v(board: Board, p: Packet) -> None:
    p.echo()
    p.data(board.version_line.encode("latin-1"), ok=False)


def qg(board: Board, p: Packet) -> None:
    p.echo()
    p.data(b"%02X" % board.status_byte(), ok=False)
    board.status_was_read()


def qm(board: Board, p: Packet) -> None:
    p.echo()
    status = board.status_byte()
    bits = b"%d,%d,%d,%d" % (status >> 3 & 1, status >> 2 & 1, status >> 1 & 1, status & 1)
    if p.syntax.future:
        p.out += b"," + bits + b"\n"
    else:
        p.out += b"QM," + bits + _REVERSED


def qs(board: Board, p: Packet) -> None:
    p.echo()
    position, _ = board.motion.state(board.now)
    p.data(b"%d,%d" % (position[0], position[1]), _REVERSED)


def qe(board: Board, p: Packet) -> None:
    p.echo()
    p.data(b"%d,%d" % tuple(board.microstep if on else 0 for on in board.motors_on), _REVERSED)


def qp(board: Board, p: Packet) -> None:
    p.echo()
    p.data(b"%d" % board.servo.up, _REVERSED)


def qr(board: Board, p: Packet) -> None:
    p.echo()
    p.data(b"%d" % board.servo.powered, _REVERSED)


def qb(board: Board, p: Packet) -> None:
    p.echo()
    p.data(b"%d" % board.button_pressed)
    board.button_pressed = False


def qn(board: Board, p: Packet) -> None:
    p.echo()
    p.data(_number(board, board.node_count, 10))


def ql(board: Board, p: Packet) -> None:
    p.echo()
    if p.syntax.future:
        p.out += b","
    index = p.u8(optional=True) if board.firmware.since(3, 0, 0) else 0
    if p.failed:
        return
    text = _number(board, board.variables[min(index or 0, len(board.variables) - 1)], 3)
    if p.syntax.future:
        p.out += text + b"\n"
    else:
        p.data(text)


def qc(board: Board, p: Packet) -> None:
    p.echo()
    p.data(_number(board, board.adc(0), 4) + b"," + _number(board, board.adc(11), 4))


def qt(board: Board, p: Packet) -> None:
    p.echo()
    p.data(board.nickname)


def es(board: Board, p: Packet) -> None:
    p.echo()
    if p.syntax.future:
        p.out += b","
    disable = p.u8(optional=True)
    if p.failed:
        return
    text = b"%d" % board.emergency_stop()
    if disable == 1:
        board.set_motors(False, False)
    if p.syntax.future:
        p.out += text + b"\n"
    else:
        p.data(text, _REVERSED)


def qu(board: Board, p: Packet) -> None:
    """Each value ends its own line; the end of the reply follows, which in future syntax is an empty line."""
    p.echo()
    p.out += b"," if p.syntax.future else b"QU,"
    number = p.u8()
    if p.failed or number is None:
        return
    _, acc = board.motion.state(board.now)
    values = {
        1: b"%02X" % board.limit.port_b,
        2: b"%d" % board.firmware.max_queue,
        3: b"%d" % board.motion.depth,
        4: b"%X" % board.stack_high_water,
        5: b"%X" % board.stack_high_water,
        60: b"%d" % board.supply.threshold,
        61: b"%d" % board.stepper_timeout_s,
        200: b"%d,%d" % (acc[0], acc[1]),
    }
    if board.firmware.since(3, 0, 1):
        values[6] = b"%d" % len(board.motion.entries)
    text = values.get(number)
    if text is None:
        p.error(INVALID)
        if not p.firmware.one_error:
            p.ok()
        return
    if not board.firmware.since(3, 0, 2):
        text = b"%d," % number + text
    p.out += text + (b"\n" if p.syntax.future else b"\r\n")
    p.ok()


def a(board: Board, p: Packet) -> None:
    p.echo()
    if board.firmware.since(3, 0, 0):
        text = b",".join(b"%d:%d" % (channel, board.adc(channel)) for channel in sorted(board.analog_channels))
    else:
        text = b",".join(b"%02d:%04d" % (channel, board.adc(channel)) for channel in sorted(board.analog_channels))
    if p.syntax.future:
        p.out += b"," + text + b"\n"
    else:
        p.out += b"A," + text + _REVERSED


def i(board: Board, p: Packet) -> None:
    p.echo()
    text = b",".join(_number(board, board.pins.read(port), 3) for port in "ABCDE")
    p.out += (b"," if p.syntax.future else b"I,") + text + (b"\n" if p.syntax.future else b"\r\n")


def _named(p: Packet, text: bytes) -> None:
    p.out += text + (b"\n" if p.syntax.future else b"\r\n")


def _name_comma(p: Packet) -> None:
    p.echo()
    p.out += b"," if p.syntax.future else p.name + b","


def mr(board: Board, p: Packet) -> None:
    _name_comma(p)
    address = p.u16()
    if p.failed or address is None:
        return
    if address >= len(board.memory):
        p.error(INVALID)
        return
    _named(p, _number(board, board.memory[address], 3))


def pi(board: Board, p: Packet) -> None:
    _name_comma(p)
    port = p.take_character()
    pin = p.u8()
    if p.failed or port is None or pin is None:
        return
    if chr(port) not in "ABCDE" or pin > 7:
        p.error(INVALID)
        return
    _named(p, b"%d" % (board.pins.read(chr(port)) >> pin & 1))


def ck(_board: Board, p: Packet) -> None:
    """Prints what the parameter readers made of each type; the last two labels are misprinted by the board."""
    p.echo()
    end = b"\n" if p.syntax.future else b"\r\n"
    p.out += end
    ranges = ((-128, 127), (0, 255), (-32768, 32767), (0, 65535), (-0x80000000, 0x7FFFFFFF), (0, 0xFFFFFFFF))
    for number, (low, high) in enumerate(ranges, 1):
        value = p.take_number(low, high)
        if p.failed:
            return
        p.out += b"Param%d=%d" % (number, value or 0) + end
    for upper in (False, True):
        character = p.take_character(upper=upper)
        if p.failed or character is None:
            return
        p.out += b"Param6=%c" % character + end
    p.ok()
