"""The board's conversation without a port: commands in, bytes out; bytes in, events out.

Replies are owned by position: the board answers commands strictly in the order it parsed them, so the oldest unanswered command
owns the next line. A line that its owner cannot have produced is not guessed at: it comes out as `Stray`, and the caller stops
the plot and resynchronises. That is how a lost, doubled or delayed reply is found before it is credited to another command.

Two syntaxes (docs/streaming.md): legacy, "OK" after most commands with half a dozen irregular queries, and future syntax
(firmware 3, `CU,10,1`), one line a command that begins with the command's own name.
"""

from __future__ import annotations

import re
from collections import deque
from dataclasses import dataclass
from enum import Enum

# The longest legal reply is a version line of about 50 characters; past this, a line is noise and is thrown away as it comes.
MAX_LINE_BYTES = 256
# The board's command buffer has 8-bit indices: a 256th character before the CR would silently corrupt the line.
MAX_COMMAND_CHARS = 255


class Syntax(Enum):
    LEGACY = "legacy"
    FUTURE = "future"


class Form(Enum):
    """What a legacy reply is made of."""

    OK = "OK alone"
    LINE = "one line, no OK"
    LINE_OK = "one line, then OK"
    NONE = "nothing"


_FORMS = {name: Form.LINE for name in ("V", "QG", "QM", "A", "I", "MR", "PI")}
_FORMS |= {name: Form.LINE_OK for name in ("QS", "QE", "QP", "QR", "ES", "QB", "QN", "QL", "QC", "QT", "QU")}
_FORMS |= {name: Form.NONE for name in ("RB", "BL")}

# What the data of a query may look like; numbers have at most the digits of their range.
_DATA = {
    "V": re.compile(r"[ -~]*Firmware Version [ -~]*"),
    "QG": re.compile(r"[0-9A-Fa-f]{2}"),
    "QM": re.compile(r"[01],[01],[01](,[01])?"),
    "QS": re.compile(r"-?\d{1,10},-?\d{1,10}"),
    "QE": re.compile(r"\d{1,2},\d{1,2}"),
    "QP": re.compile(r"[01]"),
    "QR": re.compile(r"[01]"),
    "QB": re.compile(r"[01]"),
    "QL": re.compile(r"[01]?\d{1,2}|2[0-4]\d|25[0-5]"),
    "QN": re.compile(r"\d{1,10}"),
    "QC": re.compile(r"\d{1,4},\d{1,4}"),
    "QT": re.compile(r"[ -~]{0,16}"),
    "QU": re.compile(r"\d{1,10}(,\d{1,10}){0,2}"),
    "ES": re.compile(r"[01](,-?\d{1,10}){0,4}"),
}
# Pins and stack addresses, which are hexadecimal; 3.0.0 and 3.0.1 repeat the parameter.
_DATA |= {f"QU,{n}": re.compile(rf"({n},)?[0-9A-Fa-f]{{1,8}}") for n in (1, 4, 5)}
_ANY_DATA = re.compile(r"[ -~]*")
_ERROR = re.compile(r"!\d{1,2} Err: ")
_SHORT_ERROR = re.compile(r"!\d{1,2} Err\b")
_NAMED_ERROR = re.compile(r"[A-Z0-9]{1,2},{1,2}!\d{1,2} Err\b")
_LIMIT = "Limit switch triggered"
_BANNER = re.compile(r"^EBB.*Firmware Version")


@dataclass(frozen=True, slots=True)
class Reply:
    """Command `number` was answered. `data` is what follows the name, "" for a plain acknowledgement."""

    number: int
    name: str
    data: str


@dataclass(frozen=True, slots=True)
class Refusal:
    """The board reported an error. `number` is the command it most likely means: the oldest unanswered one or, for an error
    printed after an acknowledgement, the one before; -1 when nothing was ever sent."""

    number: int
    name: str
    text: str


@dataclass(frozen=True, slots=True)
class Notice:
    """A line that the board sends by itself: a limit switch, or the version line it prints when it starts."""

    text: str


@dataclass(frozen=True, slots=True)
class Stray:
    """A line that nobody owns. `expected` names the command whose reply was due, "" when none was."""

    text: str
    expected: str


@dataclass(frozen=True, slots=True)
class Resynced:
    """The token of `resync` came back: nothing older is in the line, and `syntax` is what the board speaks."""

    syntax: Syntax
    skipped: int


Event = Reply | Refusal | Notice | Stray | Resynced


@dataclass(slots=True)
class _Pending:
    number: int
    name: str
    form: Form
    may_be: re.Pattern[str]
    data: str | None = None


