"""The command file: text, one board command a line exactly as sent; comments start with `#`.

    # plotter command file
    # machine: axidraw-v3              header: `key: value`, before the first command
    SC,4,16000
    # layer 1 outlines                 marks
    # stroke 12
    SP,0,120
    T3,250,...
    # end 12 steps 800 -40             the stroke is drawn; both motors' steps there
    # pause change to red              wait, pen up, for the operator
    # slowed 0.125 s, up to 1.5 times  the motion that follows is slower, for the queue

Other comments and empty lines are skipped, so that a file from any program, or without any comment, can be read. The same
program gives the same bytes: nothing here looks at a clock.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from io import StringIO
from itertools import chain
from pathlib import Path
from typing import IO, NamedTuple, TextIO

from output.ebb.commands import CU, Command
from output.ebb.commands_text import parse_as_sent, parse_command, without_checksum
from output.ebb.program import ApproachMark, DipMark, LayerMark, Mark, PauseMark, Slowed, StrokeEnd, StrokeMark
from output.errors import BadCommand

TITLE = "plotter command file"

_KEY = re.compile(r"#\s*([A-Za-z][\w .-]*?)\s*:\s*(.*)$")
_LAYER = re.compile(r"#\s*layer (\d+)(?: (.*))?$")
_STROKE = re.compile(r"#\s*stroke (-?\d+)$")
_END = re.compile(r"#\s*end (-?\d+) steps (-?\d+) (-?\d+)$")
_PAUSE = re.compile(r"#\s*pause(?: (.*))?$")
_SLOWED = re.compile(r"#\s*slowed (\d+\.\d+) s, up to (\d+\.\d+) times$")
_WORDS: dict[str, Mark] = {"# approach": ApproachMark(), "# dip": DipMark()}
_LONGEST_LINE = 4096
# What bytes that are no UTF-8 become when they are read.
_NO_TEXT = re.compile("[\udc80-\udcff]")


class Line(NamedTuple):
    """One command or mark and the number of its line, from 1."""

    number: int
    item: Command | Mark


def write_command_file(target: str | Path | TextIO, header: Mapping[str, object], program: Iterable[Command | Mark]) -> int:
    """Write the program below its header, in order; returns the number of commands. Streams: the program is not kept."""
    with _opened(target, "w") as file:
        file.write(f"# {TITLE}\n")
        for key, value in header.items():
            file.write(f"# {key}: {_one_line(value)}\n")
        count = 0
        for item in program:
            if isinstance(item, Command):
                file.write(item.wire() + "\n")
                count += 1
            else:
                file.write(mark_line(item) + "\n")
        return count


def mark_line(mark: Mark) -> str:
    """The comment that stands for a mark."""
    match mark:
        case LayerMark(number=number, name=name):
            return f"# layer {number} {_one_line(name)}".rstrip()
        case ApproachMark():
            return "# approach"
        case DipMark():
            return "# dip"
        case StrokeMark(index=index):
            return f"# stroke {index}"
        case StrokeEnd(index=index, steps=steps):
            return f"# end {index} steps {steps[0]} {steps[1]}"
        case PauseMark(message=message):
            return f"# pause {_one_line(message)}".rstrip()
        case Slowed(lost_s=lost_s, most=most):
            return f"# slowed {lost_s:.5f} s, up to {most:.4f} times"


def read_command_file(source: str | Path | TextIO, problems: list[str] | None = None) -> tuple[dict[str, str], Iterator[Line]]:
    """The header, and the commands and marks with their line numbers, read as they are asked for.

    A line that is neither raises BadCommand with its number, or, when `problems` is given, is said there and skipped (but
    read all the same where a board would take it).
    Raises BadCommand for what is not text, OSError for what cannot be opened.
    """
    lines = _numbered(source)
    header: dict[str, str] = {}
    first: list[tuple[int, str]] = []
    for number, text in lines:
        if text and not text.startswith("#"):
            first = [(number, text)]
            break
        if _mark(text) is not None:
            first = [(number, text)]
            break
        if key := _KEY.match(text):
            header[key[1]] = key[2].strip()
    return header, _parsed(chain(first, lines), problems)


def _parsed(lines: Iterable[tuple[int, str]], problems: list[str] | None) -> Iterator[Line]:
    # Whether the lines end in checksums, as a board wants them from CU,54,1 on.
    checked = False
    for number, text in lines:
        if not text:
            continue
        if text.startswith("#"):
            if (mark := _mark(text)) is not None:
                yield Line(number, mark)
            continue
        try:
            text = without_checksum(text) if checked else text
            command = parse_command(text)
        except BadCommand as error:
            if problems is None:
                raise BadCommand(f"line {number}: {error}") from None
            problems.append(f"line {number}: {error}")
            # Some of what nobody should send, boards do take: show what they would make of it.
            with suppress(BadCommand):
                yield Line(number, parse_as_sent(text))
            continue
        if isinstance(command, CU) and command.number == 54:
            checked = command.value == 1
        yield Line(number, command)


def _mark(text: str) -> Mark | None:
    if text in _WORDS:
        return _WORDS[text]
    if match := _STROKE.match(text):
        return StrokeMark(int(match[1]))
    if match := _END.match(text):
        return StrokeEnd(int(match[1]), (int(match[2]), int(match[3])))
    if match := _LAYER.match(text):
        return LayerMark(int(match[1]), match[2] or "")
    if match := _PAUSE.match(text):
        return PauseMark(match[1] or "")
    if match := _SLOWED.match(text):
        return Slowed(float(match[1]), float(match[2]))
    return None


def _numbered(source: str | Path | TextIO) -> Iterator[tuple[int, str]]:
    with _opened(source, "r") as file:
        number = 0
        while line := file.readline(_LONGEST_LINE):
            number += 1
            if len(line) >= _LONGEST_LINE:
                raise BadCommand(f"line {number} is longer than {_LONGEST_LINE} characters; this is not a command file")
            if "\0" in line:
                raise BadCommand(f"line {number} has a zero byte; this is not a command file")
            if not line.isascii() and _NO_TEXT.search(line):
                raise BadCommand(f"line {number} is not text (UTF-8); this is not a command file")
            yield number, line.strip().removeprefix("\ufeff")


@contextmanager
def _opened(target: str | Path | TextIO, mode: str) -> Iterator[IO[str]]:
    """The stream itself, or the file at a path, closed afterwards."""
    if isinstance(target, str | Path):
        newline = "\n" if mode == "w" else None
        # Read in pieces of many lines: what is no text must not be told before its line comes.
        errors = "surrogateescape" if mode == "r" else "strict"
        with Path(target).open(mode, encoding="utf-8", errors=errors, newline=newline) as file:
            yield file
    else:
        yield target


def _one_line(value: object) -> str:
    return " ".join(str(value).split())


def command_text(header: Mapping[str, object], program: Iterable[Command | Mark]) -> str:
    """The whole command file as text: the same for the same program, for golden files."""
    text = StringIO()
    write_command_file(text, header, program)
    return text.getvalue()
