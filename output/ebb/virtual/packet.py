"""One command line being handled: its parameters are taken off in order, its reply and its errors are put together.

The forms differ by syntax (legacy, or future after CU,10,1) and by firmware: 3.0.3 reports one error a command and gives up
at it; earlier versions go on and stack what they find.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from output.ebb.virtual.firmware import Firmware

_NUMBER = re.compile(rb"(-?)(\d{0,10})")

MISSING = 4
NEED_COMMA = 5
INVALID = 6
EXTRA = 7

TEXT = {
    MISSING: b"!4 Err: Missing parameter(s)",
    INVALID: b"!6 Err: Invalid parameter value",
    EXTRA: b"!7 Err: Extra parameter",
}


@dataclass(slots=True)
class Syntax:
    """How replies are written just now."""

    future: bool = False
    ok: bool = True


@dataclass(slots=True)
class Packet:
    """The line after its command name, and the reply so far.

    `failed` is true once an error was found. The `take_...` methods return None when the parameter is not there or not legal.
    """

    name: bytes
    line: bytes
    at: int
    firmware: Firmware
    syntax: Syntax
    out: bytearray = field(default_factory=bytearray)
    failed: bool = False
    mute: bool = False
    _flags: set[int] = field(default_factory=set)
    _text: bytes | None = None
    _ending_only: bool = False

    @property
    def gives_up(self) -> bool:
        """An error was found and this firmware does nothing more about the command."""
        return self.failed and self.firmware.one_error

    def has_failed(self) -> bool:
        """`failed`, asked again after more parameters were taken."""
        return self.failed

    # ---- parameters

    def take_number(self, low: int, high: int, *, optional: bool = False) -> int | None:
        """The next parameter as an integer in low..high (low < 0: a minus sign is taken). Ten digits are read, modulo 2^32."""
        if not self._take_comma(optional):
            return None
        match = _NUMBER.match(self.line, self.at)
        assert match is not None
        if match[1] and low >= 0:
            self.error(INVALID)
            return None
        self.at = match.end()
        value = int(match[2] or b"0") & 0xFFFFFFFF
        if match[1]:
            value = -value
        if not low <= value <= high:
            self.error(INVALID)
            return None
        return value

    def _take_comma(self, optional: bool) -> bool:
        if self.gives_up:
            return False
        if self.at >= len(self.line):
            if not optional:
                self.error(MISSING)
            return False
        if self.line[self.at] != 0x2C:
            if not optional:
                self.error(NEED_COMMA)
            return False
        if self.at + 1 >= len(self.line):
            self.at += 1
            if not optional:
                self.error(MISSING)
            return False
        self.at += 1
        return True

    def take_character(self, *, upper: bool = True) -> int | None:
        """The next parameter as one character."""
        if not self._take_comma(False):
            return None
        byte = self.line[self.at]
        self.at += 1
        return byte - 32 if upper and 97 <= byte <= 122 else byte

    def take_text(self, limit: int) -> bytes | None:
        """The next parameter as up to `limit` characters, up to a comma; nothing after the comma is an empty text."""
        if self.at + 1 == len(self.line) and self.line[self.at] == 0x2C:
            self.at += 1
            return b""
        if not self._take_comma(False):
            return None
        end = self.line.find(b",", self.at)
        end = min(len(self.line) if end < 0 else end, self.at + limit)
        text = self.line[self.at : end]
        self.at = end
        return text

    def u8(self, *, optional: bool = False) -> int | None:
        return self.take_number(0, 0xFF, optional=optional)

    def u16(self, *, optional: bool = False) -> int | None:
        return self.take_number(0, 0xFFFF, optional=optional)

    def u32(self, *, optional: bool = False) -> int | None:
        return self.take_number(0, 0xFFFFFFFF, optional=optional)

    def i16(self, *, optional: bool = False) -> int | None:
        return self.take_number(-0x8000, 0x7FFF, optional=optional)

    def i32(self, *, optional: bool = False) -> int | None:
        return self.take_number(-0x80000000, 0x7FFFFFFF, optional=optional)

    # ---- the reply

    def echo(self) -> None:
        """What goes out before a command is handled: its name, in future syntax."""
        if self.syntax.future:
            self.out += self.name

    def ok(self) -> None:
        """The end of a plain reply; `mute` is set where the board forgets it."""
        if self.mute:
            return
        if self.syntax.future:
            self.out += b"\n"
        else:
            self.out += b"OK\r\n" if self.syntax.ok else b"\r\n"

    def data(self, text: bytes, legacy_end: bytes = b"\r\n", *, ok: bool = True) -> None:
        """A reply that carries data: `legacy_end` follows it in legacy syntax, then OK unless `ok` is false."""
        if self.syntax.future:
            self.out += b"," + text + b"\n"
            return
        self.out += text + legacy_end
        if ok:
            self.ok()

    # ---- errors

    def error(self, number: int) -> None:
        """Note error 4, 5, 6 or 7."""
        if number == NEED_COMMA:
            self.say(b"!5 Err: Need comma next, found: '" + self.line[self.at : self.at + 1] + b"'")
            return
        if self.firmware.one_error:
            if not self.failed:
                self._text = TEXT[number]
        else:
            self._flags.add(number)
        self.failed = True

    def say(self, text: bytes) -> None:
        """An error whose text depends on the line. Before 3.0.3 it goes out at once, the numbered ones at the end."""
        if self.firmware.one_error:
            if not self.failed:
                self._text = text
        else:
            self.out += text + self._line_end
        self.failed = True

    def inline_error(self, text: bytes) -> None:
        """The step rate errors: printed where they are found, with an ending of their own before the reply's."""
        self.out += (b"," if self.syntax.future and self.firmware.one_error else b"") + text
        self.out += b"\n" if self.syntax.future else b"\n\r"
        if self.firmware.one_error:
            self._ending_only = True
        self.failed = True

    @property
    def _line_end(self) -> bytes:
        return b"\n" if self.syntax.future else b"\r\n"

    def finish(self) -> bytes:
        """The whole reply, errors last."""
        if not self.failed and self.at < len(self.line):
            self.echo_for_late_error()
            self.error(EXTRA)
        if self._ending_only:
            self.out += self._line_end
        elif self._text is not None:
            self.out += (b"," if self.syntax.future else b"") + self._text + self._line_end
        for number in sorted(self._flags):
            self.out += TEXT[number] + self._line_end
        return bytes(self.out)

    def echo_for_late_error(self) -> None:
        """3.0.3 repeats the command's name before an error that is found outside of its handler."""
        if self.firmware.one_error:
            self.echo()
