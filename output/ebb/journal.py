"""The journal of a plot: what has been executed, so that a plot that was killed can be finished.

Append-only lines of text, each with its length and checksum, so that a torn, cut or damaged file still tells everything that
was written whole:

    0000005b 1c291ca3 {"kind": "head", ...}

What is written, and when it counts:
    head        once: drawing, settings, machine, board, job token; what must be the same for the plot to be resumed
    part        the program begins, or begins again after a resume; command numbers count from here
    sent n      *before* a command goes out: at most n commands can have reached the board (written ahead, in leases)
    done n      n commands are executed by the board's own count, never by acknowledgements, which only mean "queued"
    held n      a pause has taken the place of what follows the first n commands: the board is sent these instead, and no more
    stroke i    stroke i is drawn to its end
    end         why the plot ended; absent after a crash, which is how the next start knows of it

The pen may be anywhere between "done" and "sent" when the computer dies: the board draws on what it has queued.
Writing goes to the system at once; fsync is done by a thread of its own at each pen-up and at most a second later, so that a
slow disk cannot make the pen wait. A disk that is full ends the journal with a warning, never the plot. What the journal said
is taken away then, which needs no room: a resume would go by what is out of date, and draw again what is drawn.
"""

from __future__ import annotations

import json
import os
import threading
import time
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any

from output.ebb.program import StrokeEnd
from output.ebb.progress import Progress

try:
    import fcntl
except ImportError:  # Windows: nothing there is locked so that its holder's end frees it
    fcntl = None  # type: ignore[assignment]

SYNC_EVERY_S = 1.0
# Windows would end lines with \r\n, of which no checksum knows.
_APPENDING = os.O_WRONLY | os.O_APPEND | getattr(os, "O_BINARY", 0)
# How many commands are written ahead at a time: a place is looked for among this many and the queue.
LEASE = 32
# Another number wherever an older journal would be misread, or its plot made again in another order.
FORMAT = 2


class Journal:
    """Written while streaming (stream.Recorder). Open it with `begin` or `reopen`; it is a context manager.

    `trouble` is None, or says why nothing more is written; the file is empty then, and goes when it is closed.
    """

    def __init__(self, path: Path, descriptor: int) -> None:
        self.path = path
        self.trouble: str | None = None
        self._descriptor = descriptor
        self._sent = 0
        self._leased = 0
        self._closing = threading.Event()
        self._sync_wanted = threading.Event()
        self._dirty = True  # its name, at least
        self._syncer = threading.Thread(target=self._sync_loop, daemon=True, name="journal-sync")
        self._syncer.start()

    @classmethod
    def begin(cls, path: Path, head: Mapping[str, Any]) -> Journal:
        """A new journal in place of whatever is at `path`; `head` is JSON-able. Raises OSError when it cannot be made."""
        path.parent.mkdir(parents=True, exist_ok=True)
        fresh = path.with_name(path.name + ".new")
        try:
            descriptor = os.open(fresh, _APPENDING | os.O_CREAT | os.O_TRUNC, 0o644)
            try:
                _write_all(descriptor, _line({"kind": "head", "format": FORMAT, "began_s": int(time.time()), **head}))
                os.fsync(descriptor)
            finally:
                os.close(descriptor)  # Windows renames no open file
            fresh.replace(path)
        except OSError:
            with suppress(OSError):
                fresh.unlink()
            raise
        return cls(path, os.open(path, _APPENDING))

    @classmethod
    def reopen(cls, path: Path) -> Journal:
        """Goes on with an existing journal, after a resume. Raises OSError when it cannot be written; it is as it was then."""
        descriptor = os.open(path, _APPENDING)
        try:
            _write_all(descriptor, b"\n")  # whatever line was being written when it broke off ends here
        except OSError:
            os.close(descriptor)
            raise
        return cls(path, descriptor)

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, _kind: type[BaseException] | None, error: BaseException | None, _trace: TracebackType | None) -> None:
        if error is not None:
            self.end(f"{type(error).__name__}: {error}")
        self.close()

    # what the stream tells

    def part(self, facts: Mapping[str, Any]) -> None:
        """A program begins: `facts` say what it is, the job token among them. Command numbers start again at 0."""
        self._sent = self._leased = 0
        self._write({"kind": "part", **facts})
        self._sync_wanted.set()

    def sent(self, commands: int) -> None:
        """Command number `commands` (from 1) is about to be sent."""
        self._sent = commands
        if commands > self._leased:
            self._leased = commands + LEASE - 1
            self._write({"kind": "sent", "n": self._leased})

    def held(self, wires: Sequence[str]) -> None:
        """From the next command on these are sent, as the board will read them, in place of the rest of the program."""
        self._write({"kind": "held", "n": self._sent, "wires": list(wires)})
        self._sync_wanted.set()

    def executed(self, progress: Progress) -> None:
        """So many commands are executed, and both motors stand at `progress.steps` or beyond."""
        record: dict[str, Any] = {"kind": "done", "n": progress.commands_executed, "t": round(progress.board_time_s, 3)}
        if progress.stroke is not None:
            record["stroke"] = progress.stroke
        if progress.steps is not None:
            record["steps"] = progress.steps
        self._write(record)

    def stroke_done(self, mark: StrokeEnd, progress: Progress) -> None:
        """The pen has drawn a stroke to its end."""
        self._write({"kind": "stroke", "i": mark.index, "steps": mark.steps, "n": progress.commands_executed})
        self._sync_wanted.set()

    def end(self, why: str, steps: Sequence[int] | None = None) -> None:
        """The plot has ended: "done", "stopped", or the error's words. `steps` where the board stands."""
        self._write({"kind": "end", "why": why, **({} if steps is None else {"steps": list(steps)})})
        self._sync_wanted.set()

    def close(self) -> None:
        """Writes everything to the disk and closes. Never raises: `trouble` tells."""
        if self._closing.is_set():
            return
        self._closing.set()
        self._sync_wanted.set()
        self._syncer.join(2 * SYNC_EVERY_S)
        try:
            os.close(self._descriptor)
        except OSError as error:
            self._give_up(error)
        if self.trouble is not None and not discard(self.path):
            self.trouble += "; it is out of date and cannot be taken away, so that `plotter resume` would draw lines twice"

    # writing

    def _write(self, record: Mapping[str, Any]) -> None:
        self._append(_line(record))

    def _append(self, data: bytes) -> None:
        if self.trouble is not None or self._closing.is_set():
            return
        try:
            _write_all(self._descriptor, data)
            self._dirty = True
        except OSError as error:
            self._give_up(error)

    def _give_up(self, error: OSError) -> None:
        self.trouble = (
            f"the journal {self.path} cannot be written ({error.strerror}): from there on this plot cannot be resumed"
        )
        with suppress(OSError):
            os.ftruncate(self._descriptor, 0)

    def _sync_loop(self) -> None:
        closing = False
        while not closing:
            self._sync_wanted.wait(SYNC_EVERY_S)
            self._sync_wanted.clear()
            # Asked before the fsync: what is written while it runs wants another one.
            closing = self._closing.is_set()
            if self._dirty and self.trouble is None:
                self._dirty = False
                try:
                    os.fsync(self._descriptor)
                except OSError as error:
                    self._give_up(error)


