"""An EiBotBoard in memory with a clock of its own: late, silent, doubled or full on demand, and the same every time.

It is a port (send, receive, wake, close) and a clock. Time passes only in `receive`. Written from the protocol reference: a
parser that handles one command at a time and blocks while the motion queue is full, a queue, an executing entry, replies in
both syntaxes. Motion is taken as durations and end positions; the exact steps are the virtual board's business.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from output.errors import LinkLost

Fault = Callable[["FakeEbb", int, str], bytes | None]
# How finely it lives on while the host waits.
_STEP_S = 0.0005


@dataclass
class Entry:
    wire: str
    duration_s: float
    steps: tuple[int, int] = (0, 0)
    pen: int | None = None
    start: float = 0.0
    end: float = 0.0


@dataclass
class FakeEbb:
    """`fault(board, i, wire)` sees the i-th command (from 0, all commands) and may return other reply bytes instead (b"" for
    silence) or None for the proper reply."""

    version: tuple[int, int, int] = (3, 0, 3)
    latency_s: float = 0.0005
    parse_s: float = 0.002
    future: bool = False
    name: str = "fake"
    now: float = 100.0
    fault: Fault | None = None
    half_line: bytes = b""

    depth: int = 1
    variables: dict[int, int] = field(default_factory=dict)
    counter: int = 0
    fifo: deque[Entry] = field(default_factory=deque)
    executing: Entry | None = None
    executed: list[Entry] = field(default_factory=list)
    killed: list[Entry] = field(default_factory=list)
    gaps: list[tuple[float, str]] = field(default_factory=list)
    steps: list[int] = field(default_factory=lambda: [0, 0])
    pen_up: bool = True
    pen_can_lower: bool = True
    motors_on: bool = False
    blocked_s: float = 0.0
    transcript: list[tuple[float, str]] = field(default_factory=list)
    written: list[tuple[float, bytes]] = field(default_factory=list)
    button: bool = False
    power_low: bool = False
    dead: bool = False
    deaf: bool = False
    on_time: Callable[[FakeEbb], None] | None = None
    most_waiting: int = 0

    def __post_init__(self) -> None:
        self._in: deque[tuple[float, bytes]] = deque()
        self._line = bytearray(self.half_line)
        self._out: deque[tuple[float, bytes]] = deque()
        self._free_at = self.now
        self._idle_since: float | None = None
        self._woken = False
        self._count = 0

    # the port

    def clock(self) -> float:
        return self.now

    def send(self, data: bytes) -> None:
        if self.dead:
            raise LinkLost("the link to fake is lost (pulled)")
        self.written.append((self.now, data))
        self._in.append((self.now + self.latency_s, data))

    def receive(self, timeout_s: float) -> bytes:
        if self.dead:
            raise LinkLost("the link to fake is lost (pulled)")
        if self._woken:
            self._woken = False
            return b""
        horizon = self._live(self.now + max(timeout_s, 1e-4))
        if self._out and self._out[0][0] <= horizon:
            self.now = max(self.now, self._out[0][0])
            data = b""
            while self._out and self._out[0][0] <= self.now:
                data += self._out.popleft()[1]
        else:
            self.now, data = horizon, b""
        if self.on_time is not None:
            self.on_time(self)
        return data

    def wake(self) -> None:
        self._woken = True

    def close(self) -> None:
        self.dead = True

    # the board

    def _live(self, until: float) -> float:
        """The board lives on until it has said something, or until that time; returns how far it came."""
        at = self.now
        while at < until and not (self._out and self._out[0][0] <= at):
            # In short steps, so that it does not run ahead of what it is sent next.
            at = min(at + _STEP_S, until)
            self._work(at)
        return at

    def _work(self, horizon: float) -> None:
        while self._in and not self.deaf:
            arrival, data = self._in[0]
            start = max(arrival, self._free_at)
            if start + self.parse_s > horizon:
                break
            self._in.popleft()
            for i, byte in enumerate(data):
                if byte in b"\r\n":
                    rest = data[i + 1 :]
                    if rest:
                        self._in.appendleft((arrival, rest))
                    self._run_line(start + self.parse_s)
                    break
                self._line.append(byte)
        self._move(min(horizon, self.now + 1e9))

    def _run_line(self, at: float) -> None:
        wire = self._line.decode("ascii", "replace")
        self._line.clear()
        if not wire:
            return
        self._move(at)
        self._free_at = at
        reply = self._execute(wire)
        self.transcript.append((self._free_at, wire))
        if self.fault is not None:
            changed = self.fault(self, self._count, wire)
            reply = reply if changed is None else changed
        self._count += 1
        if reply:
            self._out.append((self._free_at + self.latency_s, reply))

    def say(self, data: bytes, delay_s: float = 0.0) -> None:
        self._out.append((self._free_at + self.latency_s + delay_s, data))

    def reboot(self) -> None:
        """Back to power-on without leaving the USB."""
        self.fifo.clear()
        self.executing, self._idle_since = None, None
        self.future, self.depth, self.steps, self.pen_up, self.motors_on = False, 1, [0, 0], True, False
        self.variables.clear()
        self.counter = 0

    def _move(self, until: float) -> None:
        while self.executing is not None and self.executing.end <= until:
            done = self.executing
            self.steps[0] += done.steps[0]
            self.steps[1] += done.steps[1]
            self.executed.append(done)
            self.executing = None
            if self.fifo:
                self._start(self.fifo.popleft(), done.end)
            else:
                self._idle_since = done.end

    def _start(self, entry: Entry, at: float) -> None:
        if self._idle_since is not None and at - self._idle_since > 1e-6:
            self.gaps.append((at - self._idle_since, entry.wire))
        self._idle_since = None
        entry.start, entry.end = at, at + entry.duration_s
        if entry.pen is not None:
            self.pen_up = entry.pen == 1 or not self.pen_can_lower
        self.executing = entry

    def _queue(self, entry: Entry) -> None:
        while len(self.fifo) >= self.depth:
            assert self.executing is not None
            self.blocked_s += self.executing.end - self._free_at
            self._free_at = self.executing.end
            self._move(self._free_at)
        if self.executing is None:
            self._start(entry, self._free_at)
        else:
            self.fifo.append(entry)
        self.most_waiting = max(self.most_waiting, len(self.fifo))

    def _ok(self, wire: str, data: str = "", ok: bool = True) -> bytes:
        name = wire.split(",")[0].upper()
        if self.future:
            return (f"{name},{data}\n" if data else f"{name}\n").encode()
        return ((data + "\r\n") if data else "").encode() + (b"OK\r\n" if ok else b"")

    def _execute(self, wire: str) -> bytes:
        words = wire.split(",")
        name, numbers = words[0].upper(), [int(w) for w in words[1:] if re.fullmatch(r"-?\d+", w)]
        if name in ("SM", "T3", "LM", "SP", "S2", "EM", "HM", "LT"):
            return self._motion(name, numbers, wire)
        if name == "V":
            return self._ok(wire, "EBBv13_and_above EB Firmware Version " + ".".join(map(str, self.version)), ok=False)
        if name == "CU":
            return self._option(wire, numbers)
        if name == "ES":
            return self._stop(wire, numbers)
        if name == "QG":
            return self._ok(wire, f"{self._status():02X}", ok=False)
        if name == "QU" and self.version >= (3, 0, 0):
            data = {2: 32, 3: self.depth, 6: len(self.fifo)}.get(numbers[0], 0)
            return self._ok(wire, str(data) if self.future else f"QU,{data}") + (b"\n" if self.future else b"")
        if name == "QM":
            return self._ok(wire, f"QM,{int(self.executing is not None)},0,0,{int(bool(self.fifo))}", ok=False)
        if name == "QP":
            return self._ok(wire, str(int(self.pen_up)))
        if name == "QS":
            return self._ok(wire, f"{self.steps[0]},{self.steps[1]}")
        if name == "SN":
            self.counter = numbers[0]
            return self._ok(wire)
        if name == "QN":
            return self._ok(wire, str(self.counter))
        if name == "SL":
            self.variables[numbers[1] if len(numbers) > 1 else 0] = numbers[0]
            return self._ok(wire)
        if name == "QL":
            return self._ok(wire, str(self.variables.get(numbers[0] if numbers else 0, 0)))
        if name == "QC":
            return self._ok(wire, "394,30" if self.power_low else "394,300")
        if name in ("SC", "SR", "CS"):
            self.pen_can_lower |= wire.startswith("SC,5")
            return self._ok(wire)
        if name == "QE":
            return self._ok(wire, "1,1" if self.motors_on else "0,0")
        return self._error(wire, f"!8 Err: Unknown command '{name}:00'")

    def _error(self, wire: str, text: str) -> bytes:
        return f"{wire.split(',')[0]},{text}\n".encode() if self.future else f"{text}\r\n".encode()

    def _option(self, wire: str, numbers: list[int]) -> bytes:
        if numbers[0] == 10 and self.version >= (3, 0, 0):
            was, self.future = self.future, numbers[1] == 1
            return (b"CU\n" if was else b"\n") if self.future else (b"CUOK\r\n" if was else b"OK\r\n")
        if numbers[0] == 4:
            while self.executing is not None:
                self._free_at = max(self._free_at, self.executing.end)
                self._move(self._free_at)
            self.depth = min(numbers[1], 32)
        return self._ok(wire)

    def _stop(self, wire: str, numbers: list[int]) -> bytes:
        hit = int(self.executing is not None or bool(self.fifo))
        if self.executing is not None:
            self.killed.append(self.executing)
        self.killed.extend(self.fifo)
        self.fifo.clear()
        self.executing, self._idle_since = None, None
        if numbers == [1]:
            self.motors_on = False
        return self._ok(wire, str(hit))

    def _motion(self, name: str, numbers: list[int], wire: str) -> bytes:
        if name == "SM" and len(numbers) < 3:
            return self._error(wire, "!4 Err: Missing parameter(s)")
        if name == "SM" and numbers[0] == 0:
            return self._error(wire, "!6 Err: Invalid parameter value")
        entry = Entry(wire, 40e-6)
        if name == "SM":
            entry = Entry(wire, numbers[0] / 1000, (numbers[1], numbers[2]))
        elif name in ("T3", "LT"):
            entry = Entry(wire, (numbers[0] + 1) * 40e-6)
        elif name == "S2":
            entry = Entry(wire, numbers[3] / 1000 + 40e-6)
        elif name == "SP":
            if numbers[0] >= 2:
                self.pen_up = True
                if numbers[0] == 3:
                    self.pen_can_lower = False
                    for waiting in self.fifo:
                        waiting.pen = None if waiting.pen is None else 1
                return self._ok(wire)
            entry = Entry(wire, (numbers[1] if len(numbers) > 1 else 0) / 1000 + 40e-6, pen=numbers[0])
        self.motors_on = numbers[0] > 0 if name == "EM" else self.motors_on or name not in ("SP", "S2")
        self._queue(entry)
        return self._ok(wire)

    def _status(self) -> int:
        bits = (0x01 if self.fifo else 0) | (0x08 if self.executing else 0) | (0x10 if self.pen_up else 0)
        bits |= (0x20 if self.button else 0) | (0x40 if self.power_low and self.version >= (3, 0, 0) else 0)
        self.button = False
        return bits
