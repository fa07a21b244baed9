"""The planning thread left out: for boards whose clock is not the computer's, where a late thread would count as a stall."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import pytest

from output.ebb.producer import Item, items_of
from output.ebb.program import Mark


class InlineProducer:
    """As producer.Producer, item by item in the caller's thread."""

    def __init__(self, program: Iterable[Item], on_news: Callable[[], None]) -> None:  # noqa: ARG002 - the same signature
        self._items: Iterator[Item] = iter(program)
        self._next: Item | None = None
        self._ahead: deque[Item] = deque()
        self.exhausted = False
        self._pull()

    def _pull(self) -> None:
        self._error: BaseException | None = None
        try:
            self._next = self._ahead.popleft() if self._ahead else next(self._items)
        except StopIteration:
            self._next, self.exhausted = None, True
        except BaseException as error:  # comes out of `peek`, as it does from the thread
            self._next, self._error = None, error

    def peek(self) -> Item | None:
        if self._error is not None:
            raise self._error
        return self._next

    def take(self) -> None:
        self._pull()

    def has_s(self, seconds: float) -> bool:  # noqa: ARG002 - whatever is asked for is made at once
        return True

    def has_stroke(self, seconds: float) -> bool:
        return self.has_s(seconds)

    def until(self, kind: type[Mark]) -> list[Item] | None:
        found = [] if self._next is None else [self._next]
        for item in self._ahead:
            if isinstance(item, kind):
                return found
            found.append(item)
        for item in self._items:
            self._ahead.append(item)
            if isinstance(item, kind):
                break
            found.append(item)
        return found

    def ahead(self, seconds: float) -> int:
        if self._next is None:
            return 0
        while (count := items_of([self._next, *self._ahead], seconds)) is None:
            if (item := next(self._items, None)) is None:
                return 1 + len(self._ahead)
            self._ahead.append(item)
        return count

    def close(self) -> None:
        return

    wait = close


class InlineErrand:
    """Does its work at once."""

    done = True

    def __init__(self, work: Callable[[], Any], on_done: Callable[[], None]) -> None:  # noqa: ARG002
        self._result = work()

    def result(self) -> Any:
        return self._result


@pytest.fixture
def inline_producer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("output.ebb.stream.Producer", InlineProducer)
    monkeypatch.setattr("output.ebb.holding.Errand", InlineErrand)
