"""Work in a thread of its own, which does not keep the program from ending."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, TypeVar, cast

Result = TypeVar("Result")
_NAME = "errand"


def errand_thread(run: Callable[[], None]) -> threading.Thread:
    """Begins to `run` in such a thread."""
    thread = threading.Thread(target=run, daemon=True, name=_NAME)
    thread.start()
    return thread


def still_busy() -> bool:
    """Whether something is still worked at that nobody waits for any more."""
    return any(thread.name == _NAME for thread in threading.enumerate())


class Errand(Generic[Result]):
    """Does `work`; `on_done` is called from its thread."""

    def __init__(self, work: Callable[[], Result], on_done: Callable[[], None] = lambda: None) -> None:
        self._work = work
        self._on_done = on_done
        self._result: Result | None = None
        self._error: BaseException | None = None
        self.done = False
        self._thread = errand_thread(self._run)

    def wait(self, most_s: float) -> None:
        """Waits for it to be `done`, but no longer than that."""
        self._thread.join(most_s)

    def result(self) -> Result:
        """What `work` returned, waiting for it when it is not `done`. Raises what it raised."""
        self._thread.join()
        if self._error is not None:
            raise self._error
        return cast(Result, self._result)

    def _run(self) -> None:
        try:
            self._result = self._work()
        except BaseException as caught:  # handed over to whoever asks for the result
            self._error = caught
        self.done = True
        self._on_done()
