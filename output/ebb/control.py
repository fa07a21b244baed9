"""What an operator can ask of a running plot: stop, pause, sleep, go on. Asking sets a flag and wakes the loop that streams.

Python's own answer to Ctrl-C, an exception out of whatever happens to be running, would lose the reply of the command in flight
and shift every later one, so that the pen could not even be raised. Signals therefore end here.
"""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Callable, Iterator

# All that would end the program and can be caught.
SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGUSR1", "SIGUSR2", "SIGALRM")
# What a person calls those that a terminal's keys send.
_KEYS = {"SIGINT": "Ctrl-C", "SIGTSTP": "Ctrl-Z"}


class StopFlag:
    """Requests from signal handlers, other threads and buttons, read by the one loop that owns the port.

    Every method may be called from a signal handler: it takes no lock and only assigns. `unattended`: no key can be pressed, so
    that a signal for a pause ends the plot there, and one in a pause as well, motors on. `knows_home`: there is a home
    position that a pause can be left for.
    """

    def __init__(self) -> None:
        self.reason: str | None = None
        self.signal_number: int | None = None
        self.hurry = False
        self.pause_reason: str | None = None
        self.pause_signal: int | None = None
        self.leave_asked = False
        self.home_asked = False
        self.unattended = False
        self.knows_home = True
        # Ctrl-Z: to be done in the pause. Whoever holds the terminal says how (keys.py); without one it is nobody's to ask.
        self.suspend_asked = False
        self.suspends: Callable[[], None] | None = None
        self._wakers: tuple[Callable[[], None], ...] = ()

    @property
    def requested(self) -> bool:
        return self.reason is not None

    def stop(self, reason: str, signal_number: int | None = None) -> None:
        """End the plot now. Asked twice, the second one asks for haste; the pen is raised all the same."""
        if self.reason is None:
            self.reason, self.signal_number = reason, signal_number
        else:
            self.hurry = True
        self._wake()

    def pause(self, reason: str, signal_number: int | None = None) -> None:
        """Hold the plot, pen up, at the next place where that can be done; `go` ends it."""
        self.pause_reason, self.pause_signal = reason, signal_number
        self._wake()

    def go(self) -> None:
        """Go on after a pause."""
        self.pause_reason = self.pause_signal = None
        self.suspend_asked = False
        self._wake()

    def never_mind(self) -> None:
        """Go on, perhaps before the pause has begun, and forget what was to be done in it: to leave it, to go home."""
        self.leave_asked = self.home_asked = False
        self.go()

    def leave(self) -> None:
        """End the stream at the pause instead of waiting in it, pen up and motors on."""
        self.leave_asked = True
        self._wake()

    def go_home(self) -> None:
        """Leave the pause for the home position; whoever streams sees to the way there."""
        self.home_asked = True
        self.leave()

    def suspend_in_pause(self) -> None:
        """Ctrl-Z: hold the plot as `pause` does, and put this program to sleep there."""
        self.suspend_asked = True
        if self.pause_reason is None:
            self.pause("paused by Ctrl-Z")
        self._wake()

    def suspend(self) -> None:
        """Sleep, now that the pen is up; returns when the shell has this program go on."""
        self.suspend_asked = False
        (self.suspends or suspend_process)()

    @contextlib.contextmanager
    def waking(self, wake: Callable[[], None]) -> Iterator[None]:
        """Calls `wake` at every request for as long as the context lasts."""
        self._wakers = (*self._wakers, wake)
        try:
            yield
        finally:
            self._wakers = tuple(w for w in self._wakers if w is not wake)

    def _wake(self) -> None:
        for wake in self._wakers:
            wake()


