"""Standard input, output and error: there from the start, whoever started the program, and no hostage-takers at its end."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Callable
from contextlib import suppress

import click

from output.errand import Errand

# Whoever read the output is gone: a pipe or a terminal that was closed.
NOBODY_READS = (errno.EPIPE, errno.EIO)
# There is no room for it: a full disk, a quota, a limit of size.
NO_ROOM = tuple(getattr(errno, name) for name in ("ENOSPC", "EDQUOT", "EFBIG") if hasattr(errno, name))


# A terminal takes nothing while it is stopped (Ctrl-S) or its connection is dead; so long it is given for each thing said.
_WRITE_TIMEOUT_S = 0.5


def in_time(write: Callable[[], object]) -> None:
    """Lets `write` write, and goes on without it when that takes too long: it is written later then, if the program still runs.
    Raises what was raised by then."""
    errand = Errand(write)
    errand.wait(_WRITE_TIMEOUT_S)
    if errand.done:
        errand.result()


def open_the_closed() -> None:
    """Gives each of them that was closed (`<&-`, `>&-`, `2>&-`) the null device, so that it can be asked and written to.

    Without that a port or a journal would get the free number, 0 to 2, and with it whatever is written to that stream.
    """
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        try:
            os.fstat(number)
        except OSError:
            null = os.open(os.devnull, os.O_RDWR)
            if null != number:
                os.dup2(null, number)
                os.close(null)
            os.set_inheritable(number, True)
        if getattr(sys, name) is None:  # what Python makes of a closed one
            setattr(sys, name, open(number, mode, encoding="utf-8", closefd=False))  # noqa: SIM115 - for as long as it runs


def keyboard_after_a_drawing() -> None:
    """A drawing was read from standard input, to its end: from here on that is the terminal, if there is one, for keys."""
    if not sys.stdin.isatty():
        with suppress(OSError):  # no terminal at all, as under cron, or Windows
            terminal = os.open("/dev/tty", os.O_RDWR)
            os.dup2(terminal, sys.stdin.fileno())
            os.close(terminal)


def in_front(terminal: int) -> bool:
    """Whether a terminal is ours now, and not the shell's or another program's that was started since."""
    try:
        return os.tcgetpgrp(terminal) == os.getpgrp()
    except (OSError, AttributeError):  # not our session's terminal, a closed one, or Windows: nobody to share it with
        return True


def settle() -> None:
    """Writes what is still held back. What cannot be written is dropped: left to the interpreter's end, it would make code 120
    of a plot that is drawn."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, ValueError):
            with suppress(OSError, ValueError):
                null = os.open(os.devnull, os.O_WRONLY)
                os.dup2(null, stream.fileno())
                os.close(null)


def aside(sentence: str) -> None:
    """Beside what was asked for, on standard error; where nobody can read it, it is dropped: a plot is not its hostage."""
    with suppress(OSError):
        in_time(lambda: click.echo(sentence, err=True))


def done(sentence: str) -> None:
    """What was done, on standard output. A full disk there does not undo it: then it is said on standard error."""
    try:
        in_time(lambda: click.echo(sentence))
    except OSError as error:
        settle()
        if error.errno not in NOBODY_READS:
            aside(f"note: standard output takes no more ({error.strerror}): {sentence}")
