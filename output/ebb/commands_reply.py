"""What a board answers to each command, in legacy and in future syntax, and its error forms, as values.

The syntaxes differ in line endings and echoes, and the versions of 3.0 in how errors look and whether they stack; all of that
is undone here. Replies may come in pieces of any size: `protocol` finds where one ends, this says what it means.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import Enum

from output.ebb.commands import Command, Version
from output.errors import BoardRefused

Value = int | str


class Form(Enum):
    """What is sent back in legacy syntax. In future syntax it is always the command's name, then the data, then one `\\n`."""

    OK = "OK"
    DATA_OK = "data, then OK"
    DATA = "data without OK"
    NOTHING = "nothing"


FORMS: dict[str, Form] = {
    **dict.fromkeys(("QB", "QC", "QE", "QL", "QN", "QP", "QR", "QS", "QT", "QU", "ES", "CK"), Form.DATA_OK),
    **dict.fromkeys(("A", "I", "MR", "PI", "QG", "QM", "V"), Form.DATA),
    **dict.fromkeys(("BL", "RB"), Form.NOTHING),
}


def reply_form(command: Command) -> Form:
    """The form of a command's reply in legacy syntax."""
    return FORMS.get(command.name, Form.OK)


@dataclass(frozen=True, slots=True)
class BoardError:
    """`!code Err: text`: 0 step rate, 1 invalid rate, 2 and 3 overrun, 4 missing, 5 comma, 6 value, 7 extra, 8 unknown command,
    9 wrong checksum, 10 no checksum. 3.0.0 to 3.0.2 have other texts and say checksum errors as 8."""

    code: int
    text: str

    @property
    def executed(self) -> bool:
        """Whether 3.0.3 has executed the command all the same: extra parameters are only complained about."""
        return self.code == 7

    @property
    def expected_checksum(self) -> int | None:
        """The checksum that the board would have taken, when this is about one."""
        match = re.search(r"Checksum incorrect, expected (\d+)", self.text)
        return int(match[1]) if match else None


@dataclass(frozen=True, slots=True)
class Reply:
    """`values` are the command's data as numbers (text for V and QT; `channel:value` pairs flattened for A).

    `acknowledged` is False when nothing came that says that the command was taken; `limit` is port B when a limit switch was
    reported with it.
    """

    name: str
    values: tuple[Value, ...] = ()
    errors: tuple[BoardError, ...] = ()
    acknowledged: bool = True
    limit: int | None = None

    @property
    def ok(self) -> bool:
        return not self.errors

    def raise_for_errors(self) -> Reply:
        """Itself, or BoardRefused with the first error."""
        if self.errors:
            raise BoardRefused(f"the board answered {self.name} with !{self.errors[0].code} {self.errors[0].text}")
        return self


@dataclass(frozen=True, slots=True)
class Status:
    """QG's byte. `motor1` and `motor2` tell of steps still to be taken; T3, LT and TD show as motor 1 alone."""

    queue_not_empty: bool
    motor2: bool
    motor1: bool
    executing: bool
    pen_up: bool
    button: bool
    power_lost: bool
    limit: bool

    @classmethod
    def of(cls, byte: int) -> Status:
        return cls(*(bool(byte >> bit & 1) for bit in range(8)))


_ERROR = re.compile(r"!(\d{1,2}) (Err: .*?)(?=,?!\d{1,2} Err: |$)")
_LIMIT = re.compile(r"Limit switch triggered\. PortB=([0-9A-F]{2})")
_VERSION = re.compile(r"Firmware Version (\d+)\.(\d+)(?:\.(\d+))?")
_HEX_UTILITIES = {"1", "4", "5"}
_PREFIXED = {"A", "I", "MR", "PI", "QM", "QU"}


def parse_reply(sent: Command | str, data: bytes, future: bool) -> Reply:
    """What `data`, all that came back for one command, says. `sent` is the command or the text that was sent for it.

    Raises BoardRefused for data that is no reply to it.
    """
    wire = (sent.wire() if isinstance(sent, Command) else sent).strip("\r\n\t ")
    name = wire.split(",")[0].upper()
    name = name[-1:] if "\b" in name else name[:2]
    text = data.decode("latin-1").replace(" \b", "")
    values: tuple[Value, ...] = ()
    errors: list[BoardError] = []
    acknowledged = bool(data)
    limit = None
    for line in re.split(r"[\r\n]+", text):
        if match := _LIMIT.search(line):
            limit = int(match[1], 16)
            continue
        found = _ERROR.findall(line)
        if found:
            errors += [BoardError(int(code), said) for code, said in found]
            continue
        rest = _without_echo(line, name, future)
        if rest:
            values += _values(name, wire, rest)
    if errors and not values and not _says_ok(text, name):
        acknowledged = False
    return Reply(name, values, tuple(errors), acknowledged, limit)


def parse_version(reply: Reply) -> Version:
    """The version that a reply to V tells. Raises BoardRefused when it is no EBB's."""
    match = _VERSION.search(str(reply.values[0])) if reply.values else None
    if match is None:
        raise BoardRefused(f"the board answered V with {reply.values!r}, which is no EBB's version; choose another port")
    return (int(match[1]), int(match[2]), int(match[3] or 0))


def _says_ok(text: str, name: str) -> bool:
    return re.search(r"OK\r?\n?", text) is not None or re.search(rf"(^|\n){re.escape(name)}\n", text) is not None


def _without_echo(line: str, name: str, future: bool) -> str:
    if line in ("", "OK", "CUOK", name, f"{name},", f"{name}OK"):
        return ""
    if (future or name in _PREFIXED) and line.upper().startswith(f"{name},"):
        return line[len(name) + 1 :]
    return line


def _values(name: str, wire: str, text: str) -> tuple[Value, ...]:
    if name in ("V", "QT"):
        return (text,)
    if name == "CK":
        key, _, value = text.partition("=")
        return (value if key in ("Param7", "Param8") else int(value),)
    if name not in FORMS:
        raise BoardRefused(f"the board answered {name} with {text!r}, where nothing but an acknowledgement is expected")
    words = re.split(r"[,:]", text)
    parameter = wire.split(",")[1] if "," in wire else ""
    if name == "QU" and len(words) > 1 and words[0] == parameter and parameter != "200":
        words = words[1:]  # 3.0.0 and 3.0.1 echo the parameter's number.
    base = 16 if name == "QG" or (name == "QU" and parameter in _HEX_UTILITIES) else 10
    try:
        return tuple(int(word, base) for word in words)
    except ValueError:
        raise BoardRefused(f"the board answered {name} with {text!r}, which is not what {name} answers") from None
