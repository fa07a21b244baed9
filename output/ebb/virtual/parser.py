"""The board's command parser: one line at a time, for as long as parsing takes, and deaf while the motion queue is full."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from output.ebb.virtual import checksum
from output.ebb.virtual.command_table import commands_of
from output.ebb.virtual.line_input import LineInput
from output.ebb.virtual.motion_commands import Handling, Wait
from output.ebb.virtual.moves import QueueEntry, StepperMove
from output.ebb.virtual.packet import Packet
from output.ebb.virtual.parse_time import parse_ticks

if TYPE_CHECKING:
    from output.ebb.virtual.board import Board

COMMA = 0x2C


@dataclass(slots=True)
class _Waiting:
    """The command that is stuck: what it waits for and since when."""

    packet: Packet
    steps: Handling
    wanted: QueueEntry | Wait
    since: int


class Parser:
    """Turns lines into what `board` does and says.

    `factor` makes parsing slower; `intercept` may refuse a command with an error text, by its number since the board was made
    and its line.
    """

    def __init__(self, board: Board) -> None:
        self._board = board
        self._commands = commands_of(board.firmware)
        self.factor = 1.0
        self.intercept: Callable[[int, bytes], bytes | None] | None = None
        self.restart()

    def restart(self) -> None:
        """Forget what was read, as at power-on."""
        self._input = LineInput(binary_y=self._board.firmware.version == "3.0.2")
        self._lines: deque[tuple[bytes | None, bytes]] = deque()
        self._waiting: _Waiting | None = None
        self.parsed_at: int | None = None
        self.commands_seen = 0

    @property
    def free(self) -> bool:
        """Nothing is being parsed and nothing waits for it."""
        return not self._lines and self._waiting is None and self.parsed_at is None

    @property
    def blocked(self) -> bool:
        """A command is stuck until the motion queue has room or is idle."""
        return self._waiting is not None

    def feed(self, data: bytes) -> None:
        """Bytes from the wire."""
        self._lines.extend(self._input.lines(data))
        self._take_up()

    def step(self) -> None:
        """Do what has come to be possible at the board's present tick."""
        if self._waiting is not None:
            self._resume(self._waiting)
        if self.parsed_at is not None and self.parsed_at <= self._board.now:
            self.parsed_at = None
            line, _ = self._lines.popleft()
            assert line is not None
            self._handle(line)
        self._take_up()

    def _take_up(self) -> None:
        """Begin with the next line if the parser can."""
        board = self._board
        while self._lines and self.parsed_at is None and self._waiting is None:
            line, echo = self._lines[0]
            if line is None:
                board.send(echo)
                self._lines.popleft()
            elif board.timed:
                self.parsed_at = board.now + round(parse_ticks(line, board.motion.rates(board.now)) * self.factor)
            else:
                self._lines.popleft()
                self._handle(line)

    # ---- one command

    def _handle(self, line: bytes) -> None:
        board = self._board
        self.commands_seen += 1
        board.recorder.command(board.now, line)
        length = 1 if len(line) < 2 or line[1] == COMMA else 2
        packet = Packet(line[:length].upper(), line, length, board.firmware, board.syntax)
        refusal = self.intercept(board.recorder.commands - 1, line) if self.intercept is not None else None
        if refusal is not None:
            packet.echo()
            packet.say(refusal)
            self._finish(packet)
            return
        if board.checksums:
            body, text, stuck = checksum.checked(line)
            if body is None:
                self._refuse(packet, text, stuck)
                return
            packet.line = body
        handler = self._commands.get(packet.name)
        if handler is None:
            self._unknown(packet)
            return
        steps = handler(board, packet)
        if steps is None:
            self._finish(packet)
        else:
            self._go_on(packet, steps)

    def _refuse(self, packet: Packet, text: bytes, stuck: int | None) -> None:
        future, one_error = packet.syntax.future, packet.firmware.one_error
        lead = packet.name + b"," if future and one_error else b""
        self._board.send(lead + checksum.report(text, stuck, one_error=one_error, line_end=b"\n" if future else b"\r\n"))

    def _unknown(self, packet: Packet) -> None:
        name = packet.name
        text = b"!8 Err: Unknown command '%s:%s'" % (name, name.hex().upper().encode())
        if packet.firmware.one_error:
            packet.echo()
            packet.say(text)
        else:
            # Not an error like the others: parameters that follow are reported as well.
            packet.out += text + (b"\n" if packet.syntax.future else b"\r\n")
        self._finish(packet)

    def _finish(self, packet: Packet) -> None:
        self._board.send(packet.finish())
        self._board.command_was_handled()

    # ---- waiting for the queue

    def _go_on(self, packet: Packet, steps: Handling) -> None:
        """Run a handler until it has to wait or is done."""
        for wanted in steps:
            if not self._granted(wanted, packet):
                self._waiting = _Waiting(packet, steps, wanted, self._board.now)
                return
        self._finish(packet)

    def _granted(self, wanted: QueueEntry | Wait, packet: Packet) -> bool:
        """Queue what the handler wants, or drop it where the board does; False while it has to wait."""
        board = self._board
        if isinstance(wanted, Wait):
            return board.motion.idle
        if board.discard_moves:
            return True
        if isinstance(wanted, StepperMove) and board.limit.triggered:
            packet.mute = board.firmware.version == "3.0.0" and wanted.command in ("LM", "L3", "LT", "T3")
            return True
        if board.motion.full:
            return False
        board.recorder.queued(wanted, board.motion.waiting_ticks(board.now), board.motion.idle)
        board.motion.push(wanted, board.now)
        return True

    def _resume(self, waiting: _Waiting) -> None:
        if self._granted(waiting.wanted, waiting.packet):
            self._waiting = None
            if not isinstance(waiting.wanted, Wait):
                self._board.recorder.parser_was_blocked(waiting.since, self._board.now)
            self._go_on(waiting.packet, waiting.steps)
