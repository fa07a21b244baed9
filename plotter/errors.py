"""What ends a command early, as a person meets it: one sentence with the value, the bound and the next step."""

from __future__ import annotations

from collections.abc import Iterable


class BadInput(Exception):
    """The drawing, a flag or a settings file cannot be used as given. `reasons` say what led there, a sentence each."""

    def __init__(self, message: str, reasons: Iterable[str] = ()) -> None:
        super().__init__(message)
        self.reasons = tuple(reasons)


class Paused(Exception):
    """The plot waits for the operator; `plotter resume` goes on with it."""


class Interrupted(Exception):
    """The operator ended the plot; the pen was raised first, or the message says that it could not be."""
