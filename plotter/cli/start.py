"""Where the program begins. Ctrl-C is answered from here on, while the rest is still being loaded.

Python's own answer, an exception out of whatever happens to be running, is lost or ends in a crash where that is a module
that is just being made. Nothing is open yet and nothing moves, so that there is nothing to be put away.
"""

from __future__ import annotations

import os
import signal

_INTERRUPTED = 130
_asked = False


def main(arguments: list[str] | None = None) -> None:
    """Load the command line and run it; see `plotter.cli.main.main`."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # else it is ignored, by `&` in a script
        signal.signal(signal.SIGINT, _interrupted)
    from plotter.cli.main import main as run

    run(arguments)


def loaded() -> None:
    """From here on Ctrl-C is an exception, or whatever a command makes of it."""
    if signal.getsignal(signal.SIGINT) is _interrupted:
        signal.signal(signal.SIGINT, _raised)


def must_still_be_wanted() -> None:
    """Before anything is drawn: raises the KeyboardInterrupt that got lost, where it was raised out of a destructor."""
    if _asked:
        raise KeyboardInterrupt


def _raised(_number: int, _frame: object) -> None:
    global _asked
    _asked = True
    raise KeyboardInterrupt


def _interrupted(_number: int, _frame: object) -> None:
    try:
        os.write(2, b"plotter: interrupted\n")
    finally:  # whether or not anybody reads it
        os._exit(_INTERRUPTED)
