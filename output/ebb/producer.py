"""Planning ahead of drawing: a thread that takes the program item by item, as far as a bounded buffer allows.

The loop that owns the port never runs the planner; it only takes what is there. An exception of the planner travels through the
buffer in its place and comes out of `peek` when everything before it has been taken, or out of `has_stroke` when it is in the
stroke.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable
from itertools import takewhile

from output.ebb.board_time import board_time_s
from output.ebb.commands import Command
from output.ebb.program import Mark, StrokeEnd
from output.errand import errand_thread

Item = Command | Mark
# About a minute of ordinary drawing; bounds memory, while a slow stretch of planning finds this much in reserve.
BUFFER_ITEMS = 4096
_JOIN_S = 0.5


def items_of(items: Iterable[Item], seconds: float) -> int | None:
    """How many of the items come to so much board time; None when all of them come to less."""
    count = 0
    for item in items:
        if seconds <= 0:
            break
        seconds -= board_time_s(item) if isinstance(item, Command) else 0.0
        count += 1
    return count if seconds <= 0 else None


class Producer:
    """Runs through `program` in its own thread. `on_news` is called from that thread when the buffer gets something while it is

    empty, or has less than was asked for.
    """

    def __init__(self, program: Iterable[Item], on_news: Callable[[], None], capacity: int = BUFFER_ITEMS) -> None:
        self._program = program
        self._on_news = on_news
        self._capacity = capacity
        self._items: deque[Item] = deque()
        self._error: BaseException | None = None
        self._ended = False
        self._closed = False
        self._lacking = False  # more was asked for than there is
        self._changed = threading.Condition()
        self._thread = errand_thread(self._run)

    def peek(self) -> Item | None:
        """The next item without taking it; None when there is none yet or no more. Raises what the program raised."""
        with self._changed:
            if self._items:
                return self._items[0]
            if self._error is not None:
                raise self._error
            return None

    def take(self) -> None:
        """Removes the item that `peek` showed."""
        with self._changed:
            self._items.popleft()
            if len(self._items) == self._capacity // 2:
                self._changed.notify()

    def has_s(self, seconds: float) -> bool:
        """Whether so much board time waits to be taken; also when more than that will not come, or not before some is taken."""
        with self._changed:
            enough = self._ended or len(self._items) > self._capacity // 2 or items_of(self._items, seconds) is not None
            self._lacking = not enough
            return enough

    def has_stroke(self, seconds: float) -> bool:
        """Whether a pen that is lowered now will not have to wait: the stroke is there to its end, or so much of it.

        Raises what the program raised before the stroke came to its end.
        """
        with self._changed:
            if any(isinstance(item, StrokeEnd) for item in self._items):
                return True
            if self._error is not None:
                raise self._error
        return self.has_s(seconds)

    def ahead(self, seconds: float) -> int:
        """How many items to take until so much board time has been taken; those that wait, when they are less."""
        with self._changed:
            count = items_of(self._items, seconds)
            return len(self._items) if count is None else count

    def until(self, kind: type[Mark]) -> list[Item] | None:
        """The items before the next mark of this kind, or before the end; None while that has not been made."""
        with self._changed:
            found = list(takewhile(lambda item: not isinstance(item, kind), self._items))
            known = len(found) < len(self._items) or self._ended or len(found) > self._capacity // 2
            return found if known else None

    @property
    def exhausted(self) -> bool:
        """The program has ended without error and every item has been taken."""
        with self._changed:
            return self._ended and not self._items and self._error is None

    def close(self) -> None:
        """Has the thread end at its next item. Waits for nothing: a pen may be down."""
        with self._changed:
            self._closed = True
            self._changed.notify()

    def wait(self) -> None:
        """After `close`: a planner that is busy is not waited for much longer, and ends with the process."""
        if self._thread is not threading.current_thread():
            self._thread.join(_JOIN_S)

    def _run(self) -> None:
        error: BaseException | None = None
        try:
            for item in self._program:
                if not self._put(item):
                    return
        except BaseException as caught:  # handed over to the loop, which stops the board and raises it
            error = caught
        with self._changed:
            self._error, self._ended = error, True
        self._on_news()

    def _put(self, item: Item) -> bool:
        with self._changed:
            if len(self._items) >= self._capacity:
                self._changed.wait_for(lambda: self._closed or len(self._items) <= self._capacity // 2)
            if self._closed:
                return False
            self._items.append(item)
            news = self._lacking or len(self._items) == 1
            self._lacking = False
        if news:
            self._on_news()
        return True
