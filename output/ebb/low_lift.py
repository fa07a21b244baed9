"""A pen that hangs low between two strokes is raised for a pause: nobody should have to reach under it."""

from __future__ import annotations

from output.ebb.commands import S2, SP, TP, Command


class LowLift:
    """Follows the pen through what is sent: whether it hangs on a low lift, by S2 on the pin that SP lowers it on."""

    def __init__(self) -> None:
        self._pin: int | None = None  # RB pin of the last SP; None is its default, 1
        self._lift: S2 | None = None  # the last pen move, when it was a low lift
        self._raised = False  # from there, for a pause

    def note(self, command: Command) -> None:
        if isinstance(command, SP):
            self._pin = command.pin
        if isinstance(command, SP | TP):
            self._lift = None
        elif isinstance(command, S2) and command.pin == 3 + (1 if self._pin is None else self._pin):
            self._lift = command

    def rise(self) -> SP | None:
        """What raises the pen for a pause; None where it does not hang low, or has been raised."""
        if self._lift is None or self._raised:
            return None
        self._raised = True
        return SP(1, None if self._pin is None else 0, self._pin)

    def back(self) -> S2 | None:
        """What takes it back to the low height, from which the plan goes on."""
        if self._lift is None or not self._raised:
            return None
        self._raised = False
        return self._lift