class Protocol:
    """One conversation. `send` returns what to write; `receive` returns what happened. No clock, no port, no thread.

    Memory is bounded by the commands the caller leaves unanswered and by one line.
    """

    def __init__(self, syntax: Syntax = Syntax.LEGACY) -> None:
        self.syntax = syntax
        self._pending: deque[_Pending] = deque()
        self._line = bytearray()
        self._overlong = False
        self._count = 0
        self._last = (-1, "")
        self._token: int | None = None
        self._token_seen = False
        self._skipped = 0

    @property
    def pending(self) -> int:
        """How many commands are sent and not answered."""
        return len(self._pending)

    def send(self, wire: str) -> tuple[int, bytes]:
        """The command's number in this conversation and the bytes to write for it.

        Raises ValueError for text that the board's line buffer cannot take; typed commands never produce it.
        """
        if not wire or len(wire) > MAX_COMMAND_CHARS or not all(" " <= character <= "~" for character in wire):
            raise ValueError(f"not one printable line of 1 to {MAX_COMMAND_CHARS} characters: {wire[:60]!r}")
        name = wire.split(",", 1)[0].upper()
        number = self._count
        self._count += 1
        form = _FORMS.get(name, Form.OK)
        if form is not Form.NONE:
            may_be = _DATA.get(wire.upper(), _DATA.get(name, _ANY_DATA))
            self._pending.append(_Pending(number, name, form, may_be))
        return number, wire.encode("ascii") + b"\r"

    def resync(self, token: int) -> bytes:
        """Bytes that set the node counter to `token` and read it back; every line before the token's return is skipped.

        The first CR ends a line that may have been left half written. Commands that were pending lose their owner here: the
        caller has given them up. The node counter (SN, QN) is used because every firmware to 3.0.3 has it, it holds 32 bits, so
        that a fresh token cannot be met by accident, and nothing else in a plot uses it.
        """
        if not 1 <= token <= 0xFFFFFFFF:
            raise ValueError(f"a token has 1 to 32 bits, not {token}")
        self._pending.clear()
        self._token, self._token_seen, self._skipped = token, False, 0
        return f"\rSN,{token}\rQN\r".encode("ascii")

    def receive(self, data: bytes) -> list[Event]:
        """The events that `data` completes. How the bytes are split between calls makes no difference."""
        events: list[Event] = []
        for byte in data:
            if byte in b"\r\n":
                if self._line or self._overlong:
                    events.extend(self._take_line())
            elif len(self._line) < MAX_LINE_BYTES:
                self._line.append(byte)
            else:
                self._overlong = True
        return events

    def _take_line(self) -> list[Event]:
        raw, overlong = bytes(self._line), self._overlong
        self._line.clear()
        self._overlong = False
        text = raw.decode("ascii", "backslashreplace")
        if self._token is not None:
            return self._skip_to_token(text)
        if overlong or not all(0x20 <= byte <= 0x7E for byte in raw):
            return [self._stray(text)]
        if text.startswith(_LIMIT):
            return [Notice(text)]
        event = self._future_line(text) if self.syntax is Syntax.FUTURE else self._legacy_line(text)
        return [] if event is None else [event]

    def _skip_to_token(self, text: str) -> list[Event]:
        """Future syntax answers "QN,t"; legacy "t" and then "OK". Either tells which syntax the board is in."""
        if self._token_seen and text == "OK":
            return self._synced(Syntax.LEGACY)
        self._token_seen = text.isascii() and text.isdigit() and len(text) <= 10 and int(text) == self._token
        if text == f"QN,{self._token}":
            return self._synced(Syntax.FUTURE)
        self._skipped += 1
        return []

    def _synced(self, syntax: Syntax) -> list[Event]:
        self.syntax, self._token = syntax, None
        return [Resynced(syntax, self._skipped)]

    def _future_line(self, text: str) -> Event:
        head = self._pending[0] if self._pending else None
        if _SHORT_ERROR.match(text.lstrip(",")):
            # ",!4 Err" follows an acknowledgement that was already sent; so does a bare "!7 Err" before 3.0.3, save for a
            # command it did not know, whose name it does not echo.
            late = text.startswith(",") or (not text.startswith("!8") and self._last[0] >= 0)
            return self._refusal(None if late else head, text.lstrip(","))
        if head is None:
            if _BANNER.match(text):
                return Notice(text)
            return self._refusal(None, text[text.index("!") :]) if _NAMED_ERROR.match(text) else self._stray(text)
        if text == head.name:
            return self._answered("") if head.name not in _DATA or head.name == "QT" else self._stray(text)
        if text.startswith(head.name):
            rest = text[len(head.name) :].lstrip(",")
            if _ERROR.match(rest):
                return self._refusal(head, rest)
            if text[len(head.name)] == "," and head.may_be.fullmatch(text[len(head.name) + 1 :]):
                return self._answered(text[len(head.name) + 1 :]) if head.name in _FORMS else self._stray(text)
        if _NAMED_ERROR.match(text):
            return self._refusal(None, text[text.index("!") :])
        return Notice(text) if _BANNER.match(text) else self._stray(text)

    def _legacy_line(self, text: str) -> Event | None:
        head = self._pending[0] if self._pending else None
        if _SHORT_ERROR.match(text) or _NAMED_ERROR.match(text):
            return self._refusal(head, text[text.index("!") :])
        if head is None:
            return Notice(text) if _BANNER.match(text) else self._stray(text)
        if text == "OK":
            # A board without a nickname answers QT with an empty line, which is no line at all here.
            if head.form is Form.OK or head.data is not None or head.name == "QT":
                return self._answered(head.data or "")
            return self._stray(text)
        if head.form is Form.OK or head.data is not None:
            return Notice(text) if _BANNER.match(text) else self._stray(text)
        data = text.removeprefix(f"{head.name},") if head.name not in ("V", "QT") else text
        if not head.may_be.fullmatch(data):
            return self._stray(text)
        if head.form is Form.LINE:
            return self._answered(data)
        head.data = data
        return None

    def _answered(self, data: str) -> Reply:
        head = self._pending.popleft()
        self._last = (head.number, head.name)
        return Reply(head.number, head.name, data)

    def _refusal(self, owner: _Pending | None, text: str) -> Refusal:
        if owner is None:
            return Refusal(*self._last, text)
        self._pending.popleft()
        self._last = (owner.number, owner.name)
        return Refusal(owner.number, owner.name, text)

    def _stray(self, text: str) -> Stray:
        return Stray(text[:MAX_LINE_BYTES], self._pending[0].name if self._pending else "")
