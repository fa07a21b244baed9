"""Command checksums (CU,54,1): the line ends in a comma and the two's complement of the sum of the bytes before it."""

from __future__ import annotations

from output.ebb.virtual.packet import INVALID, MISSING, TEXT

_LONGEST = 4


def checked(line: bytes) -> tuple[bytes | None, bytes, int | None]:
    """(the line without its checksum, b"", None), or (None, error text, error number that is stuck to it or None)."""
    comma = line.rfind(b",", max(0, len(line) - _LONGEST))
    if comma < 0:
        return None, b"No checksum found but required", None
    expected = -sum(line[:comma]) & 0xFF
    digits = line[comma + 1 :]
    if not digits:
        return None, b"Checksum incorrect, expected %d" % expected, MISSING
    number = 0
    for byte in digits:
        if not 0x30 <= byte <= 0x39:
            break
        number = number * 10 + byte - 0x30
    if number > 0xFF or digits[:1] == b"-":
        return None, b"Checksum incorrect, expected %d" % expected, INVALID
    if number != expected:
        return None, b"Checksum incorrect, expected %d" % expected, None
    return line[:comma], b"", None


def report(text: bytes, stuck: int | None, *, one_error: bool, line_end: bytes) -> bytes:
    """The error as it goes out: numbers 9 and 10 in 3.0.3, one text for both before it. The line end closes it."""
    if one_error:
        number = b"!10" if text.startswith(b"No") else b"!9"
        # The second error is printed straight after the first, with the separator of its own syntax.
        separator = b"," if line_end == b"\n" else b""
        return number + b" Err: " + text + (b"" if stuck is None else separator + TEXT[stuck]) + line_end
    return b"!8 Err: " + text + line_end + (b"" if stuck is None else TEXT[stuck] + line_end)