@contextlib.contextmanager
def signals_stop(flag: StopFlag, *, pauses: bool = False) -> Iterator[None]:
    """SIGINT, SIGTERM, SIGHUP, SIGQUIT and the like ask `flag` to stop instead of ending the program; the old handlers come
    back afterwards.

    With `pauses`, SIGINT pauses first and stops when it comes again; in a pause that came otherwise it stops, or, where the
    flag is `unattended`, has the pause end the plot. SIGTSTP (Ctrl-Z) has the program sleep with the pen up, in the next pause,
    where somebody can press a key to end that; else it is a first SIGINT with `pauses`, and without waits for the end of the
    context.

    Only the main thread may set handlers; elsewhere this does nothing, and whoever runs the thread owns the signals.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    stop_from_terminal = getattr(signal, "SIGTSTP", None)

    def handler(number: int, _frame: object) -> None:
        if number == stop_from_terminal:
            _ctrl_z(flag, number, pauses=pauses)
        elif pauses and number == signal.SIGINT and flag.pause_reason is None and flag.reason is None:
            flag.pause(f"paused by {_called(number)}", number)
        elif pauses and number == signal.SIGINT and flag.reason is None and flag.unattended and flag.pause_signal is None:
            flag.pause(flag.pause_reason or "", number)
        else:
            flag.stop(f"stopped by {_called(number)}", number)

    before = {}
    for name in (*SIGNALS, "SIGTSTP"):
        number = getattr(signal, name, None)
        # What is ignored stays so: SIGHUP by nohup, SIGTSTP by a shell without job control, where nothing could wake us.
        if number is not None and (name == "SIGINT" or signal.getsignal(number) is not signal.SIG_IGN):
            before[number] = signal.signal(number, handler)
    try:
        yield
    finally:
        for number, old in before.items():
            if signal.getsignal(number) is handler:  # else `ignore_signals` has said that the program is ending
                signal.signal(number, signal.SIG_DFL if old is None else old)
    if flag.suspend_asked and not pauses and not flag.requested:
        flag.suspend()


def _called(number: int) -> str:
    name = signal.Signals(number).name
    return _KEYS.get(name, name)


def _ctrl_z(flag: StopFlag, number: int, *, pauses: bool) -> None:
    if flag.suspends is not None:
        flag.suspend_in_pause()
    elif not pauses:
        flag.suspend_asked = True
    elif flag.pause_reason is None:
        flag.pause(f"paused by {_called(number)}", number)


def suspend_process() -> None:
    """Stops this process as a terminal's Ctrl-Z does; returns when it is continued."""
    if threading.current_thread() is not threading.main_thread():
        os.kill(os.getpid(), signal.SIGSTOP)
        return
    before = signal.signal(signal.SIGTSTP, signal.SIG_DFL)
    try:
        signal.raise_signal(signal.SIGTSTP)
    finally:
        signal.signal(signal.SIGTSTP, signal.SIG_DFL if before is None else before)


@contextlib.contextmanager
def signals_as_they_were() -> Iterator[None]:
    """Afterwards every signal does what it did before: for whoever goes on after a command that has ended with them ignored."""
    before = {number: signal.getsignal(number) for name in SIGNALS if (number := getattr(signal, name, None)) is not None}
    try:
        yield
    finally:
        for number, handler in before.items():
            if signal.getsignal(number) is not handler:
                signal.signal(number, signal.SIG_DFL if handler is None else handler)


def ignore_signals() -> None:
    """For the last moments of a program that a signal has ended: an impatient second Ctrl-C must not spoil its exit code."""
    if threading.current_thread() is threading.main_thread():
        for name in SIGNALS:
            if hasattr(signal, name):
                signal.signal(getattr(signal, name), signal.SIG_IGN)


@contextlib.contextmanager
def signals_end_here(flag: StopFlag, *, pauses: bool = False) -> Iterator[None]:
    """`signals_stop` from the first stream of a command to the command's end: afterwards signals are ignored, on every way out.

    Between the streams of a plot, while its bar and keys are put away, its journal is ended and its last message is said, an
    impatient Ctrl-C would take from the operator how the plot can be gone on with. Nothing waits for anything without a
    deadline by then.
    """
    with signals_stop(flag, pauses=pauses):
        try:
            yield
        finally:
            ignore_signals()
