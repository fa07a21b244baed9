"""What must not pass for the ordinary in a plot: a board that is stuck, a button that is, a computer that was asleep."""

from __future__ import annotations

from collections import deque

from output.ebb.board_time import way_s
from output.ebb.commands import HM
from output.ebb.conversation import suspended_s
from output.ebb.progress import Sent
from output.errors import BoardRefused

# How much longer than predicted the oldest command may be waited for before the board is said to be stuck.
_STUCK_MARGIN_S = 5.0
_BUTTON_PRESSES, _BUTTON_STUCK_S = 3, 1.0
# A difference between the clocks that stop in sleep and those that do not: more than their own jitter.
_SLEPT_S = 0.5


class StuckBoard:
    """How long the board has been busy with one command. Seconds of waiting, `Conversation.waited_s`."""

    def __init__(self, board_speed: float) -> None:
        self._speed = board_speed
        self._oldest = 0
        self._since_s = 0.0
        self._lasts_s = 0.0

    def look(self, oldest: Sent | None, steps: tuple[int, int] | None, waited_s: float) -> None:
        """`oldest` is the command that is executed now, None when the board is idle. Raises BoardRefused for one that takes
        much longer than it should."""
        if oldest is None or oldest.queued != self._oldest:
            self._oldest, self._since_s, self._lasts_s = 0 if oldest is None else oldest.queued, waited_s, 0.0
            return
        if isinstance(oldest.command, HM) and steps is not None:  # the farthest it has been seen from its end
            self._lasts_s = max(self._lasts_s, way_s(oldest.command, steps))
        seconds = max(oldest.seconds, self._lasts_s) / self._speed
        busy_s = waited_s - self._since_s
        if busy_s > seconds * 1.5 + _STUCK_MARGIN_S:
            raise BoardRefused(
                f"the board is busy with command {oldest.index + 1} for {busy_s:.1f} s, which should take {seconds:.1f} s: "
                "it is stuck; power it off and on"
            )


class Button:
    """The board's button, whose input may be floating or shorted."""

    def __init__(self) -> None:
        self._pressed_at: deque[float] = deque(maxlen=_BUTTON_PRESSES)

    def stuck(self, now: float) -> bool:
        """It has been pressed; whether as no finger can."""
        self._pressed_at.append(now)
        return len(self._pressed_at) == _BUTTON_PRESSES and now - self._pressed_at[0] < _BUTTON_STUCK_S


class Sleep:
    """Whether this computer has been asleep."""

    def __init__(self) -> None:
        self._slept_s = suspended_s()

    def since_last(self) -> float:
        """Seconds that it has slept since this was asked last; 0 for what is no sleep."""
        before, self._slept_s = self._slept_s, suspended_s()
        slept_s = self._slept_s - before
        return slept_s if slept_s > _SLEPT_S else 0.0
