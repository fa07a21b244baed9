"""T, PC and PG of firmware 2.x: packets that the board sends by itself, and pulses on B0 to B3."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from output.ebb.virtual import query_commands as query
from output.ebb.virtual.packet import INVALID, Packet

if TYPE_CHECKING:
    from output.ebb.virtual.board import Board

TICKS_PER_MS = 25


@dataclass(slots=True)
class TimedReports:
    """For each of I (0) and A (1): its period in ticks and the tick of the next packet. Pulses are kept, not generated."""

    due: dict[int, tuple[int, int]] = field(default_factory=dict)
    pulses: list[int] = field(default_factory=lambda: [0] * 8)
    pulsing: bool = False

    def next_tick(self) -> int | None:
        return min((tick for _, tick in self.due.values()), default=None)

    def packets(self, board: Board) -> list[bytes]:
        """The packets that are due at the board's present tick."""
        found = []
        for mode, (period, tick) in list(self.due.items()):
            if tick <= board.now:
                packet = Packet(b"IA"[mode : mode + 1], b"", 0, board.firmware, board.syntax)
                (query.i, query.a)[mode](board, packet)
                found.append(packet.finish())
                self.due[mode] = (period, tick + period)
        return found


def t(board: Board, p: Packet) -> None:
    duration_ms = p.u16()
    mode = p.u8()
    if p.failed or duration_ms is None or mode is None:
        return
    if mode > 1:
        p.error(INVALID)
        return
    if duration_ms:
        board.reports.due[mode] = (duration_ms * TICKS_PER_MS, board.now + duration_ms * TICKS_PER_MS)
    else:
        board.reports.due.pop(mode, None)
    p.ok()


def pc(board: Board, p: Packet) -> None:
    values = [p.u16(), p.u16(), *(p.u16(optional=True) for _ in range(6))]
    if p.failed:
        return
    board.reports.pulses = [value or 0 for value in values]
    p.ok()


def pg(board: Board, p: Packet) -> None:
    value = p.u8()
    if p.failed or value is None:
        return
    if value > 1:
        p.error(INVALID)
        return
    board.reports.pulsing = bool(value)
    p.ok()