@contextmanager
def journal_lock(path: Path) -> Iterator[bool]:
    """Whether the journal at `path` is this program's own while the context lasts; False when another one has it.

    The lock is on a file beside it, since a new journal takes the place of the old file, and goes with its holder, however that
    ends. Where there can be none (on Windows, in a folder that cannot be written), the journal counts as this program's own.
    """
    descriptor: int | None = None
    ours = True
    try:
        if fcntl is not None:
            descriptor = os.open(path.with_name(path.name + ".lock"), os.O_RDWR | os.O_CREAT, 0o644)
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        ours = False
    except OSError:
        pass
    try:
        yield ours
    finally:
        if descriptor is not None:
            os.close(descriptor)


def discard(path: Path) -> bool:
    """Takes the journal at `path` away, or what it says, as far as that can be done; whether nothing of it is left."""
    with suppress(OSError):
        path.unlink()
    with suppress(OSError):
        os.truncate(path, 0)  # in a folder whose names cannot be changed
    return load(path) is None


def _line(record: Mapping[str, Any]) -> bytes:
    body = json.dumps(record, separators=(",", ":"), ensure_ascii=True).encode("ascii")
    return b"%08x %08x %s\n" % (len(body), zlib.crc32(body), body)


def _write_all(descriptor: int, data: bytes) -> None:
    while data:
        data = data[os.write(descriptor, data) :]


@dataclass(frozen=True, slots=True)
class Held:
    """A pause on the path: after the first `commands` commands of the part's program, the board was sent `wires` instead."""

    commands: int
    wires: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class PlotState:
    """What a journal says. Numbers of commands are those of the latest part.

    `executed` commands are drawn for certain, at most `sent` can be; `strokes_done` are drawn whole, over all parts; `stroke`
    is the one that was being drawn (None: none, as far as is known) and `steps` the last executed position that was noted.
    `ended` is why the plot ended, None when it was cut off. `damaged` lines were skipped. `began_s` is when the plot began, for
    a person to read and nothing else (Unix seconds of the wall clock); None when unknown. `held` is what a pause has sent in
    place of the rest of the latest part, None when none has; numbers of commands go on through it. `stopped_at` is where the
    motors stood when it ended, by the board's counters; None when that is not known.
    """

    head: Mapping[str, Any]
    part: Mapping[str, Any]
    parts: int
    executed: int
    sent: int
    strokes_done: frozenset[int]
    stroke: int | None
    steps: tuple[int, int] | None
    board_time_s: float
    ended: str | None
    damaged: int
    began_s: float | None = None
    held: Held | None = None
    stopped_at: tuple[int, int] | None = None

    @property
    def interrupted(self) -> bool:
        """There is something left to draw, as far as the journal knows: it did not end as done."""
        return self.ended != "done"


