"""The wire: one end of a pseudo-terminal for the board, a path for the program that plots."""

from __future__ import annotations

import os
import pty
import tty
from pathlib import Path

from output.errors import BadCommand


class PseudoTerminal:
    """An open pty in raw mode; `link`, if given, is a symbolic link to it that goes away with it.

    The board's end is `fd`, not blocking. Both ends are held open here, so that the program may come and go.
    Raises BadCommand when the link cannot be made.
    """

    def __init__(self, link: Path | None = None) -> None:
        self.link = link
        if link is not None:  # before there is a terminal of ours, which may get the number that a link was left behind with
            _make_room(link)
        self.fd, self._other = pty.openpty()
        tty.setraw(self._other)
        os.set_blocking(self.fd, False)
        self.device = os.ttyname(self._other)
        if link is not None:
            try:
                link.symlink_to(self.device)
            except OSError as problem:
                os.close(self.fd)
                os.close(self._other)
                raise BadCommand(
                    f"port {link} cannot be made: {problem.strerror}; choose a path that is not there yet"
                ) from problem

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


def _make_room(link: Path) -> None:
    """Takes a link away that an earlier virtual board left behind. Raises BadCommand when its terminal is there."""
    if link.is_symlink() and (target := link.readlink()).is_relative_to("/dev/pts"):
        if target.exists():
            raise BadCommand(
                f"port {link} cannot be made: {link} leads to {target}, which is there: another virtual board may be running; "
                "choose another path, or remove the link if none is"
            )
        link.unlink(missing_ok=True)
