"""The wire: one end of a pseudo-terminal for the board, a path for the program that plots."""

from __future__ import annotations

import os
import pty
import tty
from pathlib import Path


class PseudoTerminal:
    """An open pty in raw mode; `link`, if given, is a symbolic link to it that goes away with it.

    The board's end is `fd`, not blocking. Both ends are held open here, so that the program may come and go.
    Raises OSError when the link cannot be made.
    """

    def __init__(self, link: Path | None = None) -> None:
        self.link = link
        self.fd, self._other = pty.openpty()
        tty.setraw(self._other)
        os.set_blocking(self.fd, False)
        self.device = os.ttyname(self._other)
        if link is not None:
            # Only what an earlier virtual board left behind is replaced.
            if link.is_symlink() and str(link.readlink()).startswith("/dev/pts/"):
                link.unlink()
            try:
                link.symlink_to(self.device)
            except OSError:
                os.close(self.fd)
                os.close(self._other)
                raise

    @property
    def port(self) -> str:
        """The path to open."""
        return self.device if self.link is None else str(self.link)

    def read(self, size: int) -> bytes:
        """Up to `size` bytes that have arrived, b"" when there are none."""
        try:
            return os.read(self.fd, size)
        except BlockingIOError:
            return b""

    def write(self, data: bytes) -> int:
        """Bytes that were taken; fewer than all when the other side does not read."""
        try:
            return os.write(self.fd, data)
        except BlockingIOError:
            return 0

    def hang_up(self) -> None:
        """Pull the plug: whoever has the port open gets an error, and the link is gone."""
        if self.link is not None and self.link.is_symlink() and str(self.link.readlink()) == self.device:
            self.link.unlink()
        os.close(self.fd)
        os.close(self._other)
