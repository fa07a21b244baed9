"""One program a board: a lock file beside the port's own lock, so that a refusal can name who holds it.

The port itself is also opened exclusively (link.SerialPort); that is what keeps others out. This file says who: process number
and command line. It goes when its holder ends, however it ends, because the lock on it does.
"""

from __future__ import annotations

import contextlib
import os
import re
import sys
import tempfile
from pathlib import Path

from output.errors import BoardRefused

try:
    import fcntl
except ImportError:  # Windows: ports are exclusive there by themselves
    fcntl = None  # type: ignore[assignment]

_NAME_BYTES = 200


class PortLock:
    """Holds the lock of one port until `release`. Raises BoardRefused, naming the holder, when another process has it."""

    def __init__(self, port: str, directory: Path | None = None) -> None:
        self._descriptor: int | None = None
        where = directory or Path(tempfile.gettempdir())
        self.path = where / ("plotter-lock" + re.sub(r"[^A-Za-z0-9]+", "-", os.path.realpath(port)))
        if fcntl is not None:
            self._take(port)

    def _take(self, port: str) -> None:
        for _ in range(3):
            try:
                descriptor = os.open(self.path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o666)
            except OSError:
                return  # nowhere to write: the port's own lock still stands
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                holder = os.pread(descriptor, _NAME_BYTES, 0).decode("utf-8", "replace").strip()
                os.close(descriptor)
                raise BoardRefused(
                    f"{port} is in use by {holder or 'another program'}: wait until it has finished, or end it"
                ) from error
            if self._is_current(descriptor):
                with contextlib.suppress(OSError):  # a full disk: the lock holds without saying who
                    os.ftruncate(descriptor, 0)
                    os.pwrite(descriptor, f"process {os.getpid()} ({' '.join(sys.argv)[:120]})\n".encode(), 0)
                self._descriptor = descriptor
                return
            os.close(descriptor)  # its holder removed it between our open and our lock: take the new one

    def _is_current(self, descriptor: int) -> bool:
        try:
            return self.path.stat().st_ino == os.fstat(descriptor).st_ino
        except OSError:
            return False

    def release(self) -> None:
        """Gives the lock back; once is enough, twice is harmless."""
        if self._descriptor is None:
            return
        with contextlib.suppress(OSError):
            self.path.unlink()
        with contextlib.suppress(OSError):
            os.close(self._descriptor)
        self._descriptor = None
