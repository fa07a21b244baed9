"""Path data to commands and numbers, many paths at once (SVG 2, 9.3).

The fast way looks at all characters as one byte array and converts all numbers in one call. It only takes what it can show to
be right; every path with something unusual (packed arc flags, errors) is first rewritten by `repair`, a plain reading of the
grammar, up to its first error, as the standard says.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_PIECE_BYTES = 2_000_000

_SPACE, _COMMA, _DIGIT, _DOT, _SIGN, _EXPONENT, _COMMAND, _END, _BAD = range(9)


def _classes() -> NDArray[np.uint8]:
    table = np.full(256, _BAD, np.uint8)
    for characters, kind in (
        (b" \t\r\n\f", _SPACE),
        (b",", _COMMA),
        (b"0123456789", _DIGIT),
        (b".", _DOT),
        (b"+-", _SIGN),
        (b"eE", _EXPONENT),
        (b"MmLlHhVvCcSsQqTtAaZz", _COMMAND),
        (b"\0", _END),
    ):
        table[list(characters)] = kind
    return table


_CLASS = _classes()
ARITY = np.zeros(256, np.int64)
for _letter, _count in {"M": 2, "L": 2, "H": 1, "V": 1, "C": 6, "S": 4, "Q": 4, "T": 2, "A": 7, "Z": 0}.items():
    ARITY[[ord(_letter), ord(_letter.lower())]] = _count

M, LOWER_M, L, LOWER_L, Z = (ord(letter) for letter in "MmLlZ")
UPPER = 0xDF
LOWER = 0x20


@dataclass(frozen=True, eq=False, slots=True)
class Commands:
    """Commands of many paths, one after the other.

    `code` (n,) ASCII letters, implicit repeats written out, every subpath beginning with M or m; `first` (n,) index of the
    command's first argument in `numbers`; `path` (n,) which path, not decreasing.
    """

    code: NDArray[np.uint8]
    first: NDArray[np.int64]
    path: NDArray[np.int64]
    numbers: NDArray[np.float64]


def parse_paths(texts: Sequence[str]) -> tuple[Commands, dict[int, str]]:
    """Commands of all `texts`, and for each damaged path (by index) what was found where. Numbers may be infinite."""
    damage: dict[int, str] = {}
    tokens, odd = _tokenise(texts)
    if len(odd):
        clean = list(texts)
        for i in odd.tolist():
            clean[i], error = repair(texts[i])
            if error:
                damage[i] = error
        tokens, odd = _tokenise(clean)
        if len(odd):
            raise AssertionError(f"repaired path data is still odd: {clean[odd[0]][:80]!r}")
    return _expand(tokens), damage


@dataclass(frozen=True, eq=False, slots=True)
class _Tokens:
    letter: NDArray[np.uint8]
    first: NDArray[np.int64]
    count: NDArray[np.int64]
    path: NDArray[np.int64]
    numbers: NDArray[np.float64]


def _tokenise(texts: Sequence[str]) -> tuple[_Tokens, NDArray[np.int64]]:
    """Tokens, and the indices of the paths that must be repaired first (the tokens are then not to be used)."""
    joined = "\0".join(texts) + "\0"
    if joined.count("\0") != len(texts):
        joined = "\0".join(text.replace("\0", "?") for text in texts) + "\0"
    arcs = "a" in joined or "A" in joined
    raw = np.frombuffer(joined.encode("latin-1", "replace"), np.uint8)
    del joined
    letters, firsts, paths, numbers, odd, flags = [], [], [], [], [], []
    ends_before, numbers_before, at, last = 0, 0, 0, _END
    while at < len(raw):
        end = _cut(raw, at)
        piece = _Piece(raw[at:end], last, ends_before, arcs=arcs)
        letters.append(piece.raw[piece.command])
        firsts.append(piece.first + numbers_before)
        paths.append(piece.path)
        odd.append(piece.odd)
        numbers.append(piece.numbers)
        if piece.flags is not None:
            flags.append(piece.flags)
        ends_before += piece.ends
        numbers_before += len(piece.numbers)
        at, last = end, piece.last
    first = np.concatenate(firsts)
    letter = np.concatenate(letters)
    count = np.diff(first, append=numbers_before)
    path = np.concatenate(paths)
    tokens = _Tokens(letter, first, count, path, np.concatenate(numbers))
    arity = ARITY[letter]
    wrong = np.where(arity == 0, count != 0, (count == 0) | (count % np.maximum(arity, 1) != 0))
    odd.append(path[wrong])
    if arcs:
        odd.append(path[_wrong_flags(tokens, np.concatenate(flags))])
    # A path's first command must be a move.
    heads = np.flatnonzero(np.diff(path, prepend=-1))
    odd.append(path[heads[(letter[heads] & UPPER) != M]])
    return tokens, np.unique(np.concatenate(odd))


def _wrong_flags(tokens: _Tokens, flags: NDArray[np.bool_]) -> NDArray[np.int64]:
    """The arc commands with a flag that is not the single character 0 or 1."""
    arcs = np.flatnonzero((tokens.letter & UPPER) == ord("A"))
    sets = tokens.count[arcs] // 7
    row = np.repeat(np.arange(len(arcs)), sets)
    first = tokens.first[arcs][row] + 7 * (np.arange(len(row)) - np.repeat(np.cumsum(sets) - sets, sets))
    return np.asarray(arcs[row[~(flags[first + 3] & flags[first + 4])]])


def _cut(raw: NDArray[np.uint8], at: int) -> int:
    """Where to end the piece that begins at `at`: before white space, a command or after an end, never inside a number."""
    target = at + _PIECE_BYTES
    while target < len(raw):
        window = _CLASS[raw[target : target + 65536]]
        found = np.flatnonzero((window == _SPACE) | (window == _COMMAND))
        if len(found):
            return target + int(found[0])
        target += 65536
    return len(raw)


class _Piece:
    """One piece of the joined text, taken apart. `last` is the class of the last character before it that is no space."""

    def __init__(self, raw: NDArray[np.uint8], last: int, ends_before: int, *, arcs: bool) -> None:
        self.raw = raw
        kind = _CLASS[raw]
        numeric = (kind >= _DIGIT) & (kind <= _EXPONENT)
        start = self._starts(kind, numeric)
        started = np.cumsum(start, dtype=np.int32)
        self.command = np.flatnonzero(kind == _COMMAND)
        self.first = started[self.command].astype(np.int64)
        end_at = np.flatnonzero(kind == _END)
        self.ends = len(end_at)
        self._end_at, self._ends_before = end_at, ends_before
        self.path = self._path_at(self.command)
        bad = [self._malformed(kind), self._misplaced(kind, last)]
        self.odd = self._path_at(np.concatenate(bad))
        self.numbers = np.zeros(int(started[-1])) if len(self.odd) else self._convert(numeric, start, int(started[-1]))
        self.flags = self._flags(numeric, start) if arcs else None
        solid = np.flatnonzero(kind != _SPACE)
        self.last = int(kind[solid[-1]]) if len(solid) else last

    def _path_at(self, index: NDArray[np.int64]) -> NDArray[np.int64]:
        return np.asarray(np.searchsorted(self._end_at, index, "left") + self._ends_before)

    @staticmethod
    def _starts(kind: NDArray[np.uint8], numeric: NDArray[np.bool_]) -> NDArray[np.bool_]:
        start = numeric.copy()
        after_exponent = np.zeros(len(kind), bool)
        after_exponent[1:] = kind[:-1] == _EXPONENT
        start[1:] &= ~numeric[:-1] | ((kind[1:] == _SIGN) & ~after_exponent[1:])
        dots = np.flatnonzero(kind == _DOT)
        if len(dots):
            # The second dot of one run begins a number (".5.5"): count the dots since the run's start.
            run = np.cumsum(start, dtype=np.int32)[dots]
            new_run = np.diff(run, prepend=-1) != 0
            start[dots[~new_run]] = True
        return start

    def _malformed(self, kind: NDArray[np.uint8]) -> NDArray[np.int64]:
        after = np.append(kind[1:], np.uint8(_END))
        before = np.append(np.uint8(_END), kind[:-1])
        bad = kind == _BAD
        bad |= (kind == _SIGN) & (after != _DIGIT) & (after != _DOT)
        bad |= (kind == _DOT) & (after != _DIGIT)
        exponent = kind == _EXPONENT
        if exponent.any():
            bad |= exponent & ((before != _DIGIT) | ((after != _DIGIT) & (after != _SIGN)))
            found = [match.start() for match in _ODD_EXPONENT.finditer(self.raw.tobytes())]
            bad[found] = True
        return np.flatnonzero(bad)

    @staticmethod
    def _misplaced(kind: NDArray[np.uint8], last: int) -> NDArray[np.int64]:
        solid = np.flatnonzero(kind != _SPACE)
        tight = kind[solid]
        before = np.append(np.uint8(last), tight[:-1])
        comma = (tight == _COMMA) & (before != _DIGIT) & (before != _DOT)
        # A number before a path's first command would be taken for an argument of the path before.
        orphan = (before == _END) & (tight >= _DIGIT) & (tight <= _EXPONENT)
        return np.asarray(solid[comma | orphan])

    def _flags(self, numeric: NDArray[np.bool_], start: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Which numbers are written as the single character 0 or 1, as an arc's flags must be."""
        head = np.flatnonzero(start)
        tail = np.flatnonzero(numeric & np.append(~numeric[1:] | start[1:], True))
        return np.asarray((head == tail) & ((self.raw[head] == ord("0")) | (self.raw[head] == ord("1"))))

    def _convert(self, numeric: NDArray[np.bool_], start: NDArray[np.bool_], count: int) -> NDArray[np.float64]:
        if not count:
            return np.zeros(0)
        head = np.flatnonzero(start)
        size = np.flatnonzero(numeric & np.append(~numeric[1:] | start[1:], True)) + 1 - head
        numbers, plain = _plain_decimals(self.raw, head, size)
        rest = np.flatnonzero(~plain)
        if len(rest):
            text = b" ".join(self.raw[at : at + long].tobytes() for at, long in zip(head[rest], size[rest], strict=True))
            found = np.fromstring(text, np.float64, sep=" ")
            if len(found) != len(rest):
                raise AssertionError(f"{len(rest)} numbers were seen in path data and {len(found)} converted")
            numbers[rest] = found
        return numbers