@dataclass(slots=True)
class _Reading:
    part: dict[str, Any] = field(default_factory=dict)
    parts: int = 0
    executed: int = 0
    sent: int = 0
    strokes: set[int] = field(default_factory=set)
    stroke: int | None = None
    steps: tuple[int, int] | None = None
    board_time_s: float = 0.0
    ended: str | None = None
    held: Held | None = None
    stopped_at: tuple[int, int] | None = None

    def take(self, record: Mapping[str, Any]) -> None:
        """One sound record. Damage may have removed any of its neighbours, so numbers only ever grow within a part."""
        kind = record.get("kind")
        if kind == "part":
            self.part, self.parts = dict(record), self.parts + 1
            self.executed = self.sent = 0
            self.stroke = self.steps = self.ended = self.held = self.stopped_at = None
        elif kind == "sent":
            self.sent = max(self.sent, int(record["n"]))
        elif kind == "held":
            self.held = Held(int(record["n"]), tuple(str(wire) for wire in record["wires"]))
        elif kind == "done" and int(record["n"]) >= self.executed:
            self.executed = int(record["n"])
            self.sent = max(self.sent, self.executed)
            self.stroke = record.get("stroke")
            self.steps = _pair(record.get("steps")) or self.steps
            self.board_time_s = float(record["t"])
        elif kind == "stroke":
            self.strokes.add(int(record["i"]))
            self.steps = _pair(record.get("steps")) or self.steps
            self.stroke = None
        elif kind == "end":
            self.ended, self.stopped_at = str(record["why"]), _pair(record.get("steps"))
            self.steps = self.stopped_at or self.steps


def load(path: Path) -> PlotState | None:
    """What the journal at `path` tells; None when there is none, or not even its head can be read. Never raises for damage."""
    try:
        content = path.read_bytes()
    except OSError:
        return None
    head: dict[str, Any] | None = None
    reading, damaged = _Reading(), 0
    for line in content.split(b"\n"):
        record = _sound(line)
        if record is None:
            damaged += bool(line)
            continue
        if record.get("kind") == "head":
            head = head or (record if record.get("format") == FORMAT else None)
            continue
        try:
            reading.take(record)
        except (KeyError, TypeError, ValueError):
            damaged += 1
    if head is None:
        return None
    return PlotState(
        head=head,
        part=reading.part,
        parts=reading.parts,
        executed=reading.executed,
        sent=reading.sent,
        strokes_done=frozenset(reading.strokes),
        stroke=reading.stroke,
        steps=reading.steps,
        board_time_s=reading.board_time_s,
        ended=reading.ended,
        damaged=damaged,
        began_s=float(head["began_s"]) if isinstance(head.get("began_s"), int | float) else None,
        held=reading.held,
        stopped_at=reading.stopped_at,
    )


def _sound(line: bytes) -> dict[str, Any] | None:
    """The record of a line whose length and checksum are right."""
    try:
        length, checksum, body = int(line[:8], 16), int(line[9:17], 16), line[18:]
        if len(body) != length or zlib.crc32(body) != checksum:
            return None
        record = json.loads(body)
    except ValueError:
        return None
    return record if isinstance(record, dict) else None


def _pair(value: object) -> tuple[int, int] | None:
    if isinstance(value, list | tuple) and len(value) == 2:
        return int(value[0]), int(value[1])
    return None


def differences(
    then: Mapping[str, Any], now: Mapping[str, Any], *, ignore: Sequence[str] = ("kind", "format", "began_s")
) -> list[str]:
    """What is not as it was, one phrase each: "pen-down speed was 25, is 30". Nested mappings are compared key by key."""
    found = []
    for key in sorted({*then, *now} - set(ignore)):
        before, after = then.get(key), now.get(key)
        if isinstance(before, Mapping) and isinstance(after, Mapping):
            found += [f"{key} {phrase}" for phrase in differences(before, after, ignore=())]
        elif before != after and list(_flat(before)) != list(_flat(after)):
            found.append(f"{key.replace('_', ' ')} was {_short(before)}, is {_short(after)}")
    return found


def _flat(value: object) -> list[object]:
    return list(value) if isinstance(value, list | tuple) else [value]


def _short(value: object) -> str:
    text = "not set" if value is None else str(value)
    return text if len(text) <= 40 else text[:12] + "…"
