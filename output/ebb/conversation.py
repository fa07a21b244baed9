"""Commands with deadlines over one port: the protocol core, the port and the clock brought together.

Every command has its own bound for its reply, in time spent waiting for it. Motion is never sent again: a reply that did not
come may mean a command that was done.

Clocks: the host's monotonic seconds, and `waited_s`, in which every deadline for the board is counted: it stands still while
this program is held up (SIGSTOP, a busy computer), when the board, or the system between, may have had no turn either.
"""

from __future__ import annotations

import math
import secrets
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from output.ebb.link import Port
from output.ebb.protocol import Event, Notice, Protocol, Refusal, Reply, Resynced, Stray, Syntax
from output.errors import BoardRefused, LinkLost, PositionLost

# The slowest command to parse takes the board 6 ms; the rest of this second is for a busy host and a slow USB hub.
REPLY_TIMEOUT_S = 1.0
_LONGEST_WAIT_S, NOTHING_S = 0.1, 1e-6
# A wait that comes back this much after its time was held up. So much is counted beyond each wait's own time, for what this
# program does between two of them: a deadline also comes for whoever only looks, or for a board that never stops talking.
_HELD_UP_S = 0.01
_CLOCKS_TOGETHER_S, _CLOCK_READINGS = 0.05, 20

Clock = Callable[[], float]


@dataclass(slots=True)
class _Due:
    number: int
    wire: str
    overdue_at_s: float
    timeout_s: float


class Conversation:
    """One board on one port. Not thread-safe: one loop owns it."""

    def __init__(self, port: Port, clock: Clock = time.monotonic, protocol: Protocol | None = None) -> None:
        self.port = port
        self.clock = clock
        self.protocol = protocol or Protocol()
        self._due: deque[_Due] = deque()
        # Every bit that QG has said, whoever asked: reading it clears the button's and the power's on the board.
        self.status_bits = 0
        self.waited_s = 0.0
        self._waited_until = clock()

    @property
    def pending(self) -> int:
        """Commands sent and not answered."""
        return len(self._due)

    def send(self, wire: str, timeout_s: float = REPLY_TIMEOUT_S) -> int:
        """Writes a command; its number comes back with its reply. Raises LinkLost."""
        number, data = self.protocol.send(wire)
        self._due.append(_Due(number, wire, self.waited_s + timeout_s, timeout_s))
        self.port.send(data)
        return number

    def receive(self, timeout_s: float) -> list[Event]:
        """What the board says within `timeout_s`; returns at the first news, or early when the port is woken.

        Raises LinkLost when the port is gone, or when the oldest reply is overdue.
        """
        data = self.wait(min(timeout_s, self._left_s()))
        if not data and self._left_s() < NOTHING_S:
            late = self._due[0]
            raise LinkLost(
                f"{self.port.name}: no answer to {late.wire!r} within {late.timeout_s:g} s, so the board hangs or a reply "
                "was lost: check the USB cable"
            )
        events = self.protocol.receive(data)
        for event in events:
            if isinstance(event, Reply | Refusal):
                self._settle(event.number)
            if isinstance(event, Reply) and event.name == "QG":
                self.status_bits |= int(event.data, 16)
        return events

    def wait(self, timeout_s: float) -> bytes:
        """What the port has within `timeout_s` of `waited_s`; returns early when woken, and after a tenth of a second.

        Raises LinkLost when the port is gone.
        """
        allowed_s, before = min(max(0.0, timeout_s), _LONGEST_WAIT_S), self.clock()
        data = self.port.receive(allowed_s)
        after = self.clock()
        held_up = after - before > allowed_s + _HELD_UP_S
        if held_up and not data:
            # Held up, or cut short after its time by a signal (SIGCONT), it may have come back without having looked.
            data = self.port.receive(0.0)
        counted_s = 0.0 if held_up and data else allowed_s
        self.waited_s += min(after - self._waited_until, counted_s + _HELD_UP_S)
        self._waited_until = after
        return data

    def _left_s(self) -> float:
        """For how long the oldest reply may still be waited for."""
        return self._due[0].overdue_at_s - self.waited_s if self._due else math.inf

    def _settle(self, number: int) -> None:
        while self._due and self._due[0].number <= number:
            self._due.popleft()

    def ask(self, wire: str, timeout_s: float = REPLY_TIMEOUT_S) -> str:
        """Sends one command and waits for its own reply; returns the reply's data.

        Raises BoardRefused when the board answers with an error, LinkLost for no answer or one that belongs to nobody.
        """
        number = self.send(wire, timeout_s)
        while True:
            for event in self.receive(timeout_s):
                if isinstance(event, Reply) and event.number == number:
                    return event.data
                if not isinstance(event, Reply):
                    raise complaint(event, wire)

    def resync(self, timeout_s: float = REPLY_TIMEOUT_S) -> bool:
        """Gives up every unanswered command and finds the place in the board's replies again, and its syntax.

        False when the board does not answer in time. Raises LinkLost when the port is gone.
        """
        self._due.clear()
        deadline_s = self.waited_s + timeout_s
        self.port.send(self.protocol.resync(secrets.randbelow(0xFFFFFFFF) + 1))
        while (left_s := deadline_s - self.waited_s) > NOTHING_S:
            for event in self.protocol.receive(self.wait(left_s)):
                if isinstance(event, Resynced):
                    return True
        return False

    @property
    def syntax(self) -> Syntax:
        return self.protocol.syntax


def suspended_s() -> float:
    """For how long this computer has been asleep since it was started; 0 where the system does not tell.

    The two clocks cannot be read at one moment. A reading that was itself held up, on a busy computer, is done again: it would
    look like a sleep.
    """
    boot = getattr(time, "CLOCK_BOOTTIME", None)
    if boot is None:
        return 0.0
    for _ in range(_CLOCK_READINGS):
        before_s = time.clock_gettime(time.CLOCK_MONOTONIC)
        boot_s = time.clock_gettime(boot)
        if time.clock_gettime(time.CLOCK_MONOTONIC) - before_s < _CLOCKS_TOGETHER_S:
            break
    return boot_s - before_s


def complaint(event: Event, context: str) -> BoardRefused | LinkLost:
    """The error for something that should not have come; `context` says what was being done."""
    if isinstance(event, Refusal):
        return BoardRefused(f"the board refused {context}: {event.text}")
    if isinstance(event, Notice) and event.text.startswith("Limit"):
        return PositionLost(f"{event.text.rstrip()}, during {context}", "free the switch")
    if isinstance(event, Notice):
        return PositionLost(f"the board restarted ({event.text}) during {context}, so that its position is lost")
    text = event.text if isinstance(event, Stray) else repr(event)
    return LinkLost(
        f"a reply nobody asked for, {text[:60]!r}, during {context}: replies were lost or another program uses the port; "
        "check the cable and end the other program"
    )
