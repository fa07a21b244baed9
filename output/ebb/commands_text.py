"""A line of text to a command: the closed set by name, the board's number syntax, the checksum form."""

from __future__ import annotations

import re
from dataclasses import MISSING, fields
from itertools import zip_longest

from output.ebb import commands, commands_pins
from output.ebb.commands import Command
from output.errors import BadCommand
from output.wording import counted


def _kinds() -> dict[str, type[Command]]:
    values = [*vars(commands).values(), *vars(commands_pins).values()]
    found = [v for v in values if isinstance(v, type) and issubclass(v, Command)]
    return {kind.name: kind for kind in found if kind.name and kind is not commands_pins.OldS2}


# Every command by its name; S2 is that of 2.2.0 and newer.
KINDS: dict[str, type[Command]] = _kinds()

_NUMBER = re.compile(r"-?\d{1,10}$")
_TEXT_FIELDS = {"port", "character", "upper", "tag"}


def parse_command(line: str) -> Command:
    """The command that `line` (without its line ending) says. Names are case-insensitive, as for the board.

    Raises BadCommand: an unknown name, a parameter that is no number, too many, too few, or one out of its range.
    """
    name, *words = line.strip().split(",")
    kind = KINDS.get(name.upper())
    if kind is None:
        raise BadCommand(f"{name!r} is not a command of the EBB; see docs/ebb-protocol.md for those that are")
    known = fields(kind)
    required = sum(field.default is MISSING for field in known)
    if len(words) > len(known):
        given = counted(len(words), "parameter")
        raise BadCommand(f"{kind.name} has {given}, at most {len(known)} are allowed; leave the others out")
    if len(words) < required:
        raise BadCommand(f"{kind.name} has {counted(len(words), 'parameter')}, {required} are needed ({_signature(kind)})")
    values: list[int | str] = []
    for field, word in zip(known, words, strict=False):
        if field.name in _TEXT_FIELDS:
            values.append(word.upper() if field.name in ("port", "upper") else word)
        elif _NUMBER.match(word):
            values.append(int(word))
        elif re.fullmatch(r"-?\d+", word, re.ASCII):
            raise BadCommand(_too_long(kind, field.name, word))
        else:
            raise BadCommand(f"{kind.name}: {field.name} is {word!r}, allowed is a whole number; write it in digits")
    return kind(*values)


def _too_long(kind: type[Command], parameter: str, word: str) -> str:
    """What is said of a number of more than ten digits, which no parameter has: by its bounds, or by its zeros in front."""
    said = f"{kind.name}: {parameter} is {word if len(word) <= 24 else word[:20] + '...'}"
    bounds = dict(zip(commands.parameter_names(kind), kind.bounds, strict=False))
    if len(word.lstrip("-0")) > 10 and parameter in bounds:
        low, high = bounds[parameter]
        return f"{said}, allowed is {low} to {high}; change the value"
    return f"{said}, allowed is a number of up to 10 digits; write it shorter"


def _signature(kind: type[Command]) -> str:
    words = [f.name if f.default is MISSING else f"[{f.name}]" for f in fields(kind)]
    return ",".join([kind.name, *words])


def checksum(wire: str) -> int:
    """The number that `CU,54,1` wants after a last comma: minus the sum of the bytes as sent, modulo 256."""
    return -sum(wire.encode("ascii")) & 255


def with_checksum(wire: str) -> str:
    """The command as it is sent while checksums are on."""
    return f"{wire},{checksum(wire)}"


def without_checksum(line: str) -> str:
    """The command of a line as it is sent while checksums are on. Raises BadCommand when the checksum is missing or wrong."""
    text = line.strip()
    wire, _, last = text.rpartition(",")
    if not wire or not last.isdecimal() or not text.isascii():
        raise BadCommand(
            f"{text!r} has no checksum, which CU,54,1 asks for; end it with ,{checksum(text) if text.isascii() else 0}"
        )
    if int(last) != checksum(wire):
        raise BadCommand(f"checksum of {wire} is {last}, right is {checksum(wire)}; write it again, or leave CU,54,1 out")
    return wire


def parse_as_sent(line: str) -> Command:
    """As `parse_command`, but SM and XM of more than 50 kHz are let through: firmware 3 takes them and steps at 25 kHz.

    For replaying what somebody else has sent; nothing here builds such a command. Raises BadCommand for anything else.
    """
    try:
        return parse_command(line)
    except BadCommand:
        name, *words = line.strip().split(",")
        kind = KINDS.get(name.upper())
        if kind not in (commands.SM, commands.XM) or not all(_NUMBER.match(word) for word in words) or not 2 <= len(words) <= 4:
            raise
        values = [int(word) for word in words]
        unchecked = object.__new__(kind)
        for parameter, value in zip_longest(commands.parameter_names(kind), values):
            object.__setattr__(unchecked, parameter, value)
        if not 0 < values[0] <= commands.U32[1] or (len(values) == 4 and not 0 <= values[3] <= 3):
            raise
        return unchecked
