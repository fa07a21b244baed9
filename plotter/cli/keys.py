"""Keys while a plot runs: `p` pauses and goes on, `h` goes home and waits, `q` stops. Only when stdin is a terminal."""

from __future__ import annotations

import contextlib
import os
import select
import sys
import threading
from collections.abc import Iterator

from output.ebb.control import StopFlag

try:
    import termios
    import tty
except ImportError:  # Windows: Ctrl-C and the board's button remain
    termios = None  # type: ignore[assignment]


@contextlib.contextmanager
def keys(stop: StopFlag) -> Iterator[bool]:
    """Listens for keys until the context is left; the value says whether it can. The terminal gets its own mode back."""
    if termios is None or not sys.stdin.isatty():
        yield False
        return
    descriptor = sys.stdin.fileno()
    before = termios.tcgetattr(descriptor)
    read_end, write_end = os.pipe()
    listener = threading.Thread(target=_listen, args=(descriptor, read_end, stop), daemon=True, name="keys")
    try:
        # Single keys, no echo; Ctrl-C stays a signal. What was typed while the drawing was prepared counts.
        tty.setcbreak(descriptor, termios.TCSADRAIN)
        listener.start()
        yield True
    finally:
        os.write(write_end, b"x")
        if listener.is_alive():
            listener.join(1.0)
        with contextlib.suppress(termios.error):  # a terminal that was closed has no mode any more
            termios.tcsetattr(descriptor, termios.TCSADRAIN, before)
        os.close(read_end)
        os.close(write_end)


def _listen(descriptor: int, end: int, stop: StopFlag) -> None:
    while True:
        ready, _, _ = select.select([descriptor, end], [], [])
        if end in ready:
            return
        try:
            pressed = os.read(descriptor, 16)
        except OSError:
            return
        if not pressed:
            return
        for key in pressed.lower():
            press(chr(key), stop)


def press(key: str, stop: StopFlag) -> None:
    """What a key does: `p` or space pauses, and goes on when paused; `h` pauses and goes home; `q` stops."""
    if key in ("p", " "):
        if stop.pause_reason is None:
            stop.pause("paused by key")
        else:
            stop.go()
    elif key == "h":
        if stop.pause_reason is None:
            stop.pause("paused by key")
        stop.go_home()
    elif key == "q":
        stop.stop("stopped by key")
