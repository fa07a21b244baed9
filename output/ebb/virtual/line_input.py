"""Bytes from the wire to command lines, as the board's receive loop does it.

CR or LF ends a line, any run of them counts once; bytes below 0x20 are dropped; backspace edits and is echoed; the buffer
holds 256 bytes with an 8-bit index, so a longer line overwrites its own beginning.
"""

from __future__ import annotations

from collections.abc import Iterator

_BACKSPACE = 8
_ENDS = (10, 13)
_BINARY_LENGTH = 28


class LineInput:
    """Collects bytes; `lines` yields what is complete. `binary_y`: 3.0.2 takes 28 bytes after a leading Y as one command."""

    def __init__(self, *, binary_y: bool = False) -> None:
        self._line = bytearray()
        self._skip = 0
        self._binary_y = binary_y
        self._first_ever = True

    def lines(self, data: bytes) -> Iterator[tuple[bytes | None, bytes]]:
        """(line, b"") for every completed line, (None, echo) for every echo of a backspace; in order."""
        for byte in data:
            if self._skip:
                self._skip -= 1
                continue
            first_ever, self._first_ever = self._first_ever, False
            if byte in _ENDS:
                if self._line or first_ever:
                    # A terminator as the very first byte after power-on is parsed as an empty packet.
                    length = len(self._line)
                    line = bytes(self._line[length - length % 256 :]) if length > 255 else bytes(self._line)
                    self._line.clear()
                    yield (line if line or not first_ever else bytes([byte])), b""
            elif byte == _BACKSPACE:
                if self._line:
                    self._line.pop()
                    yield None, b" \x08"
            elif byte >= 0x20:
                if self._binary_y and not self._line and byte in b"Yy":
                    self._skip = _BINARY_LENGTH - 1
                    continue
                self._line.append(byte)

    def clear(self) -> None:
        """Forget the unfinished line (the board was reset)."""
        self._line.clear()
        self._skip = 0
        self._first_ever = True
