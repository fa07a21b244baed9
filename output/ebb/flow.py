"""How full the board's motion queue is, and how long it will stay busy: credits and lead, without a port.

The board holds one executing entry and `depth` waiting ones. It parses one command at a time and does not read on while a
motion command waits for a free place, so a full queue makes it deaf to everything, the emergency stop included. The law kept:

    waiting, as last counted by the board  +  entries sent since that count  <=  depth        (room() never lets it be broken)

    sent ......................................................> room()
         acknowledged ...........................>
              waiting (counted by QU,6, or FIFO bit of QG) .>
    |executed|executing|  w  a  i  t  i  n  g  | on the wire |   free   |
                        <-------------- depth ----------------------->

Clock: the host's monotonic seconds throughout; `board_speed` scales a virtual board's faster time. Executed positions lag sent
ones by everything right of "executed".
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from output.errors import LinkLost

# How far a modelled idle moment may lie before an acknowledgement without being called a stall: the jitter of one poll.
STALL_TOLERANCE_S = 0.003
# Switching motors on or a servo without a wait takes a tick: nothing moves that could stutter after it.
_NO_MOTION_S = 0.001
# A firmware that cannot count its queue (3.0.0) is credited with what its clock must have finished; 2 % covers the oscillator.
_CLOCK_MARGIN = 1.02


@dataclass(slots=True)
class _Entry:
    number: int
    duration_s: float


class QueueModel:
    """The motion queue of one board. `number` counts queued commands from 1; a TD is one command and two entries."""

    def __init__(self, depth: int, *, counts: bool, board_speed: float = 1.0) -> None:
        if depth < 1:
            raise ValueError(f"a motion queue is at least 1 deep, not {depth}")
        self.depth = depth
        self.counts = counts
        self.board_speed = board_speed
        self.sent = 0
        self.acknowledged = 0
        self.stalls = 0
        self.stalled_s = 0.0
        self._unfinished: deque[_Entry] = deque()
        self._waiting_bound = 0
        self._poll_sent_at: float | None = None
        self._entries_since_poll = 0
        self._entries_at_poll = 0
        self._idle_at: float | None = None
        self._was_moving = False

    @property
    def completed(self) -> int:
        """The greatest number such that this command and all before it are certainly executed."""
        return self._unfinished[0].number - 1 if self._unfinished else self.sent

    @property
    def is_empty(self) -> bool:
        return not self._unfinished

    def room(self) -> int:
        """How many entries may be sent now without the board's parser ever having to wait."""
        return max(0, self.depth - self._waiting_bound)

    def lead_s(self, now: float) -> float:
        """For how long the board has motion, in host seconds: executing, waiting, and on the wire."""
        unacknowledged = sum(entry.duration_s for entry in self._unfinished if entry.number > self.acknowledged)
        known = 0.0 if self._idle_at is None else max(0.0, self._idle_at - now)
        return known + unacknowledged

    def on_sent(self, entries: int, duration_s: float) -> int:
        """A queued command goes on the wire; its number. `duration_s` is board time."""
        if entries > self.room():
            raise AssertionError(f"{entries} entries sent into room for {self.room()}: the parser would block")
        self.sent += 1
        share = duration_s / self.board_speed / entries
        self._unfinished.extend(_Entry(self.sent, share) for _ in range(entries))
        self._waiting_bound += entries
        self._entries_since_poll += entries
        return self.sent

    def on_acknowledged(self, now: float) -> None:
        """The oldest command on the wire is in the board's queue."""
        self.acknowledged += 1
        duration_s = sum(entry.duration_s for entry in self._unfinished if entry.number == self.acknowledged)
        if self._idle_at is not None and self._was_moving and now > self._idle_at + STALL_TOLERANCE_S:
            self.stalls += 1
            self.stalled_s += now - self._idle_at
        self._idle_at = max(now, self._idle_at or now) + duration_s
        self._was_moving = duration_s >= _NO_MOTION_S

    def expect_idle(self) -> None:
        """The board runs empty on purpose (a pause, the end): what follows is no stall."""
        self._idle_at = None

    def on_poll_sent(self, now: float) -> None:
        self._poll_sent_at, self._entries_at_poll = now, len(self._unfinished)
        self._entries_since_poll = 0

    def on_polled(self, *, waiting: int | None, fifo_empty: bool, executing: bool, now: float) -> None:
        """The board's own count, as of the poll: all entries sent before it had been parsed by then.

        `waiting` is None where the firmware only tells empty from not empty. Raises LinkLost for a number that cannot be.
        """
        if waiting is not None and waiting > self.depth:
            raise LinkLost(
                f"the board says that {waiting} commands wait in a queue of {self.depth}, so that its answers are damaged on "
                "their way: check the USB cable"
            )
        since, at_poll = self._entries_since_poll, self._entries_at_poll
        counted = waiting is not None or fifo_empty
        if waiting is None:
            waiting = 0 if fifo_empty else self._waiting_by_clock(at_poll, now)
        alive = min(at_poll, waiting + (1 if executing or waiting else 0))
        finished = max(0, len(self._unfinished) - since - alive)
        for _ in range(finished):
            self._unfinished.popleft()
        self._waiting_bound = waiting + since
        if counted:
            self._bound_idle(waiting, alive, now)

    def _bound_idle(self, waiting: int, alive: int, now: float) -> None:
        """The board is busy at least for what waits and at most for that and the whole of what executes."""
        acknowledged = [entry for entry in self._unfinished if entry.number <= self.acknowledged]
        if self._idle_at is None or not acknowledged or self._poll_sent_at is None:
            return
        later = sum(entry.duration_s for entry in acknowledged[alive:])
        queued = sum(entry.duration_s for entry in acknowledged[max(0, alive - waiting) : alive])
        executing = acknowledged[0].duration_s if alive > waiting else 0.0
        earliest = self._poll_sent_at + queued + later
        self._idle_at = min(max(self._idle_at, earliest), now + executing + queued + later)

    def _waiting_by_clock(self, at_poll: int, now: float) -> int:
        """An upper bound of the waiting entries where the queue is seen not empty and cannot be counted.

        With one place that is 1. With more (3.0.0), entries whose time must have passed are gone; before anything is known, all
        that were sent may still wait.
        """
        if self.depth == 1 or self._idle_at is None:
            return min(at_poll, self.depth)
        left_s, waiting = max(0.0, self._idle_at - now) * _CLOCK_MARGIN + 0.02, 0
        for entry in list(self._unfinished)[at_poll - 1 :: -1]:
            if left_s <= 0:
                break
            left_s -= entry.duration_s
            waiting += 1
        return max(1, min(waiting, at_poll))
