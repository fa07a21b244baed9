"""The virtual board without process, pseudo-terminal or real time: a port and a clock for the streamer, in one thread.

Time passes only while the host waits in `receive` (and in `host_stalls`), so that a plot of minutes runs in well under a second
and exactly the same each time. Faults are those of the virtual board's script.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

from output.ebb.virtual.board import Board, Sent
from output.ebb.virtual.faults import FaultScript, Outcome
from output.ebb.virtual.registers import TICKS_PER_S
from output.errors import LinkLost

LATENCY_TICKS = 12  # half a millisecond of USB each way


class MemoryBoard:
    """`on_receive` is called with this board each time the host looks for news."""

    name = "memory"

    def __init__(self, firmware: str = "3.0.3", faults: list[dict[str, Any]] | None = None, **board: Any) -> None:
        self.board = Board(firmware, **board)
        self.script = FaultScript.parse(faults or [], 1.0)
        self.board.intercept = self.script.intercept
        self.gone = False
        self.closed = False
        self.written: list[tuple[float, bytes]] = []
        self.on_receive: Callable[[MemoryBoard], None] | None = None
        self._to_board: deque[tuple[int, bytes]] = deque()
        self._to_host: deque[tuple[int, bytes]] = deque()
        self._frozen_until = 0
        self._back_at: int | None = None
        self._woken = False

    # the port and its clock

    def clock(self) -> float:
        return self.board.now / TICKS_PER_S

    def send(self, data: bytes) -> None:
        self._must_be_there()
        self.written.append((self.clock(), data))
        for start in range(0, len(data), 64):
            self._to_board.append((self.board.now + LATENCY_TICKS, data[start : start + 64]))

    def receive(self, timeout_s: float) -> bytes:
        self._must_be_there()
        if self.on_receive is not None:
            self.on_receive(self)
        if self._woken:
            self._woken = False
            return b""
        self._live(self.board.now + max(1, round(timeout_s * TICKS_PER_S)), until_news=True)
        self._must_be_there()
        data = b""
        while self._to_host and self._to_host[0][0] <= self.board.now:
            data += self._to_host.popleft()[1]
        return data

    def wake(self) -> None:
        self._woken = True

    def close(self) -> None:
        self.closed = True

    def _must_be_there(self) -> None:
        if self.gone or self.closed:
            raise LinkLost("the link to memory is lost (pulled): check the USB cable and the board's power")

    # the world

    def host_stalls(self, seconds: float) -> None:
        """The board lives on while the host does nothing."""
        self._live(self.board.now + round(seconds * TICKS_PER_S), until_news=False)

    def fault(self, **entry: Any) -> None:
        self.script.add(entry, self.board)

    def replugged(self) -> None:
        """The cable is in again and a new program opens the port."""
        self.gone = self.closed = False
        self._to_host.clear()
        self._to_board.clear()

    def record(self) -> dict[str, Any]:
        return {**self.board.recorder.summary(self.board.now), **self.board.state()}

    def _live(self, horizon: int, *, until_news: bool) -> None:
        board = self.board
        while board.now < horizon:
            if until_news and (self.gone or (self._to_host and self._to_host[0][0] <= board.now)):
                return
            stops = [horizon, board.next_event(), self.script.next_tick(), self._back_at]
            stops += [self._to_host[0][0]] if self._to_host and self._to_host[0][0] > board.now else []
            stops += [max(self._to_board[0][0], self._frozen_until)] if self._to_board and board.wants_bytes else []
            board.advance_to(max(board.now, min(stop for stop in stops if stop is not None)))
            self._outside()
            if self._to_board and board.wants_bytes and max(self._to_board[0][0], self._frozen_until) <= board.now:
                data = self._to_board.popleft()[1]
                while data and not self.gone:
                    count = self.script.incoming(data)
                    board.feed(data[:count])
                    data = data[count:]
                    self._outside()
            self._collect()

    def _outside(self) -> None:
        for outcome in self.script.due(self.board):
            self._act(outcome)
        if self._back_at is not None and self._back_at <= self.board.now:
            self._back_at = None

    def _collect(self) -> None:
        for sent in self.board.output():
            self._pass_on(sent)
        if self.board.usb_dropped:
            self.board.usb_dropped = False
            self._drop(None)

    def _pass_on(self, sent: Sent) -> None:
        for outcome in self.script.outgoing(sent, self.board):
            self._act(outcome)

    def _act(self, outcome: Outcome) -> None:
        if outcome.data and not self.gone:
            tick = max(self.board.now + LATENCY_TICKS + outcome.delay_ticks, self._frozen_until)
            if self._to_host:
                tick = max(tick, self._to_host[-1][0])
            self._to_host.append((tick, outcome.data))
        if outcome.freeze_ticks:
            self._frozen_until = self.board.now + outcome.freeze_ticks
            late = deque((max(tick, self._frozen_until), data) for tick, data in self._to_host)
            self._to_host = late
        if outcome.hang_up:
            self._drop(outcome.back_after_ticks)

    def _drop(self, back_after_ticks: int | None) -> None:
        self.gone = True
        self._to_host.clear()
        self._to_board.clear()
        self._back_at = None if back_after_ticks is None else self.board.now + back_after_ticks