# Decimals of so many digits are whole numbers that a double holds exactly, over a power of ten that it holds exactly too: one
# division rounds as it must, and the number is the one that any careful reader finds.
_EXACT_DIGITS = 15
_TENS = 10.0 ** np.arange(_EXACT_DIGITS + 1)


def _plain_decimals(
    raw: NDArray[np.uint8], head: NDArray[np.int64], size: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """The numbers that begin at `head` in the text and have `size` characters, and which of them are found: those without an
    exponent and with few enough digits. All numbers are gone through at once, a character at a time."""
    most = min(int(size.max()), _EXACT_DIGITS + 2)
    text = np.append(raw, np.zeros(most, np.uint8))
    whole = np.zeros(len(head), np.int64)
    digits = np.zeros(len(head), np.int64)
    dot = size - 1  # without one, no digit comes after it
    plain = size <= most
    for k in range(most):
        letter = text[head + k]
        inside = k < size
        value = letter - np.uint8(ord("0"))
        is_digit = inside & (value < 10)
        whole = np.where(is_digit, whole * 10 + value, whole)
        digits += is_digit
        dot[inside & (letter == ord("."))] = k
        plain &= ~(inside & ((letter | LOWER) == ord("e")))
    plain &= digits <= _EXACT_DIGITS
    numbers = whole / _TENS[np.where(plain, size - 1 - dot, 0)]
    negative = text[head] == ord("-")
    numbers[negative] *= -1.0
    return numbers, plain


# After an exponent neither a dot nor a second exponent belongs to the number; a sign there must have a digit.
_ODD_EXPONENT = re.compile(rb"[eE](?:[+-]?[0-9]+[.eE]|[+-]?\.)")


def _expand(tokens: _Tokens) -> Commands:
    """Implicit repeats written out, and a move put before whatever follows a close without one."""
    arity = ARITY[tokens.letter]
    repeats = np.where(arity == 0, 1, tokens.count // np.maximum(arity, 1))
    code = np.repeat(tokens.letter, repeats)
    within = np.arange(len(code)) - np.repeat(np.cumsum(repeats) - repeats, repeats)
    first = np.repeat(tokens.first, repeats) + within * ARITY[code]
    path = np.repeat(tokens.path, repeats)
    code = np.where((within > 0) & ((code & UPPER) == M), code - np.uint8(M - L), code)
    # A second close in a row closes nothing.
    again = np.zeros(len(code), bool)
    again[1:] = ((code[1:] & UPPER) == Z) & ((code[:-1] & UPPER) == Z) & (path[1:] == path[:-1])
    return with_moves(Commands(code[~again], first[~again], path[~again], tokens.numbers))


def with_moves(commands: Commands) -> Commands:
    """A relative move by nothing inserted wherever a close is followed, in the same path, by something that is no move."""
    upper = commands.code & UPPER
    missing = np.flatnonzero((upper[:-1] == Z) & (upper[1:] != M) & (commands.path[:-1] == commands.path[1:])) + 1
    if not len(missing):
        return commands
    return Commands(
        np.insert(commands.code, missing, np.uint8(LOWER_M)),
        np.insert(commands.first, missing, len(commands.numbers)),
        np.insert(commands.path, missing, commands.path[missing]),
        np.append(commands.numbers, (0.0, 0.0)),
    )


_WSP = re.compile(r"[ \t\r\n\f]*")
_COMMA_WSP = re.compile(r"[ \t\r\n\f]*,?[ \t\r\n\f]*")
_FLOAT = re.compile(r"[+-]?(?:[0-9]*\.[0-9]+|[0-9]+)(?:[eE][+-]?[0-9]+)?")


def repair(text: str) -> tuple[str, str | None]:
    """The path data up to its first error, with every token set apart; and the error, or None where there is none."""
    out: list[str] = []
    at = _WSP.match(text).end()  # type: ignore[union-attr]
    if at < len(text) and text[at] not in "Mm":
        return "", f"it must begin with M, not {text[at]!r}"
    while at < len(text):
        letter = text[at]
        if letter not in "MmLlHhVvCcSsQqTtAaZz":
            return " ".join(out), f"{letter!r} at character {at + 1} is no path command"
        start = at
        at = _WSP.match(text, at + 1).end()  # type: ignore[union-attr]
        if letter in "Zz":
            out.append(letter)
            continue
        done = 0
        while True:
            values, next_at = _arguments(text, at, letter)
            if values is None:
                break
            out += [letter, *values] if not done else values
            done += 1
            at = next_at
        if not done or (at < len(text) and text[at] not in "MmLlHhVvCcSsQqTtAaZz"):
            return " ".join(out), f"{letter} at character {start + 1} has an incomplete or wrong argument"
        if next_at > at:
            return " ".join(out), f"{letter} at character {start + 1} has too few numbers"
    return " ".join(out), None


def _arguments(text: str, at: int, letter: str) -> tuple[list[str] | None, int]:
    """One set of arguments and where the next token begins; None, and how far the reading got, where there is no whole set."""
    values: list[str] = []
    for i in range(int(ARITY[ord(letter)])):
        if letter in "Aa" and i in (3, 4):
            if at >= len(text) or text[at] not in "01":
                return None, at
            values.append(text[at])
            at += 1
        else:
            match = _FLOAT.match(text, at)
            if match is None:
                return None, at
            values.append(match[0])
            at = match.end()
        at = _COMMA_WSP.match(text, at).end()  # type: ignore[union-attr]
    return values, at
