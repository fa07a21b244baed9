"""Every command of the EiBotBoard as a small frozen value that knows its wire form."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar


@dataclass(frozen=True, slots=True)
class Command:
    """Base of all commands. `wire()` is the command exactly as sent, without the line ending."""

    name: ClassVar[str]

    @property
    def queued(self) -> bool:
        """True when the command waits in the board's motion queue."""
        return False

    @property
    def fifo_entries(self) -> int:
        """How many places of the motion queue it takes: 0 when immediate, 2 for TD."""
        return 1 if self.queued else 0

    def wire(self) -> str:
        raise NotImplementedError
