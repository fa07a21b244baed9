"""From the wish to pause to the commands that bring the pen to rest on its path, while the stream goes on."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from output.ebb.producer import Item
from output.ebb.program import Program
from output.errand import Errand

Hold = Callable[[int], Program | None]


class Holding:
    """Has `hold` reckon, in a thread of its own, what to send in place of everything from an item on.

    That item lies a little ahead, so that the stream has enough to send until the answer is there; from it on it waits.
    """

    def __init__(self, hold: Hold | None, wake: Callable[[], None]) -> None:
        self._hold = hold
        self._wake = wake
        self._at = -1  # the item from which on the last hold was asked for
        self._wanted = False
        self._errand: Errand[Program | None] | None = None

    def waits_at(self, item: int) -> bool:
        """Whether the stream must not send this item before the answer is there."""
        return self._wanted and item == self._at

    def forget(self) -> None:
        """Nobody wants to pause any more."""
        self._wanted = False

    def rest(self, taken: int, ahead: Callable[[], int]) -> list[Item] | None:
        """What to send in place of the rest, `taken` items having been sent; None while that is not known or `hold` gives
        nothing, when it is asked again as the program goes on. `ahead` says how many items to leave it time by."""
        if self._hold is None:
            return None
        if not self._wanted or self._errand is None:
            if self._errand is not None and not self._errand.done:
                return None
            at = taken + ahead()
            if at == self._at:
                return None
            self._at, self._wanted = at, True
            self._errand = Errand(partial(self._hold, at), self._wake)
        if not self._errand.done or taken < self._at:
            return None
        self._wanted = False
        rest = self._errand.result()
        return None if rest is None else list(rest)
