"""Keys while a plot runs: `p` pauses and goes on, `h` goes home and waits, `q` stops. Only when stdin is a terminal;
of a drawing that came through it, the terminal has taken its place (standard_streams.keyboard_after_a_drawing).

The terminal is shared with a shell: Ctrl-Z lends it back, `bg` and `&` leave the program without it, `fg` brings it. Its mode
is touched, and it is read, only while this program is in its foreground; anything else would stop the program in mid-plot.
"""

from __future__ import annotations

import contextlib
import os
import re
import select
import signal
import sys
import threading
from collections.abc import Iterator
from typing import Any

from output.ebb.control import StopFlag, suspend_process
from plotter.cli.say import ways_on
from plotter.cli.standard_streams import aside, in_front

try:
    import termios
    import tty
except ImportError:  # Windows: Ctrl-C and the board's button remain
    termios = None  # type: ignore[assignment]

# How often it is looked whether the shell has given the terminal back: `fg` after `bg` sends nothing.
_LOOK_EVERY_S = 0.2
# What function and cursor keys send, and letters with Alt: ESC O Q is F2, no q. A terminal sends all of one at once, so that
# the rest of one is waited for that long; what comes later followed the Esc key.
_SEQUENCE = re.compile(rb"\x1b+(?:(?:\[\[?|O)[0-?]*[ -/]*[@-~]|[^\[O\x1b])")
_SEQUENCE_BEGUN = re.compile(rb"\x1b+(?:(?:\[\[?|O)[0-?]*[ -/]*)?\Z")
_SEQUENCE_S = 0.1


class _Terminal:
    """stdin's terminal: in single-key mode while we have it. `turn` is held by whoever changes that."""

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        self.turn = threading.Lock()
        self._shells_mode: list[Any] | None = None

    def in_front(self) -> bool:
        """Whether keys are ours and not the shell's or another program's."""
        return in_front(self.descriptor)

    def take(self) -> bool:
        """Single keys, no echo, Ctrl-C and Ctrl-Z stay signals; False where it is not ours to take. Raises termios.error."""
        if not self.in_front():
            self._shells_mode = None
        elif self._shells_mode is None:
            self._shells_mode = termios.tcgetattr(self.descriptor)
            # At once: what was typed while the drawing was prepared counts, and what is to be shown may never be (Ctrl-S).
            tty.setcbreak(self.descriptor, termios.TCSANOW)
        return self._shells_mode is not None

    def give_back(self) -> None:
        if self._shells_mode is not None and self.in_front():
            with contextlib.suppress(termios.error):  # a terminal that was closed has no mode any more
                termios.tcsetattr(self.descriptor, termios.TCSANOW, self._shells_mode)
        self._shells_mode = None


@contextlib.contextmanager
def keys(stop: StopFlag) -> Iterator[bool]:
    """Listens for keys until the context is left; the value says whether it can. The terminal gets its own mode back."""
    if termios is None or not sys.stdin.isatty():
        yield False
        return
    terminal = _Terminal(sys.stdin.fileno())
    read_end, write_end = os.pipe()
    listener = threading.Thread(target=_listen, args=(terminal, read_end, stop), daemon=True, name="keys")
    try:
        with _background_allowed():
            terminal.take()
            stop.suspends = lambda: _suspend(terminal, stop)
            listener.start()
            yield True
    finally:
        stop.suspends = None
        os.write(write_end, b"x")
        if listener.is_alive():
            listener.join(1.0)
        with terminal.turn:
            terminal.give_back()
        os.close(read_end)
        os.close(write_end)


@contextlib.contextmanager
def _background_allowed() -> Iterator[None]:
    """A plot in the background may reach for the terminal a moment after it was lent: it must not be stopped for that."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, signal.SIG_IGN) for number in (signal.SIGTTIN, signal.SIGTTOU)}
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, signal.SIG_DFL if old is None else old)


def _suspend(terminal: _Terminal, stop: StopFlag) -> None:
    """Ctrl-Z, in the pause: the shell gets its terminal until it says `fg`."""
    _say("suspended with the pen up: `fg` comes back to the plot, still paused")
    with terminal.turn:
        terminal.give_back()
        suspend_process()
        front = terminal.take()
    _say(_still(stop) if front else "still paused, in the background: `fg` for the keys; the board's button goes on as well")


def _still(stop: StopFlag) -> str:
    if stop.pause_reason is None:
        return "the keys work again"
    return f"still paused: {ways_on(stop)}"


def _say(sentence: str) -> None:
    with contextlib.suppress(ValueError):  # a closed stream
        aside(sentence)


def _listen(terminal: _Terminal, end: int, stop: StopFlag) -> None:
    was_in_front = terminal.in_front()
    while True:
        try:
            with terminal.turn:
                in_front = terminal.take()
        except termios.error:  # it was closed
            return
        if in_front and not was_in_front:
            _say(_still(stop))
        was_in_front = in_front
        ready, _, _ = select.select([terminal.descriptor, end] if in_front else [end], [], [], _LOOK_EVERY_S)
        if end in ready:
            return
        if terminal.descriptor not in ready or not terminal.in_front():
            continue
        try:
            typed = _read(terminal.descriptor)
        except OSError:
            if terminal.in_front():
                return
            continue
        if not typed:
            return
        for key in _SEQUENCE_BEGUN.sub(b"", _SEQUENCE.sub(b"", typed)).lower():
            press(chr(key), stop)


def _read(descriptor: int) -> bytes:
    """What has been typed, with the rest of a sequence that it ends in; nothing when the terminal is gone."""
    typed = os.read(descriptor, 64)
    while _SEQUENCE_BEGUN.search(typed) and select.select([descriptor], [], [], _SEQUENCE_S)[0]:
        if not (more := os.read(descriptor, 64)):
            break
        typed += more
    return typed


def press(key: str, stop: StopFlag) -> None:
    """What a key does: `p` or space pauses, and goes on when paused; `h` pauses and goes home, if known; `q` stops."""
    if key in ("p", " "):
        if stop.pause_reason is None:
            stop.pause("paused by key")
        else:
            stop.never_mind()
    elif key == "h" and stop.knows_home:
        if stop.pause_reason is None:
            stop.pause("paused by key")
        stop.go_home()
    elif key == "q":
        stop.stop("stopped by key")
